"""Colours of all plots, and kinds of pictures."""

# Colour-blind safe (Okabe and Ito), one for each of seven friction elements.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
INK = "#222222"
GREY = "#888888"
PICTURES = (".png", ".svg", ".pdf")
"""Suffixes of picture files."""
