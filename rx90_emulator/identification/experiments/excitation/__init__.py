"""Excitation runs: Fourier series of all joints, optimised within the limits of the arm and of the room around it.

information (what a motion tells of the parameters), limits (what it must keep) -> design (the search for one run, and
a series of them) -> table (what is printed of it).
"""
