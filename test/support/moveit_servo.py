"""MoveIt Servo's loop for joint jogs, written anew from its source."""

from types import SimpleNamespace

import numpy as np
from joint_moves import trajectory

from rx90_common.base.arrays import Array


class Servo:
    """Joint jogs by moveit2, jazzy, 4d84106: servo_node.cpp, servo.cpp, utils/common.cpp; states (stamp, q, v)."""

    PERIOD, LATENCY, COEFFICIENT = 0.01, 0.1, 1.5  # publish_period, max_expected_latency, low_pass_filter_coeff

    def __init__(self, position: Array) -> None:
        self.window: list[tuple[float, Array, Array]] = []
        self._in, self._out = position.copy(), position.copy()

    def _smooth(self, position: Array) -> tuple[Array, Array]:
        before, self._in = self._in, position
        last = self._out
        self._out = (position + before - (1.0 - self.COEFFICIENT) * last) / (1.0 + self.COEFFICIENT)
        return self._out, (self._out - last) / self.PERIOD

    def cycle(self, now: float, velocity: Array | None, measured: Array) -> SimpleNamespace | None:
        """Return what one cycle publishes: at a velocity, or None for a command that has timed out."""
        if self.window and self.window[-1][0] > now:
            _, current, last = self.window[-1]
        else:
            self.window.clear()
            current, last = measured, np.zeros(6)
            self._in = self._out = measured.copy()
        if velocity is None and (np.abs(last) < 1e-4).all():
            return None
        target = current if velocity is None else current + velocity * self.PERIOD
        self._update_window(now, *self._smooth(target))
        if len(self.window) < 3:
            return None
        first = self.window[0][0]
        stamps, positions, velocities = zip(*self.window[:-1], strict=True)
        return trajectory([stamp - first for stamp in stamps], positions, velocities, start=first)

    def _update_window(self, now: float, position: Array, velocity: Array) -> None:
        stamp = now + self.LATENCY
        while self.window and self.window[0][0] < now - self.LATENCY:
            self.window.pop(0)
        while self.window and self.window[-1][0] == stamp:
            self.window.pop()
        if len(self.window) >= 2:
            (t0, q0, _), (t1, q1, _) = self.window[-2:]
            signs = np.sign(q0 - q1) - np.sign(position - q1)
            v1, v2 = (position - q1) / (stamp - t1), (q1 - q0) / (t1 - t0)
            last = np.where(signs == 0, 0.0, np.where(np.abs(v1) < np.abs(v2), v1, v2))
            self.window[-1], velocity = (t1, q1, last), last.copy()
        self.window.append((stamp, position, velocity))
