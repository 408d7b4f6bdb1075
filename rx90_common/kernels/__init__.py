"""Compiled code: kernels and their cache, lanes, elementary functions that give the same bits everywhere."""

__all__ = ["announcement", "compiled", "elementary", "lane_bits", "lanes"]
