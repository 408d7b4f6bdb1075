"""The emulated rig's mechanics: motor in torque mode, gear, load shaft, revolute joint, encoder.

One degree of freedom, described on the motor's side (angle theta, speed w):
    J w' = tau_motor - (f_v w + f_c sgn w) - tau_joint(w / n) / (n eta),
    J = J_rotor + (J_load + J_joint) / (n^2 eta),
with gear ratio n and efficiency eta, the motor driving the load. The joint is there only when loaded; one with LuGre's
law moves by the arm's own steps of rx90_common/friction, with all parts of its element.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from friction_bench.rig.messages import RigInputError
from friction_bench.rig.rig_file import JointFriction, Rig
from rx90_common.friction.compiled_elements import element_arrays
from rx90_common.friction.element import FrictionElement
from rx90_common.friction.parts.step import (
    advance_parts,
    fill_parts,
    parts_dtype,
    parts_state_dtype,
    parts_step,
    reset_parts,
    tick_parts,
)
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import lane, load

SLICE = 1e-3
"""Time for which the torque is held, s: the slice in which firmware and plant exchange theirs."""
BRISTLE_STEPS = 20
"""Substeps of a slice with LuGre friction: 50 µs, a sixtieth of the stiffest joint's period."""


class Shaft(NamedTuple):
    """What turns, at the motor: inertia, kg m², Coulomb friction, Nm, and viscous friction, Nm s/rad."""

    inertia: float
    coulomb: float
    viscous: float


def shaft_of(rig: Rig, loaded: bool) -> Shaft:
    """Return the inertia and friction at the motor of an emulated rig, without the friction of a LuGre joint."""
    p = rig.emulation
    if p is None:
        raise RigInputError(
            f"{rig.file}: has no section 'emulation', so this rig cannot be emulated"
        )
    load_inertia = p.load_inertia + (p.joint_inertia if loaded else 0.0)
    inertia = p.motor.rotor_inertia + load_inertia / (rig.gear.ratio**2 * rig.gear.efficiency)
    viscous = p.motor_friction.viscous
    if loaded:
        viscous *= 1.0 + p.motor_friction.warming
    if not loaded or not isinstance(p.joint, JointFriction):
        return Shaft(inertia, p.motor_friction.coulomb, viscous)
    coulomb = p.motor_friction.coulomb + p.joint.coulomb / rig.joint_scale
    return Shaft(inertia, coulomb, viscous + p.joint.viscous / (rig.joint_scale * rig.gear.ratio))


@kernel
def turn(angle: float, speed: float, torque: float, shaft: Shaft, dt: float) -> tuple[float, float]:
    """Advance J w' = torque - f_v w - f_c sgn w over `dt` with a constant torque, exactly.

    Returns angle and speed. A body that comes to rest stays there unless the torque exceeds f_c.
    """
    remaining = dt
    for _ in range(2):  # at most one reversal: torque is constant
        sign = 1.0 if speed > 0.0 or (speed == 0.0 and torque > 0.0) else -1.0
        if speed == 0.0 and abs(torque) <= shaft.coulomb:
            return angle, 0.0
        final = (torque - sign * shaft.coulomb) / shaft.viscous
        tau = shaft.inertia / shaft.viscous
        run = remaining
        stops = speed * final < 0.0
        if stops:
            rest = tau * math.log((final - speed) / final)
            stops = rest < remaining
            run = min(rest, remaining)
        decay = math.exp(-run / tau)
        angle += final * run + (speed - final) * tau * (1.0 - decay)
        speed = final + (speed - final) * decay
        if not stops:
            return angle, speed
        speed = 0.0
        remaining -= run
    return angle, speed


class RigJoint(NamedTuple):
    """One joint as compiled code has it, each of shape (1,): element, its parts, and their state."""

    element: NDArray[np.void]
    parts: NDArray[np.void]
    state: NDArray[np.void]


def joint_record(element: FrictionElement, gear_ratio: float, period: float, seed: int) -> RigJoint:
    """Return the record of a joint that has not moved.

    Args:
        element: its friction.
        gear_ratio: turns of the motor for one of the joint.
        period: for which the torque is held, s.
        seed: of the scatter.
    """
    record = RigJoint(
        element_arrays((element,)), np.zeros(1, parts_dtype(1)), np.zeros(1, parts_state_dtype(1))
    )
    fill_parts(record.parts[0], (element,), (gear_ratio,), period, seed)
    start(record)
    return record


@kernel
def start(joint: RigJoint) -> None:
    """Begin anew: no transmitted torque, no deflection."""
    state = joint.state[0]
    state.transmitted[0] = 0.0
    reset_parts(joint.parts[0], state, load(state.transmitted, 1), 1)


