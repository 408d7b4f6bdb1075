"""Compiled code: kernels and their cache, lanes, elementary functions that give the same bits everywhere."""

__all__ = ["announcement", "compiled", "elementary", "elementary_arrays", "lane_bits", "lanes", "random_numbers"]
