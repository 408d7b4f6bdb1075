"""Estimation of friction from rows of data, of whatever kind: one fit, one kind of deviations, one choice of a law."""
