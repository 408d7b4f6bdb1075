"""Motions of V+: joint-interpolated and straight ones, their speed over time, and how they follow on each other.

A motion goes its way in a share from 0 to 1 with a ramp up, an even speed and a ramp down. On a continuous path the
next one begins before the end of the one before, so that the shorter of the two ramps that meet lies within the other:
their velocities add up, and the corner becomes a parabola.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.branch import Branch
from rx90_emulator.vplus.arm import ProgrammedArm
from rx90_emulator.vplus.errors import VplusError
from rx90_emulator.vplus.transformations import axis_and_angle, inverse

_STEP: Final = 1e-4  # s, of differences
_GRID: Final = 8e-3  # s, between places on a line that are checked beforehand
_MOST_PLACES: Final = 4000
_RATE_TIME: Final = 0.3  # s in which the monitor speed goes from 0 to 100 %
_OVERSHOOT: Final = 1.5  # of the peak acceleration of a ramp without jumps
_NEVER: Final = math.inf


@dataclass(frozen=True)
class Profile:
    """The share of a way over time.

    Attributes:
        duration: s; 0 for no way.
        ramp_up: s.
        ramp_down: s.
        smooth: whether the acceleration has no jumps.
    """

    duration: float
    ramp_up: float = 0.0
    ramp_down: float = 0.0
    smooth: bool = False

    @classmethod
    def fastest(cls, speed: float, up: float, down: float, smooth: bool, least: float) -> Profile:
        """Return the fastest profile with a speed, 1/s, and ramps, 1/s^2, that takes at least some time, s."""
        if smooth:
            up = up / _OVERSHOOT
            down = down / _OVERSHOOT
        peak = min(speed, math.sqrt(2.0 / (1.0 / up + 1.0 / down)))
        ramp_up = peak / up
        ramp_down = peak / down
        duration = 1.0 / peak + (ramp_up + ramp_down) / 2.0
        return cls(duration, ramp_up, ramp_down, smooth).stretched(max(least / duration, 1.0))

    def stretched(self, factor: float) -> Profile:
        """Return the profile in so many times the time."""
        return Profile(self.duration * factor, self.ramp_up * factor, self.ramp_down * factor, self.smooth)

    def gentler(self, factor: float) -> Profile:
        """Return the profile with accelerations that are so many times smaller, at the same speed if the way allows."""
        raised = (_OVERSHOOT if self.smooth else 1.0) * self.peak / factor
        return Profile.fastest(self.peak, raised / self.ramp_up, raised / self.ramp_down, self.smooth, 0.0)

    @property
    def peak(self) -> float:
        """Return the even speed, 1/s."""
        return 1.0 / (self.duration - (self.ramp_up + self.ramp_down) / 2.0)

    def share(self, times: Array) -> Array:
        """Return the share that is done at times from the start, s, shape (n,)."""
        if self.duration == 0.0:
            return np.ones(len(times))
        after = self.duration - times
        even = times - self.ramp_up / 2.0
        begun = self._ramp(np.clip(times / self.ramp_up, 0.0, 1.0)) * self.ramp_up
        left = self._ramp(np.clip(after / self.ramp_down, 0.0, 1.0)) * self.ramp_down
        rising = self.peak * np.where(times < self.ramp_up, begun, even)
        return np.asarray(np.where(after < self.ramp_down, 1.0 - self.peak * left, rising))

    def _ramp(self, u: Array) -> Array:
        """Return the integral of the speed in a ramp, as shares of ramp and speed."""
        return np.asarray(u**3 - u**4 / 2.0 if self.smooth else u * u / 2.0)


@dataclass(eq=False)
class Motion:
    """A motion, from its plan to its end.

    Attributes:
        kind: the instruction's word.
        where: program and line.
        start: joint angles, rad, shape (6,).
        end: likewise.
        profile: the share of the way over time.
        line: the straight line of the tool; None for a motion of the joints.
        tool: the tool in use, mm.
        continuous: whether the next motion may begin before the end of this one.
        nulls: whether it is over only when the position errors are small.
        at_start: what happens when it begins.
        begin: time on the path, s; infinite until it is known.
        began: simulated time, s.
        ended: simulated time, s.
    """

    kind: str
    where: str
    start: Array
    end: Array
    profile: Profile
    line: Line | None = None
    tool: Array = field(default_factory=lambda: np.eye(4))
    continuous: bool = True
    nulls: bool = True
    at_start: list[Callable[[], None]] = field(default_factory=list)
    begin: float = _NEVER
    began: float = math.nan
    ended: float = math.nan

    @property
    def over(self) -> float:
        """Return the time on the path at which it ends, s."""
        return self.begin + self.profile.duration

    def angles(self, times: Array) -> Array:
        """Return joint angles, rad, shape (n, 6), at times on the path, s, of a motion of the joints."""
        share = self.profile.share(np.clip(times - self.begin, 0.0, self.profile.duration))
        return np.asarray(self.start + share[:, None] * (self.end - self.start))


@dataclass(eq=False)
class Line:
    """A straight way of the tool; it turns about one axis, in step.

    Attributes:
        start: the tool in the robot's world, mm.
        end: likewise.
        to_flange: from the tool to the flange.
        posture: the configuration, which stays.
    """

    start: Array
    end: Array
    to_flange: Array
    posture: Branch

    def __post_init__(self) -> None:
        self.axis, self.angle = axis_and_angle(self.start[:3, :3].T @ self.end[:3, :3])

    @property
    def length(self) -> float:
        """Return its length, mm."""
        return float(np.linalg.norm(self.end[:3, 3] - self.start[:3, 3]))

    def tools(self, share: Array) -> Array:
        """Return the tool at shares of the way, shape (n, 4, 4)."""
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = (share * self.angle)[:, None, None]
        turned = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)
        tools = np.tile(np.eye(4), (len(share), 1, 1))
        tools[:, :3, :3] = self.start[:3, :3] @ turned
        tools[:, :3, 3] = self.start[:3, 3] + share[:, None] * (self.end[:3, 3] - self.start[:3, 3])
        return tools


def check_line(arm: ProgrammedArm, motion: Motion) -> None:
    """Check a line before it runs, with longer ramps where joints could not accelerate as it asks.

    Its end becomes the joint angles that the line leads to.

    Raises:
        VplusError: where the arm cannot reach, a joint leaves its range, or would be faster than it can be.
    """
    assert motion.line is not None
    line = motion.line
    profile = motion.profile
    if profile.duration == 0.0:
        return
    count = int(np.clip(profile.duration / _GRID, 16, _MOST_PLACES)) + 1
    times = np.linspace(0.0, profile.duration, count)
    share = profile.share(times)
    flanges = line.tools(share) @ line.to_flange
    angles = arm.solve(flanges, line.posture, motion.start)
    for place, row in zip(share, angles, strict=True):
        if np.isnan(row).any():
            raise VplusError("Location out of range", f"after {place * 100.0:.0f} % of the line")
        arm.check_range(row)
    speed = np.diff(angles, axis=0, prepend=motion.start[None]) / times[1]
    excess = np.abs(speed) / arm.max_speed
    if excess.max() > 1.0:
        place, joint = np.unravel_index(int(np.argmax(excess)), excess.shape)
        asked = f"joint {joint + 1} would turn at {np.degrees(abs(speed[place, joint])):.0f} deg/s"
        limit = f"accepted: up to {np.degrees(arm.max_speed[joint]):.0f}"
        raise VplusError(
            f"Soft envelope error* Mtr {joint + 1}", f"{asked} after {share[place] * 100.0:.0f} % of the line; {limit}"
        )
    acceleration = np.diff(speed[1:], axis=0) / times[1]
    needed = float((np.abs(acceleration) / arm.max_acceleration).max(initial=0.0))
    motion.profile = profile.gentler(needed) if needed > 1.0 else profile
    motion.end = angles[-1]


class MotionQueue:
    """One motion that runs, at most one that waits for it, and the knots of the set-points.

    Attributes:
        arm: what moves.
        destination: joint angles at the end of the newest motion, rad, shape (6,).
        position: the set-points now, rad, shape (6,).
        monitor: the monitor speed, percent.
        done: the motions that have begun, in their order.
    """

    def __init__(self, arm: ProgrammedArm, q: Array) -> None:
        self.arm = arm
        self.destination = q
        self.monitor = 100.0
        self.done: list[Motion] = []
        self.waiting: Motion | None = None
        self._running: list[Motion] = []
        self._path_time = 0.0
        self._rate = 1.0
        self.position = q
        self._stopping = False

    @property
    def at_end(self) -> bool:
        """Return whether no motion runs or waits."""
        return not self._running and self.waiting is None

    def give(self, motion: Motion) -> None:
        """Take a motion; it begins at once if none runs."""
        self.destination = motion.end
        self.waiting = motion
        before = self._running[-1] if self._running else None
        if before is not None and before.continuous and before.kind != "DELAY" != motion.kind:
            overlap = min(before.profile.ramp_down, motion.profile.ramp_up)
            motion.begin = max(before.over - overlap, self._path_time)

    def begin_waiting(self, settled: bool, time: float) -> None:
        """Begin the motion that waits, if the one before it is over, and settled where it must be."""
        if self.waiting is None or self._running:
            return
        if self.done and self.done[-1].nulls and not settled:
            return
        self.waiting.begin = self._path_time
        self._begin(time)

    def _begin(self, time: float) -> None:
        motion = self.waiting
        assert motion is not None
        motion.began = time
        for action in motion.at_start:
            action()
        self._running.append(motion)
        self.done.append(motion)
        self.waiting = None

    def stop(self) -> None:
        """End the motion at once: slow down on the path, and drop the rest of it."""
        self.waiting = None
        self._stopping = not self.at_end

    def drop(self) -> None:
        """Forget all motions: the power is off."""
        self.waiting = None
        self._running = []

    def advance(self, period: float, time: float) -> tuple[Array, Array]:
        """Go on by a period, s, that begins at a simulated time, s; return position and velocity at its end.

        Returns:
            Joint angles, rad, and their speeds, rad/s, shape (6,).
        """
        wanted = 0.0 if self._stopping else self.monitor / 100.0
        most = period / _RATE_TIME
        if self._running:
            rate = self._rate + float(np.clip(wanted - self._rate, -most, most))
        else:
            rate = wanted  # the arm rests
            self._rate = wanted
        self._path_time += period * (self._rate + rate) / 2.0
        self._rate = rate
        if self.waiting is not None and self.waiting.begin < self._path_time:
            self._begin(time)
        rows = self._angles(np.array([-_STEP, 0.0, _STEP]) + self._path_time)
        self.position = rows[1]
        velocity = (rows[2] - rows[0]) / (2.0 * _STEP) * rate
        self._end(time + period)
        if not self._running:
            velocity = np.zeros(6)
        return self.position, velocity

    def _end(self, time: float) -> None:
        """Let go of motions that are over, or of all when the arm was to stop and stands."""
        stopped = self._stopping and self._rate == 0.0
        for motion in [*self._running]:
            if motion.over <= self._path_time or stopped:
                motion.ended = time
                self._running.remove(motion)
                if not stopped and not self._running:
                    self.position = motion.end
        if stopped:
            self._stopping = False
            self.destination = self.position

    def _angles(self, times: Array) -> Array:
        """Return joint angles, rad, shape (n, 6), at times on the path, s."""
        if not self._running:
            return np.tile(self.position, (len(times), 1))
        first = self._running[0]
        last = self._running[-1]
        if first is last:
            return self._along_line(first, times) if first.line is not None else first.angles(times)
        if first.line is not None and last.line is not None:
            found = self._round_corner(first, last, times)
            if not np.isnan(found).any():
                return found
        parts = [
            self._along_line(part, times) if part.line is not None else part.angles(times) for part in (first, last)
        ]
        return np.asarray(parts[0] + parts[1] - first.end)

    def _along_line(self, motion: Motion, times: Array) -> Array:
        assert motion.line is not None
        share = motion.profile.share(np.clip(times - motion.begin, 0.0, motion.profile.duration))
        return self._solved(motion.line, motion.line.tools(share))

    def _round_corner(self, first: Motion, last: Motion, times: Array) -> Array:
        """Return joint angles where two lines add up."""
        assert first.line is not None
        assert last.line is not None
        ending = first.line.tools(first.profile.share(np.clip(times - first.begin, 0.0, first.profile.duration)))
        beginning = last.line.tools(last.profile.share(np.clip(times - last.begin, 0.0, last.profile.duration)))
        corner = last.line.start
        tools = beginning.copy()
        tools[:, :3, 3] += ending[:, :3, 3] - corner[:3, 3]
        tools[:, :3, :3] = ending[:, :3, :3] @ (corner[:3, :3].T @ beginning[:, :3, :3])
        return self._solved(last.line, tools)

    def _solved(self, line: Line, tools: Array) -> Array:
        return self.arm.solve(tools @ line.to_flange, line.posture, self.position)


def straight(arm: ProgrammedArm, start: Array, end: Array, tool: Array) -> Line:
    """Return the straight way of a tool from joint angles, rad, shape (6,), to a place in the robot's world, mm."""
    return Line(arm.flange(start) @ tool, end, inverse(tool), arm.posture(start))
