"""Friction before and around sliding, on the rig: loops, break-away, slow speeds, stick-slip, drift; choice of a law.

The constants are here because this module imports quickly, so that `--help` need not wait.
"""

KINDS = ("loops", "sweep", "stick_slip", "drift")
"""Of experiments, in the order in which they are run after the ramps."""
USUAL_BLOCKS = 10
"""Of loops."""
USUAL_CYCLES = 10_000
"""Small ones, of the drift."""
