"""Sliding friction from sweeps at constant velocity."""

__all__ = ["fit"]
