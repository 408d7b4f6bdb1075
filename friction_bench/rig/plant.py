"""The emulated rig's mechanics: motor in torque mode, gear, load shaft, revolute joint, encoder.

One degree of freedom, described on the motor's side (angle theta, speed w):
    J w' = tau_motor - (f_v w + f_c sgn w) - tau_joint(w / n) / (n eta),
    J = J_rotor + (J_load + J_joint) / (n^2 eta),
with gear ratio n and efficiency eta, the motor driving the load. The joint is there only when loaded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_bench.rig.joint_parts import RigJoint, joint_record, start, turn_with_parts
from friction_bench.rig.shaft import BRISTLE_STEPS, Shaft, turn
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import element_arrays, one_element
from rx90_common.friction.element import FrictionElement
from rx90_common.kernels.compiled import kernel


@dataclass(frozen=True)
class JointFriction:
    """Coulomb and viscous friction of the revolute joint at the load: Nm and Nm s/rad."""

    coulomb: float
    viscous: float


PART_PERIOD = 1e-3
"""Time for which the torque is held, s: the slice in which firmware and plant exchange theirs."""


@dataclass(frozen=True)
class PlantParameters:
    """What the emulated rig is made of; motor side, SI, unless a name says load or joint.

    Attributes:
        gain_error: standard deviation of the amplifier's relative gain error, drawn once per rig.
        torque_noise: standard deviation of the torque noise, averaged over 1 ms, Nm.
        adc_noise: standard deviation of a torque reading, Nm.
        load_inertia, joint_inertia: at the load, kg m².
        coulomb, viscous: friction of motor, brushes, gear and bearings.
        joint: friction of the revolute joint, at the load: Coulomb and viscous, or LuGre.
    """

    gear_ratio: float
    gear_efficiency: float
    torque_constant: float
    resistance: float
    supply: float
    rotor_inertia: float
    gain_error: float
    torque_noise: float
    adc_noise: float
    load_inertia: float
    joint_inertia: float
    coulomb: float
    viscous: float
    joint: JointFriction | FrictionElement

    def shaft(self, loaded: bool) -> Shaft:
        """Return what turns at the motor, sliding forward; without the friction of a LuGre joint."""
        scale = self.gear_ratio * self.gear_efficiency
        load = self.load_inertia + (self.joint_inertia if loaded else 0.0)
        inertia = self.rotor_inertia + load / (self.gear_ratio**2 * self.gear_efficiency)
        joint = self.joint
        if not loaded or isinstance(joint, FrictionElement):
            return Shaft(inertia, self.coulomb, self.viscous)
        viscous = self.viscous + joint.viscous / (scale * self.gear_ratio)
        return Shaft(inertia, self.coulomb + joint.coulomb / scale, viscous)


@kernel
def turn_with_joint(
    angle: float,
    speed: float,
    z: float,
    torque: float,
    shaft: Shaft,
    gear: tuple[float, float],
    joint: NDArray[np.void],
    dt: float,
) -> tuple[float, float, float]:
    """Advance as `turn`, with a LuGre joint behind the gear (ratio and efficiency).

    Returns angle, speed and bristle deflection.
    """
    step, element = dt / BRISTLE_STEPS, one_element(joint[0], 0)
    ratio, efficiency = gear
    for _ in range(BRISTLE_STEPS):
        z, friction = bristle_step(element, z, speed / ratio, step)
        angle, speed = turn(angle, speed, torque - friction / (ratio * efficiency), shaft, step)
    return angle, speed, z


class RigPlant:
    """The mechanics of one rig in motion; seeded, so that a run can be repeated bit for bit.

    Args:
        parameters: the rig.
        counts_per_revolution: of the encoder on the motor's shaft.
        seed: of amplifier, converter, encoder phase and the joint's scatter.
        counts_down: the encoder tells the direction; else its edges count up in both.
    """

    def __init__(
        self, parameters: PlantParameters, counts_per_revolution: int, seed: int, counts_down: bool = False
    ) -> None:
        self.parameters = parameters
        self._counts_down = counts_down
        self._element: NDArray[np.void] | None = None
        self._joint: RigJoint | None = None
        joint = parameters.joint
        if isinstance(joint, FrictionElement):
            if joint.parts:
                self._joint = joint_record(joint, parameters.gear_ratio, PART_PERIOD, seed)
            else:
                self._element = element_arrays((joint,))
        self.angle = self.torque = 0.0
        self.load(False)
        self._rng = np.random.default_rng(seed)
        self._scale = counts_per_revolution / math.tau
        self._phase = self._rng.random()
        self._gain = 1.0 + parameters.gain_error * self._rng.standard_normal()
        self._last_count = math.floor(self._phase)
        self._noise: Iterator[float] = iter(())

    def load(self, loaded: bool) -> None:
        """Couple the revolute joint to the load shaft, or take it off; the shaft is at rest then."""
        self.loaded = loaded
        self.speed = self.bristle = 0.0
        self._shaft = self.parameters.shaft(loaded)
        if self._joint is not None:
            start(self._joint)

    def _normal(self) -> float:
        for value in self._noise:
            return value
        self._noise = iter(self._rng.standard_normal(4096).tolist())
        return self._normal()

    def motor_torque(self, command: float, dt: float) -> float:
        """Return the torque, Nm, that the amplifier makes of `command` over `dt`.

        The supply limits the current against the back-EMF; the transistor stage cannot pull it below zero.
        """
        p = self.parameters
        if command <= 0.0:
            return 0.0
        noise = p.torque_noise * math.sqrt(1e-3 / dt) * self._normal() if p.torque_noise else 0.0
        highest = (p.supply - p.torque_constant * self.speed) / p.resistance * p.torque_constant
        return max(0.0, min(self._gain * command + noise, highest))

    def advance(self, command: float, dt: float) -> int:
        """Hold the commanded torque, Nm, for `dt` seconds; return the encoder counts in that time.

        They are negative where the motor turned back, if the encoder tells the direction.
        """
        self.torque = self.motor_torque(command, dt)
        self._move(dt)
        count = math.floor(self.angle * self._scale + self._phase)
        edges = count - self._last_count
        self._last_count = count
        return edges if self._counts_down else abs(edges)

    def _move(self, dt: float) -> None:
        state = self.angle, self.speed
        p = self.parameters
        gear = p.gear_ratio, p.gear_efficiency
        if self.loaded and self._joint is not None:
            beyond = p.load_inertia + p.joint_inertia
            self.angle, self.speed, self.bristle = turn_with_parts(
                (*state, self.bristle), self.torque, self._shaft, gear, beyond, self._joint, dt
            )
        elif self.loaded and self._element is not None:
            self.angle, self.speed, self.bristle = turn_with_joint(
                *state, self.bristle, self.torque, self._shaft, gear, self._element, dt
            )
        else:
            self.angle, self.speed = turn(*state, self.torque, self._shaft, dt)

    def current_reading(self) -> float:
        """Return what the current sense amplifier shows, as motor torque, Nm."""
        return max(0.0, self.torque + self.parameters.adc_noise * self._normal())
