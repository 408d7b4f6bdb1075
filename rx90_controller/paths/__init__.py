"""Paths of the tool centre point: geometry, profiles, path files, and drawings that they are read from."""