@kernel
def turn_with_joint(
    motion: tuple[float, float, float],
    torque: float,
    shaft: Shaft,
    gear: tuple[float, float, float],
    joint: RigJoint,
    dt: float,
) -> tuple[float, float, float]:
    """Advance as `turn`, with a LuGre joint behind the gear.

    Args:
        motion: angle and speed of the motor, rad and rad/s, deflection of the bristles, rad.
        torque: of the motor, Nm.
        shaft: inertia and friction at the motor.
        gear: its ratio and efficiency, and the inertia behind it, kg m², whose torque is the load that the joint
            transmits.
        joint: advanced in place.
        dt: s.
    """
    angle, speed, z = motion
    ratio, efficiency, load_inertia = gear
    step = dt / BRISTLE_STEPS
    element = joint.element[0]
    parts = joint.parts[0]
    state = joint.state[0]
    still = 0.0 * load(state.transmitted, 1)
    for _ in range(BRISTLE_STEPS):
        of_joint = still + angle / ratio, still + speed / ratio
        deflections, friction = parts_step(
            element, parts, state, still + z, of_joint[0], of_joint[1], step, 1
        )
        z = lane(deflections, 0)
        before = speed
        angle, speed = turn(
            angle, speed, torque - lane(friction, 0) / (ratio * efficiency), shaft, step
        )
        state.transmitted[0] = load_inertia * (speed - before) / (ratio * step)
        advance_parts(parts, state, load(state.transmitted, 1), step, 1)
    tick_parts(parts, state, load(state.transmitted, 1), dt, 1)
    return angle, speed, z


class RigPlant:
    """The mechanics of one rig in motion; seeded, so that a run can be repeated bit for bit.

    Args:
        rig: whose file describes a plant.
        seed: of amplifier, converter, encoder phase and the joint's scatter.
    """

    def __init__(self, rig: Rig, seed: int) -> None:
        self.rig = rig
        self._shafts = [shaft_of(rig, loaded) for loaded in (False, True)]
        assert rig.emulation is not None  # shaft_of refuses it
        self.parameters = rig.emulation
        self._joint: RigJoint | None = None
        if isinstance(rig.emulation.joint, FrictionElement):
            self._joint = joint_record(rig.emulation.joint, rig.gear.ratio, SLICE, seed)
        self._gear = (
            rig.gear.ratio,
            rig.gear.efficiency,
            rig.emulation.load_inertia + rig.emulation.joint_inertia,
        )
        self.angle = self.torque = 0.0
        self.load(False)
        self._rng = np.random.default_rng(seed)
        self._scale = rig.counts_per_revolution / math.tau
        self._phase = self._rng.random()
        self._gain = 1.0 + rig.emulation.amplifier.gain_error * self._rng.standard_normal()
        self._ramp_gain = 1.0
        self._last_count = math.floor(self._phase)
        self._noise = self._normals()

    def load(self, loaded: bool) -> None:
        """Couple the revolute joint to the load shaft, or take it off; the shaft is at rest then."""
        self.loaded = loaded
        self.speed = self.bristle = 0.0
        if self._joint is not None:
            start(self._joint)

    def new_ramp(self) -> None:
        """Draw the differences from ramp to ramp: the torque's scale, and the joint's Coulomb friction."""
        p = self.parameters
        if p.amplifier.ramp_error:
            self._ramp_gain = 1.0 + p.amplifier.ramp_error * next(self._noise)
        if p.joint_spread and isinstance(p.joint, JointFriction):
            drawn = max(0.0, 1.0 + p.joint_spread * next(self._noise))
            coulomb = p.motor_friction.coulomb + drawn * p.joint.coulomb / self.rig.joint_scale
            self._shafts[True] = self._shafts[True]._replace(coulomb=coulomb)

    def _normals(self) -> Iterator[float]:
        while True:
            yield from self._rng.standard_normal(4096).tolist()

    def motor_torque(self, command: float, dt: float) -> float:
        """Return the torque, Nm, that the amplifier makes of `command` over `dt`.

        The supply limits the current against the back-EMF; the stage pushes one way only.
        """
        if command == 0.0:
            return 0.0
        motor = self.parameters.motor
        deviation = self.parameters.amplifier.torque_noise
        noise = deviation * math.sqrt(1e-3 / dt) * next(self._noise) if deviation else 0.0
        highest = (
            (motor.supply - motor.torque_constant * self.speed)
            / motor.resistance
            * motor.torque_constant
        )
        return max(0.0, min(self._gain * self._ramp_gain * command + noise, highest))

    def advance(self, command: float, dt: float) -> int:
        """Hold the commanded torque, Nm, for `dt` seconds; return the encoder counts in that time, of any direction."""
        self.torque = self.motor_torque(command, dt)
        shaft = self._shafts[self.loaded]
        if self.loaded and self._joint is not None:
            self.angle, self.speed, self.bristle = turn_with_joint(
                (self.angle, self.speed, self.bristle),
                self.torque,
                shaft,
                self._gear,
                self._joint,
                dt,
            )
        else:
            self.angle, self.speed = turn(self.angle, self.speed, self.torque, shaft, dt)
        count = math.floor(self.angle * self._scale + self._phase)
        edges = count - self._last_count
        self._last_count = count
        return abs(edges)

    def current_reading(self) -> float:
        """Return the output of the current sense amplifier, as motor torque, Nm."""
        return max(0.0, self.torque + self.parameters.amplifier.adc_noise * next(self._noise))
