"""Ramp tests: run, recorded, identified and reported."""

__all__ = ["job", "ramp", "record", "session"]
