"""The emulated rig's mechanics: motor in torque mode, gear, load shaft, revolute joint, encoder.

One degree of freedom, described on the motor's side (angle theta, speed w):
    J w' = tau_motor - (f_v w + f_c sgn w) - tau_joint(w / n) / (n eta),
    J = J_rotor + (J_load + J_joint) / (n^2 eta),
with gear ratio n and efficiency eta, the motor driving the load. The joint is there only when loaded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rx90_common.friction.bristle import bristle_step, one_element
from rx90_common.friction.lugre import LuGreElement, element_arrays
from rx90_common.kernels.compiled import kernel


@dataclass(frozen=True)
class JointFriction:
    """Coulomb and viscous friction of the revolute joint at the load: Nm and Nm s/rad."""

    coulomb: float
    viscous: float


@dataclass(frozen=True)
class PlantParameters:
    """What the emulated rig is made of; motor side, SI, unless a name says load or joint.

    Attributes:
        gain_error: standard deviation of the amplifier's relative gain error, drawn once per rig.
        torque_noise: standard deviation of the torque noise's means over 1 ms, Nm.
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
    joint: JointFriction | LuGreElement

    def inertia(self, loaded: bool) -> float:
        """Return the inertia at the motor, kg m²."""
        load = self.load_inertia + (self.joint_inertia if loaded else 0.0)
        return self.rotor_inertia + load / (self.gear_ratio**2 * self.gear_efficiency)

    def friction(self, loaded: bool) -> tuple[float, float]:
        """Return Coulomb torque, Nm, and viscous coefficient, Nm s/rad, at the motor, sliding forward."""
        if not loaded:
            return self.coulomb, self.viscous
        scale = self.gear_ratio * self.gear_efficiency
        if isinstance(self.joint, LuGreElement):
            coulomb, viscous = self.joint.tau_c_positive, self.joint.c2
        else:
            coulomb, viscous = self.joint.coulomb, self.joint.viscous
        return self.coulomb + coulomb / scale, self.viscous + viscous / (scale * self.gear_ratio)

    def noiseless(self) -> PlantParameters:
        """Return the same rig with perfect electronics."""
        return replace(self, gain_error=0.0, torque_noise=0.0, adc_noise=0.0)


@kernel
def slide(
    angle: float, speed: float, torque: float, inertia: float, coulomb: float, viscous: float, dt: float
) -> tuple[float, float]:
    """Advance J w' = torque - f_v w - f_c sgn w over `dt` with a constant torque, exactly.

    Returns angle and speed. A body that comes to rest stays there unless the torque exceeds f_c.
    """
    left = dt
    for _ in range(2):  # at most one reversal: torque is constant
        sign = 1.0 if speed > 0.0 or (speed == 0.0 and torque > 0.0) else -1.0
        if speed == 0.0 and abs(torque) <= coulomb:
            return angle, 0.0
        final = (torque - sign * coulomb) / viscous
        tau = inertia / viscous
        run = left
        stops = speed * final < 0.0
        if stops:
            rest = tau * math.log((final - speed) / final)
            stops = rest < left
            run = min(rest, left)
        decay = math.exp(-run / tau)
        angle += final * run + (speed - final) * tau * (1.0 - decay)
        speed = final + (speed - final) * decay
        if not stops:
            return angle, speed
        speed = 0.0
        left -= run
    return angle, speed


_BRISTLE_STEPS = 20
"""Substeps of a slice with LuGre friction: 50 µs, a sixtieth of the stiffest joint's period."""


@kernel
def slide_with_bristles(
    angle: float,
    speed: float,
    z: float,
    torque: float,
    inertia: float,
    coulomb: float,
    viscous: float,
    ratio: float,
    efficiency: float,
    joint: NDArray[np.void],
    dt: float,
) -> tuple[float, float, float]:
    """Advance as `slide`, with a LuGre joint behind the gear; return angle, speed and bristle deflection."""
    step, element = dt / _BRISTLE_STEPS, one_element(joint[0], 0)
    for _ in range(_BRISTLE_STEPS):
        z, friction = bristle_step(element, z, speed / ratio, step)
        angle, speed = slide(angle, speed, torque - friction / (ratio * efficiency), inertia, coulomb, viscous, step)
    return angle, speed, z


class Plant:
    """The mechanics of one rig in motion; seeded, so that a run can be repeated bit for bit.

    Args:
        parameters: the rig.
        counts_per_revolution: of the encoder on the motor's shaft.
        seed: of amplifier, converter and encoder phase.
    """

    def __init__(self, parameters: PlantParameters, counts_per_revolution: int, seed: int) -> None:
        self.parameters = parameters
        self.loaded = False
        self.angle = 0.0
        self.speed = 0.0
        self.torque = 0.0
        self.bristle = 0.0
        self._element = element_arrays((parameters.joint,)) if isinstance(parameters.joint, LuGreElement) else None
        self._rng = np.random.default_rng(seed)
        self._scale = counts_per_revolution / math.tau
        self._phase = self._rng.random()
        self._gain = 1.0 + parameters.gain_error * self._rng.standard_normal()
        self._last_count = math.floor(self._phase)
        self._noise: Iterator[float] = iter(())

    def load(self, loaded: bool) -> None:
        """Couple the revolute joint to the load shaft, or take it off; the shaft is at rest then."""
        self.loaded = loaded
        self.speed = 0.0
        self.bristle = 0.0

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
        """Hold the commanded torque, Nm, for `dt` seconds; return the encoder counts in that time."""
        self.torque = self.motor_torque(command, dt)
        self._move(dt)
        count = math.floor(self.angle * self._scale + self._phase)
        edges = abs(count - self._last_count)
        self._last_count = count
        return edges

    def _move(self, dt: float) -> None:
        p = self.parameters
        inertia = p.inertia(self.loaded)
        if self.loaded and self._element is not None:
            self.angle, self.speed, self.bristle = slide_with_bristles(
                self.angle,
                self.speed,
                self.bristle,
                self.torque,
                inertia,
                p.coulomb,
                p.viscous,
                p.gear_ratio,
                p.gear_efficiency,
                self._element,
                dt,
            )
            return
        coulomb, viscous = p.friction(self.loaded)
        self.angle, self.speed = slide(self.angle, self.speed, self.torque, inertia, coulomb, viscous, dt)

    def current_reading(self) -> float:
        """Return what the current sense amplifier shows, as motor torque, Nm."""
        return max(0.0, self.torque + self.parameters.adc_noise * self._normal())
