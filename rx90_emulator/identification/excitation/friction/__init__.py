"""Friction from excitation runs: which parts each element has, by cross-validation, and their parameters."""
