"""Conformance: a battery of runs that any controller of the arm goes through, side by side with the CS7B."""
