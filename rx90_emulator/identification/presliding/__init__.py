"""Presliding friction from micro-oscillations."""

__all__ = ["fit"]
