"""Paths of the tool centre point: geometry, profiles, path files, and drawings as their source."""
