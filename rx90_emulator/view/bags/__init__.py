"""Recorded bags made ready to be looked at: states at any time, envelopes for plots, two bags' difference.

layout (whose joint angles) -> recording (a bag's series in memory) -> track (at any time), difference -> playback.
"""
