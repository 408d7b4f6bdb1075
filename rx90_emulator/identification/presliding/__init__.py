"""The presliding regime, c0 and c1, from micro-oscillations."""
