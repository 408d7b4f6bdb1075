"""Dedicated motions from which friction can be identified: planned, checked, and run on the engine or the nodes."""
