"""Recorded bags, played on the page: states at any time, envelopes for plots, two bags' difference.

layout (whose joint angles) -> recording (a bag's series in memory, as tracks) -> difference, path -> player (arms,
controls, plots, facts); job puts these together.
"""
