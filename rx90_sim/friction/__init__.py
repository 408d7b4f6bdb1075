"""LuGre joint friction (Waiboer, Aarts, Jonker, section 4): parameters and compiled bristle steps."""

from rx90_sim.friction.friction_set import ELEMENT_COUNT, FrictionSet, load_friction
from rx90_sim.friction.lugre import LuGreElement

__all__ = ["ELEMENT_COUNT", "FrictionSet", "LuGreElement", "load_friction"]
