"""The source's comparison: rig, block diagram, multibody model and closed form of one ramp test.

The source compares its experiment with Simulink (equation 3 as a block diagram) and ADAMS (a multibody
model) and solves the equation in Maple. Here the same four: readings of the rig, equation 3 integrated
numerically, a revolute joint in Pinocchio behind its gear, and the closed form.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from friction_bench.experiment.record import RampModel, RampRecord
from rx90_common.base.arrays import Array

EXPERIMENT, BLOCK, MULTIBODY, CLOSED = "experiment", "equation 3, integrated", "multibody", "closed form"
SOURCE_BANDS = {
    frozenset((BLOCK, MULTIBODY)): 2.0,
    frozenset((EXPERIMENT, MULTIBODY)): 7.0,
    frozenset((EXPERIMENT, BLOCK)): 10.0,
}
"""The source's differences, per cent: Simulink and ADAMS, experiment and ADAMS, experiment and Simulink."""
SMOOTHING = 5
"""Readings over which the experiment's velocity is averaged: one count in 20 ms is 0.62 rad/s."""


class Pair(NamedTuple):
    """The difference of two velocities, per cent of the closed form's final velocity.

    Attributes:
        band: the source's figure for this pair, per cent, None if it gives none.
    """

    first: str
    second: str
    worst: float
    rms: float
    band: float | None

    @property
    def within(self) -> bool:
        """Return whether the difference stays within the source's band."""
        return self.band is None or self.worst <= self.band


class FourWay(NamedTuple):
    """Velocities of one ramp, motor side: time s, shape (n,), and rad/s by name, each of shape (n,)."""

    time: Array
    velocities: dict[str, Array]
    pairs: list[Pair]


def _from_break_away(model: RampModel, time: Array, acceleration: Callable[[float, float], float]) -> Array:
    """Integrate a shaft's acceleration, of time and speed, from rest at break-away; return its speed, rad/s."""
    moving = time > model.break_away_time
    velocity = np.zeros_like(time)
    if moving.any():
        span = (model.break_away_time, float(time[-1]))
        solution = solve_ivp(
            lambda t, state: [acceleration(t, float(state[0]))],
            span, [0.0], "LSODA", time[moving], rtol=1e-9, atol=1e-9,
        )  # fmt: skip
        velocity[moving] = solution.y[0]
    return velocity


def integrate_equation_3(model: RampModel, time: Array) -> Array:
    """Return the velocity of J w' = m t - f_v w - f_c sgn w from rest, rad/s, integrated numerically.

    The joint rests until the ramp exceeds f_c; the solver starts there, where sgn w is one from then on.
    """
    m, viscous, coulomb, inertia = model.slope, model.viscous, model.coulomb, model.inertia
    return _from_break_away(model, time, lambda t, speed: (m * t - viscous * speed - coulomb) / inertia)


def simulate_multibody(model: RampModel, ratio: float, time: Array) -> Array:
    """Return the motor's velocity, rad/s, of a revolute joint about z behind a gear.

    A disc on the load shaft holds half of the inertia and the geared rotor the other half, so that both ways in which
    a multibody program holds inertia take part in the articulated-body algorithm.
    """
    joint = pin.Model()
    joint.gravity = pin.Motion.Zero()
    joint.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "revolute")
    spin = model.inertia / 2 * ratio**2
    joint.appendBodyToJoint(1, pin.Inertia(1.0, np.zeros(3), np.diag([spin / 2, spin / 2, spin])), pin.SE3.Identity())
    joint.armature = np.array([spin])
    data = joint.createData()

    def acceleration(t: float, motor: float) -> float:
        torque = model.slope * t - model.viscous * motor - model.coulomb
        return ratio * float(
            pin.aba(joint, data, np.zeros(1), np.array([motor / ratio]), np.array([torque * ratio]))[0]
        )

    return _from_break_away(model, time, acceleration)


def measured_velocity(record: RampRecord) -> tuple[Array, Array]:
    """Return times and mean velocities of a record, differences over SMOOTHING readings, each shape (n,)."""
    time = record.time - record.origin
    width = min(SMOOTHING, time.size - 1)
    velocity = (record.angle[width:] - record.angle[:-width]) / (time[width:] - time[:-width])
    return (time[width:] + time[:-width]) / 2, velocity


def compare(record: RampRecord, model: RampModel, ratio: float) -> FourWay:
    """Compare one ramp with the three models of the identified friction.

    Args:
        record: the experiment.
        model: friction and inertia at the motor, with the record's slope.
        ratio: of the gear.
    """
    time, experiment = measured_velocity(record)
    keep = time > 0.0
    time = time[keep]
    velocities = {
        EXPERIMENT: experiment[keep],
        BLOCK: integrate_equation_3(model, time),
        MULTIBODY: simulate_multibody(model, ratio, time),
        CLOSED: model.velocity(time),
    }
    final = float(velocities[CLOSED][-1])
    pairs = []
    for first, second in combinations(velocities, 2):
        difference = 100.0 * (velocities[first] - velocities[second]) / final
        worst, rms = float(np.abs(difference).max()), float(np.sqrt(np.mean(difference**2)))
        pairs.append(Pair(first, second, worst, rms, SOURCE_BANDS.get(frozenset((first, second)))))
    return FourWay(time, velocities, pairs)
