"""Conformance: a battery of runs for any controller of the arm, in comparison with the CS7B."""
