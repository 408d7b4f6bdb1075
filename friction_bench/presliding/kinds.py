"""The kinds of experiments; importing it costs nothing, so that `--help` need not wait."""

KINDS = ("loops", "sweep", "stick_slip", "drift")
"""In the order in which they are run after the ramps."""
USUAL_BLOCKS = 10
"""Of loops."""
USUAL_CYCLES = 10_000
"""Small ones, of the drift."""
