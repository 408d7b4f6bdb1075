"""Friction from excitation runs: which parts each element has, by cross-validation, and their parameters."""

__all__ = ["cross_validation", "estimates", "fit", "identify", "law", "selection"]
