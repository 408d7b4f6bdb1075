"""The plant taken apart: six rotors that do not know of each other, for comparisons with one mass and its friction."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from rx90_common.friction import ELEMENT_COUNT, FrictionElement, FrictionSet
from rx90_emulator.loop.setup import Setup


def negligible_element() -> FrictionElement:
    """Return friction so small that it does not show."""
    return FrictionElement(1e-12, 1e-12, 1e-12, 1e-12, 1.0, 1.0, 1e-9, 0.0, 0.0)


def decoupled_setup(shipped: Setup, elements: Sequence[FrictionElement], inertia: float) -> Setup:
    """Return six unit-gear rotors: joints 1 to 4 carry the given elements, one each.

    The links weigh nothing, there is neither gravity nor spring, the torques are not limited. What is left of
    the plant is, joint by joint, the textbook's mass with friction.

    Args:
        shipped: where everything else comes from.
        elements: friction of the first joints, at most four; the others have none to speak of.
        inertia: of each rotor, kg m^2.
    """
    nothing, six = np.zeros((6, 3)), np.ones(6)
    chain = shipped.robot.chain._replace(mass=np.zeros(6), com=nothing, inertia=np.zeros((6, 6)), gravity=np.zeros(3))
    robot = dataclasses.replace(shipped.robot, chain=chain, lower=-1e9 * six, upper=1e9 * six, max_velocity=1e4 * six)
    drives = dataclasses.replace(
        shipped.drives,
        gear=six,
        rotor_inertia=inertia * six,
        torque_constant=six,
        peak_current=1e6 * six,
        spring_torque=0.0 * six,
    )
    padded = [*elements, *[negligible_element()] * (ELEMENT_COUNT - len(elements))]
    friction = FrictionSet(shipped.friction.names, tuple(padded))
    return dataclasses.replace(shipped, robot=robot, drives=drives, friction=friction)
