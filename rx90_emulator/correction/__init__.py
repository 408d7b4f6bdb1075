"""Corrections of a path that are learned from trial to trial, on the engine, on nodes, or from recordings of an arm."""
