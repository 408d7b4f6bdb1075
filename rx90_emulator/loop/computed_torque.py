"""Computed torque with friction compensation: an example of a controller of one's own."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.loop.setup import Setup

BANDWIDTH: Final = 40.0
"""Of the error's critically damped decay, rad/s."""
_TABLE_ROWS = 5000  # rows for each sign of the velocity
_FULL_COMPENSATION_SPEED = 0.002  # rad/s of the set-point at which the friction is compensated in full


class ComputedTorque:
    """M(q) (a_d + 2 w e' + w^2 e) + h(q, v) + friction(v_d), along a motion of all joints there and back.

    The torque of the rigid arm is that of `RigidArm` (Pinocchio's recursive Newton-Euler), with the law of computed
    torque as in Siciliano, Sciavicco, Villani, Oriolo (2009), section 8.5.2. The friction is that of the friction file
    in steady sliding, at the velocity of the set-point: at the measured one it would be a positive feedback where the
    friction falls with the speed.

    Args:
        setup: the arm as the controller knows it; give `run_controller` another one to see what it makes of errors.
        amplitude: of the motion from where the arm stands when it is first asked, rad.
        period: of the motion there and back, s.
        friction: whether friction is compensated.

    Attributes:
        errors: set-point less position in each call, rad, each of shape (n,).
    """

    def __init__(self, setup: Setup, amplitude: float = 0.3, period: float = 4.0, *, friction: bool = True) -> None:
        self._arm = RigidArm.from_setup(setup)
        self._half, self._speed = 0.5 * amplitude, 2.0 * math.pi / period
        # Tabulated, because the curves of seven elements take longer than everything else in a call.
        self._fastest = self._half * self._speed
        speeds = np.linspace(-self._fastest, self._fastest, 2 * _TABLE_ROWS + 1)
        self._friction = friction * _compensation(setup, speeds)
        self._begin: tuple[float, Array] | None = None
        self.errors: list[Array] = []

    def __call__(self, position: Array, velocity: Array, time: float) -> Array:
        """Return efforts, Nm, shape (n,), for measured positions rad, velocities rad/s and time s."""
        if self._begin is None:
            self._begin = time, position
        begin, home = self._begin
        angle, w = self._speed * (time - begin), BANDWIDTH
        # Every joint moves alike, by a cosine.
        away = self._half * (1.0 - math.cos(angle))
        speed = self._half * self._speed * math.sin(angle)
        error = home + away - position
        self.errors.append(error)
        acceleration = self._half * self._speed**2 * math.cos(angle) + 2.0 * w * (speed - velocity) + w * w * error
        effort: Array = self._arm.torque(position[None], velocity[None], acceleration[None])[0]
        row: Array = self._friction[_TABLE_ROWS + round(_TABLE_ROWS * speed / self._fastest)]
        return effort + row


def _compensation(setup: Setup, speeds: Array) -> Array:
    """Return the friction torque at joints that all turn with each of the speeds, rad/s, shape (k, n)."""
    matrix = setup.drives.turning.element_matrix
    inputs = speeds[:, None] * matrix.sum(axis=1)
    columns = [one.steady_torque(v) for one, v in zip(setup.friction.elements, inputs.T, strict=True)]
    # Not at once at a reversal, where the bristles have yet to bend.
    full: Array = np.minimum(1.0, np.abs(speeds) / _FULL_COMPENSATION_SPEED)
    return full[:, None] * (np.stack(columns, axis=1) @ matrix)
