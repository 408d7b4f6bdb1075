"""Friction before and around sliding, on the rig: loops, break-away, slow speeds, stick-slip, drift, and which law."""
