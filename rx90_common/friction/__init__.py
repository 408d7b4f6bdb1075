"""Joint friction by the LuGre law (Waiboer, Aarts, Jonker, section 4): parameters, friction file, compiled steps.

It lies on the ground because the robot's plant, the rig's and whoever compensates friction share it.
"""

from rx90_common.friction.friction_file import load_friction
from rx90_common.friction.friction_set import ELEMENT_COUNT, FrictionSet
from rx90_common.friction.lugre import LuGreElement

__all__ = [
    "ELEMENT_COUNT",
    "FrictionSet",
    "LuGreElement",
    "bristle",
    "friction_file",
    "friction_set",
    "load_friction",
    "lugre",
    "parameters",
    "tracing",
]
