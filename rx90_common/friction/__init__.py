"""Joint friction by the LuGre law (Aarts, Jonker, Waiboer, section 4): parameters, friction file, compiled steps.

It is in rx90_common because the robot's plant, the rig's and friction compensation share it.
"""

from rx90_common.friction.element import FrictionElement
from rx90_common.friction.friction_file import FrictionSet, load_friction

__all__ = [
    "FrictionElement",
    "FrictionSet",
    "arm_elements",
    "bristle",
    "compiled_elements",
    "element",
    "friction_file",
    "load_friction",
]
