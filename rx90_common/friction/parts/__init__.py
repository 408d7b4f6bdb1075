"""Parts of a friction element beyond its bristle law, each a block of the friction file: load, temperature, ..."""
