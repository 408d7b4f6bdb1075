"""Joint friction by the LuGre law (Aarts, Jonker, Waiboer, section 4): parameters, friction file, compiled steps.

It lies on the ground because the robot's plant, the rig's and whoever compensates friction share it.
"""

from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import load_friction
from rx90_common.friction.friction_set import FrictionSet

__all__ = [
    "FrictionElement",
    "FrictionSet",
    "arm_elements",
    "bristle",
    "compiled_elements",
    "curves",
    "element",
    "friction_file",
    "friction_set",
    "held_out",
    "load_friction",
    "tracing",
]
