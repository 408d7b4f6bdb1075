"""Ramp tests: run, recorded, identified and reported."""
