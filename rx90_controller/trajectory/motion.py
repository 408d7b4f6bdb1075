"""Trajectories composed of rests, moves, constant-velocity sweeps and micro-oscillations."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.rates import NANOSECONDS
from rx90_controller.trajectory import TrajectoryPoints

_RAMP_PEAK_ACCELERATION = 1.5  # of a quintic from rest to a velocity, times the mean acceleration
_KNOT_ANGLE = 0.55  # of the fastest sine between knots, rad: quintics between exact knots miss it by 1e-6 of its size
_LONGEST_KNOT_PERIOD = 0.02  # s, for the fades
# from 0 to 1, with neither slope nor bend at both ends
_FADE = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])


class Motion:
    """A trajectory that starts at rest and is extended piece by piece; every piece begins and ends at rest.

    Knots have position, velocity and acceleration, so that the controller interpolates with quintics, which are exactly
    straight between two knots of equal velocity.

    Args:
        start: joint positions at time 0, rad, shape (n,).

    Attributes:
        pose: where it ends, rad, shape (n,).
        duration: its duration so far, s.
    """

    def __init__(self, start: ArrayLike) -> None:
        self.pose: Array = np.array(start, dtype=np.float64)
        self.duration = 0.0
        self._rest = np.zeros_like(self.pose)
        self._knots = [(0.0, self.pose, self._rest, self._rest)]

    def rest(self, duration: float) -> None:
        """Stay for `duration`, s."""
        self._add(duration, self.pose)

    def move(self, target: ArrayLike, speed: Array | float, acceleration: float) -> None:
        """Go to `target`, rad, on a straight line in the joints, within speeds, rad/s, and an acceleration, rad/s²."""
        goal = np.array(target, dtype=np.float64)
        distance = np.abs(goal - self.pose)
        if not distance.any():
            return
        self._add(_on_tick(move_duration(distance, speed, acceleration)), goal)

    def sweep(self, direction: Array, speed: float, plateau: float, acceleration: float) -> None:
        """Move along `direction`, shape (n,), with `speed`, rad/s, constant for `plateau`, s.

        The speed, in units of the direction's, may be negative. Quintic ramps lead to it and back to rest.
        """
        ramp = _on_tick(max(0.05, _RAMP_PEAK_ACCELERATION * abs(speed) / acceleration))
        velocity = direction * speed
        self._add(ramp, self.pose + 0.5 * ramp * velocity, velocity)
        self._add(_on_tick(plateau), self.pose + _on_tick(plateau) * velocity, velocity)
        self._add(ramp, self.pose + 0.5 * ramp * velocity)

    def oscillate(
        self, direction: Array, amplitudes: Sequence[float], tones: Sequence[float], duration: float
    ) -> None:
        """Oscillate about the pose along `direction` with a sum of sines, faded in and out over a quarter each.

        Args:
            direction: shape (n,).
            amplitudes: of the sines, rad.
            tones: their frequencies, Hz.
            duration: s.
        """
        omega = 2.0 * np.pi * np.asarray(tones)
        amplitude = np.asarray(amplitudes)
        period = (
            math.floor(1e3 * min(_LONGEST_KNOT_PERIOD, _KNOT_ANGLE / (2.0 * math.pi * max(tones))))
            / 1e3
        )
        time: Array = np.arange(1, math.ceil(duration / period) + 1, dtype=np.float64) * period
        phase = np.outer(time, omega)
        whole = len(time) * period
        s = np.sin(phase) @ amplitude
        s_dot = np.cos(phase) @ (amplitude * omega)
        s_ddot = -np.sin(phase) @ (amplitude * omega**2)
        quarter = whole / 4.0
        share = np.clip(np.minimum(time, whole - time) / quarter, 0.0, 1.0)
        rate = np.where(time < whole / 2.0, 1.0, -1.0) / quarter
        w = _FADE(share)
        w_dot = _FADE.deriv()(share) * rate
        w_ddot = _FADE.deriv(2)(share) * rate**2
        faded = [w * s, w_dot * s + w * s_dot, w_ddot * s + 2.0 * w_dot * s_dot + w * s_ddot]
        way, velocity, acceleration = np.stack(faded)[:, :, None] * direction
        way[-1] = 0.0
        self.follow(time, self.pose + way, velocity, acceleration)

    def follow(self, time: Array, position: Array, velocity: Array, acceleration: Array) -> None:
        """Run through k given knots, the last of them at rest.

        Args:
            time: of the knots from now on, s, increasing, shape (k,).
            position: rad, shape (k, n).
            velocity: rad/s, shape (k, n).
            acceleration: rad/s², shape (k, n).
        """
        self._knots += zip(
            (self.duration + time).tolist(), position, velocity, acceleration, strict=True
        )
        self.pose = position[-1].copy()
        self.duration = self._knots[-1][0]
        self._knots[-1] = (self.duration, self.pose, self._rest, self._rest)

    def points(self, names: Sequence[str]) -> TrajectoryPoints:
        """Return the motion as points for the controller."""
        knots, *vectors = zip(*self._knots, strict=True)
        # Messages contain whole nanoseconds; the closed loop without ROS gets exactly the same times as the nodes.
        times = [round(time * NANOSECONDS) / NANOSECONDS for time in knots]
        return TrajectoryPoints.create(
            names, names, times, *(np.array(each).tolist() for each in vectors)
        )

    def _add(self, duration: float, pose: Array, velocity: Array | None = None) -> None:
        self.duration += duration
        self.pose = pose
        self._knots.append(
            (self.duration, pose, self._rest if velocity is None else velocity, self._rest)
        )


def move_duration(way: Array, speed: Array | float, acceleration: float) -> float:
    """Return how long quintics from rest to rest over ways, rad, take, s: up to 15/8 way/T, 10/√3 way/T²."""
    by_speed = 15.0 / 8.0 * way / speed
    by_acceleration = np.sqrt(10.0 / np.sqrt(3.0) * way / acceleration)
    return float(np.maximum(by_speed, by_acceleration).max())


def _on_tick(duration: float) -> float:
    """Round up to whole milliseconds: knots then lie on set-points."""
    return math.ceil(round(duration * 1e3, 6)) / 1e3
