"""Inertias that a body can have: from identified base parameters and a prior to mass, centre and inertia of links.

Data flow: bodies (the links of a URDF that move with each joint) -> prior (where each of them begins) -> fit (the
consistent inertias nearest to the base parameters) -> cost (what they cost in torque). `pseudo_inertia` holds the
matrices that all of them use.
"""

__all__ = ["cost", "fit"]
