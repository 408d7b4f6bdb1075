"""Compiled code: kernels and their cache, lanes, elementary functions that give the same bits everywhere."""
