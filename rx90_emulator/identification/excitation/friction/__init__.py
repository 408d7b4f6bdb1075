"""Friction from excitation runs: which parts each element has, by cross-validation, and their parameters."""

__all__ = ["identify", "law", "load_parts", "models"]
