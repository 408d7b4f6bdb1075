"""How motions follow on each other.

On a continuous path the next one begins before the end of the one before, so that the shorter of the two ramps that
meet lies within the other: their velocities add up, and the corner becomes a parabola.
"""

from __future__ import annotations

import math

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import Pose
from rx90_emulator.cabinet.arm import ProgrammedArm
from rx90_emulator.cabinet.plan import Line, Motion

_STEP = 1e-4  # s, of differences
_RATE_TIME = 0.3  # s in which the monitor speed goes from 0 to 100 %


class MotionQueue:
    """One motion that runs, at most one that waits for it, and the set-points.

    Attributes:
        arm: what moves.
        destination: joint angles at the end of the newest motion, rad, shape (6,).
        position: the set-points now, rad, shape (6,).
        monitor: the monitor speed, percent.
        done: the motions that have begun, in their order.
        waiting: the motion that has not begun.
        stopping: whether the arm slows down to a stop; where it will stand is not known before.
    """

    def __init__(self, arm: ProgrammedArm, q: Array) -> None:
        self.arm = arm
        self.destination = q
        self.position = q
        self.monitor = 100.0
        self.done: list[Motion] = []
        self.waiting: Motion | None = None
        self._running: list[Motion] = []
        self._path_time = 0.0
        self._rate = 1.0
        self.stopping = False

    @property
    def at_end(self) -> bool:
        """Return whether no motion runs or waits."""
        return not self._running and self.waiting is None

    def give(self, motion: Motion, settled: bool, time: float) -> None:
        """Take a motion; it begins at once if none runs, and the arm has settled where it must."""
        self.destination = motion.end
        self.waiting = motion
        before = self._running[-1] if self._running else None
        if before is not None and before.continuous and motion.kind != "DELAY":
            overlap = min(before.profile.ramp_down, motion.profile.ramp_up)
            motion.begin = max(before.over - overlap, self._path_time)
        self.begin_waiting(settled, time)

    def begin_waiting(self, settled: bool, time: float) -> None:
        """Begin the motion that waits, if the one before it is over, and settled where it must be."""
        if self._running:
            return
        if settled and self.done and math.isnan(self.done[-1].settled):
            self.done[-1].settled = time
        is_due = settled or not self.done or not self.done[-1].nulls
        if self.waiting is not None and is_due:
            self.waiting.begin = self._path_time
            self._begin(self.waiting, time)

    def _begin(self, motion: Motion, time: float) -> None:
        motion.began = time
        for action in motion.at_start:
            action()
        self._running.append(motion)
        self.done.append(motion)
        self.waiting = None

    def stop(self) -> None:
        """End the motion at once: slow down on the path, and drop what is left of it."""
        self.waiting = None
        self.stopping = not self.at_end

    def drop(self, q: Array) -> None:
        """Forget all motions: the power is off, and the arm stands at joint angles, rad, shape (6,)."""
        self.waiting = None
        self._running = []
        self.stopping = False
        self.position = self.destination = q

    def advance(self, period: float, time: float) -> tuple[Array, Array]:
        """Go on by a period, s, that begins at a simulated time, s; return position and velocity at its end.

        Returns:
            Joint angles, rad, and their speeds, rad/s, shape (6,).
        """
        rate = 0.0 if self.stopping else self.monitor / 100.0
        if self._running:
            most = period / _RATE_TIME
            rate = self._rate + float(np.clip(rate - self._rate, -most, most))
            self._path_time += period * (self._rate + rate) / 2.0
        self._rate = rate
        if self.waiting is not None and self.waiting.begin < self._path_time:
            self._begin(self.waiting, time)
        rows = self._angles(self._path_time + np.array([-_STEP, 0.0, _STEP]))
        self.position = rows[1]
        self._end(time + period)
        if not self._running:
            return self.position, np.zeros(6)
        return self.position, (rows[2] - rows[0]) / (2.0 * _STEP) * rate

    def _end(self, time: float) -> None:
        """Let go of motions that are over, or of all when the arm was to stop and stands."""
        stopped = self.stopping and self._rate == 0.0
        for motion in [*self._running]:
            if motion.over <= self._path_time or stopped:
                motion.ended = time
                motion.nulls &= not stopped
                self._running.remove(motion)
                self.position = self.position if stopped or self._running else motion.end
        if stopped:
            self.stopping = False
            self.destination = self.position

    def _angles(self, times: Array) -> Array:
        """Return joint angles, rad, shape (n, 6), at times around the present one on the path, s."""
        if not self._running:
            return np.repeat(self.position[None], len(times), axis=0)
        # At most two: the third one begins when the first one is over, but within the same period.
        running = [motion for motion in self._running if motion.over > self._path_time]
        running = running or self._running[-1:]
        shares = [motion.profile.share(times - motion.begin) for motion in running]
        first = running[0].line
        last = running[-1].line
        if first is not last and first is not None and last is not None:
            return self._corner(first.tools(shares[0]), last, shares[-1])
        angles = np.repeat(running[0].start[None], len(times), axis=0)
        for motion, share in zip(running, shares, strict=True):
            if motion.line is None:
                angles += share[:, None] * (motion.end - motion.start)
            else:
                angles += self._solved(motion.line, motion.line.tools(share)) - motion.start
        return angles

    def _corner(self, ending: Pose, line: Line, share: Array) -> Array:
        """Return joint angles where a line adds up with the end of another."""
        tools = line.tools(share)
        position = tools.position + ending.position - line.start.translation
        turns = line.start.rotation.T @ tools.rotation
        return self._solved(line, Pose(position, ending.rotation @ turns))

    def _solved(self, line: Line, tools: Pose) -> Array:
        return self.arm.solve(line.flanges(tools), line.configuration, self.position)
