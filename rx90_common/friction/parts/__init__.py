"""Parts of a friction element beyond its bristle law: load, angle, scatter. Each is a block of the friction file."""

__all__ = ["bristles", "load", "part", "record", "ripple", "scatter", "step", "table"]
