"""Random friction rigs and what is true of them."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from friction_bench.rig.plant import shaft_of
from friction_bench.rig.rig_file import JointFriction, LuGreJoint, Rig, load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.share import SOURCE_RIG, config_path
from rx90_common.friction.element import FrictionElement

HEAVIEST = 0.11
"""Break-away torque of the heaviest random rigs, Nm: the ramps end at 0.15 and 0.16 Nm."""


@cache
def shipped_rig() -> Rig:
    """Return the rig of the shipped file."""
    return load_rig(config_path("rig/gm8224.yaml"))


@cache
def source_rig() -> Rig:
    """Return the source's rig, whose torque and joint differ from ramp to ramp."""
    return load_rig(config_path(SOURCE_RIG))


def random_rig(seed: int, number: int, kind: str) -> Rig:
    """Return the shipped rig with random friction and inertia; equal numbers share all but the joint's law."""
    rig = shipped_rig()
    assert rig.emulation is not None
    rng = np.random.default_rng((seed, number))

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(math.log(low), math.log(high))))

    ratio, torque = rig.gear.ratio, rig.gear.ratio * rig.gear.efficiency
    own, viscous = between(0.006, 0.05), between(4e-4, 1.2e-3)
    inertia, more = between(6e-6, 6e-5), between(1e-5, 2e-4)
    coulomb, slope = between(0.01, 0.05) * torque, viscous * between(0.1, 0.6) * torque * ratio
    rise = min(rng.uniform(1.05, 1.6), (HEAVIEST - own) * torque / coulomb)
    bristle, damping = between(2e-4, 1e-3), between(3e-4, 3e-3)
    stribeck, exponent = between(0.02, 0.2), rng.uniform(0.7, 2.0)
    joint: JointFriction | LuGreJoint = JointFriction(
        model="coulomb_viscous", coulomb=coulomb, viscous=slope
    )
    if kind == "LuGre":
        stiffness = coulomb / bristle
        element = FrictionElement.of(
            {
                "tau_c": coulomb,
                "tau_s": coulomb * max(rise, 1.0),
                "omega_s": stribeck,
                "delta": exponent,
                "c0": stiffness,
                "c1": damping * stiffness,
                "c2": slope,
                "omega_d": 1.0,
            }
        )
        joint = LuGreJoint(model="lugre", lugre=element)
    return rig.replaced(
        emulation={
            "motor_friction": {"coulomb": own, "viscous": viscous},
            "load_inertia": (inertia - rig.emulation.motor.rotor_inertia) * ratio * torque,
            "joint_inertia": more * ratio * torque,
            "joint_friction": joint,
        }
    )


def truth_of(rig: Rig, loaded: bool) -> Array:
    """Return the true f_c, f_v and J at the motor."""
    assert rig.emulation is not None
    shaft = shaft_of(rig, loaded)
    values = np.array([shaft.coulomb, shaft.viscous, shaft.inertia])
    if loaded and isinstance(rig.emulation.joint, FrictionElement):
        torque = rig.gear.ratio * rig.gear.efficiency
        joint = rig.emulation.joint
        values += joint.tau_c.positive / torque, joint.c2 / (torque * rig.gear.ratio), 0.0
    return values
