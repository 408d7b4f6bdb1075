"""Colours of all plots, and kinds of pictures."""

from typing import Final

# Colour-blind safe (Okabe and Ito), one for each of seven friction elements.
COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
INK: Final = "#222222"
GREY: Final = "#888888"
PICTURES: Final = (".png", ".svg", ".pdf")
"""Suffixes of picture files."""
