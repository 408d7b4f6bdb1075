"""Excitation runs: Fourier series of all joints, optimised within the limits of the arm and of the room around it.

series (periodic motions that begin and end at rest) -> workspace and limits (what they must keep) -> information (what
they tell of the parameters) -> search (one run), design (a series of runs), table (what is printed of it), job.
"""

__all__ = ["job", "options"]
