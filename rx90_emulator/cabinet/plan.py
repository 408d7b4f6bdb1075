"""Motions, planned: each goes its way in a share from 0 to 1 with a ramp up, an even speed and a ramp down."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from pinocchio import SE3, AngleAxis

from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import Pose
from rx90_common.description.rotations import axis_rotation
from rx90_emulator.cabinet.arm import ProgrammedArm, words
from rx90_emulator.cabinet.errors import VplusError

_GRID = 8e-3  # s, between places on a line that are checked beforehand
_MOST_PLACES = 4000
_OVERSHOOT = 1.5  # of the peak acceleration of a ramp without jumps
_SHORTEST_WAY = 1e-9  # mm, deg
STRAIGHT = ("MOVES", "MOVEST", "APPROS", "DEPARTS", "ALIGN")
"""Words of motions along a line."""


@dataclass(frozen=True)
class Profile:
    """The share of a way over time.

    Attributes:
        duration: s; 0 for no way.
        ramp_up: s.
        ramp_down: s.
        smooth: whether the acceleration has no jumps.
    """

    duration: float = 0.0
    ramp_up: float = 0.0
    ramp_down: float = 0.0
    smooth: bool = False

    @classmethod
    def fastest(
        cls, speed: float, up: float, down: float, smooth: bool, least: float = 0.0
    ) -> Profile:
        """Return the fastest profile with a speed, 1/s, and ramps, 1/s^2, that takes at least some time, s."""
        steeper = _OVERSHOOT if smooth else 1.0
        peak = min(speed, math.sqrt(2.0 / (steeper / up + steeper / down)))
        ramp_up = steeper * peak / up
        ramp_down = steeper * peak / down
        duration = 1.0 / peak + (ramp_up + ramp_down) / 2.0
        slower = max(least / duration, 1.0)
        return cls(slower * duration, slower * ramp_up, slower * ramp_down, smooth)

    def gentler(self, factor: float) -> Profile:
        """Return the profile with accelerations that are so many times smaller, at the same speed if the way allows."""
        rate = (_OVERSHOOT if self.smooth else 1.0) * self.peak / factor
        return Profile.fastest(self.peak, rate / self.ramp_up, rate / self.ramp_down, self.smooth)

    @property
    def peak(self) -> float:
        """Return the even speed, 1/s."""
        return 1.0 / (self.duration - (self.ramp_up + self.ramp_down) / 2.0)

    def share(self, times: Array) -> Array:
        """Return the share that is done at times from the start, s, shape (n,)."""
        if self.duration == 0.0:
            return np.ones(len(times))
        ramped_down = self._ramped(times - self.duration + self.ramp_down, self.ramp_down)
        return self.peak * (self._ramped(times, self.ramp_up) - ramped_down)

    def _ramped(self, times: Array, ramp: float) -> Array:
        """Return the way, s, of a rate that goes from 0 to 1 in a ramp, s, and stays there."""
        u = np.clip(times / ramp, 0.0, 1.0)
        way = u**3 - u**4 / 2.0 if self.smooth else u * u / 2.0
        return ramp * way + np.maximum(times - ramp, 0.0)


class Line:
    """A straight way of the tool in the robot's world, mm; it turns about one axis, in step.

    Args:
        arm: what moves.
        motion: its ends and tool.

    Attributes:
        configuration: it stays.
        start: the tool in the beginning.
        way: from there to the end, shape (3,).
        angle: by which it turns, rad.

    Raises:
        VplusError: for ends in different configurations.
    """

    def __init__(self, arm: ProgrammedArm, motion: Motion) -> None:
        self.configuration = arm.configuration(motion.start)
        last = arm.configuration(motion.end)
        if last != self.configuration:
            detail = f"{words(self.configuration)} to {words(last)}"
            raise VplusError("Straight-line motion can't alter configuration", detail)
        self.start = arm.flange(motion.start) * motion.tool
        end = arm.flange(motion.end) * motion.tool
        self.way = end.translation - self.start.translation
        turn = AngleAxis(self.start.rotation.T @ end.rotation)
        self.angle = float(turn.angle)
        self._axis = np.array(turn.axis)
        self._flange = motion.tool.inverse()

    def tools(self, share: Array) -> Pose:
        """Return n tools at shares of the way, shape (n,)."""
        turns = axis_rotation(self._axis, share * self.angle)
        return Pose(self.start.translation + share[:, None] * self.way, self.start.rotation @ turns)

    def flanges(self, tools: Pose) -> Pose:
        """Return the flanges of tools."""
        return Pose(
            tools.position + tools.rotation @ self._flange.translation,
            tools.rotation @ self._flange.rotation,
        )


@dataclass(eq=False)
class Motion:
    """A motion, from its plan to its end.

    Attributes:
        kind: the instruction's word.
        where: program and line.
        start: joint angles, rad, shape (6,).
        end: likewise.
        tool: the tool in use, mm.
        profile: the share of the way over time.
        line: the straight line of the tool; None for a motion of the joints.
        continuous: whether the next motion may begin before the end of this one.
        nulls: whether it is over only when the position errors are small.
        at_start: what happens when it begins.
        begin: time on the path, s; infinite until it is known.
        began: simulated time, s.
        ended: simulated time, s.
        settled: simulated time at which the arm stood where it should, s; NaN where it went on, or all ended, before.
        error: largest distance of the tool from the path of its set-points, mm; NaN where it is not known.
        nulled: distance of the tool from its end when the set-points were there, mm; likewise.
    """

    kind: str
    where: str
    start: Array
    end: Array
    tool: SE3
    profile: Profile = Profile()
    line: Line | None = None
    continuous: bool = True
    nulls: bool = True
    at_start: list[Callable[[], None]] = field(default_factory=list)
    begin: float = math.inf
    began: float = math.nan
    ended: float = math.nan
    settled: float = math.nan
    error: float = math.nan
    nulled: float = math.nan

    @property
    def has_begun(self) -> bool:
        """Return whether it has begun."""
        return not math.isnan(self.began)

    @property
    def over(self) -> float:
        """Return the time on the path at which it ends, s."""
        return self.begin + self.profile.duration


def plan(arm: ProgrammedArm, motion: Motion, chosen: Mapping[str, float], scaled: bool) -> None:
    """Give a motion the fastest profile within the full speeds, and check its way.

    Args:
        arm: what moves.
        motion: its kind, ends and tool are known.
        chosen: speeds and accelerations, percent, and DURATION, s.
        scaled: whether the program speed scales accelerations, too.

    Raises:
        VplusError: where the arm cannot go.
    """
    full = arm.full
    percents = [chosen["SPEED"]]
    if motion.kind not in STRAIGHT:
        arm.check_range(motion.end)
        ways = np.degrees(np.abs(motion.end - motion.start))
        speeds = full.joint_speed
        rates = full.joint_acceleration
    else:
        line = motion.line = Line(arm, motion)
        ways = np.array([np.linalg.norm(line.way), math.degrees(line.angle)])
        speeds = full.linear_speed, full.rotary_speed
        rates = full.linear_acceleration, full.rotary_acceleration
        percents.append(chosen["ROTARY"])
    if ways.max() <= _SHORTEST_WAY:
        return
    ways = np.maximum(ways, _SHORTEST_WAY) * 100.0
    fastest = float((np.multiply(speeds, percents) / ways).min())
    steepest = (np.multiply(rates, percents if scaled else 100.0) / ways).min() / 100.0
    up = steepest * chosen["UP"]
    down = steepest * chosen["DOWN"]
    motion.profile = Profile.fastest(fastest, up, down, chosen["SMOOTH"] != 0.0, chosen["DURATION"])
    if motion.line is not None:
        _check_line(arm, motion, motion.line)


def _check_line(arm: ProgrammedArm, motion: Motion, line: Line) -> None:
    """Check a line before it runs, with longer ramps where joints could not accelerate as it asks."""
    count = int(np.clip(motion.profile.duration / _GRID, 16, _MOST_PLACES)) + 1
    times = np.linspace(0.0, motion.profile.duration, count)
    tools = line.tools(motion.profile.share(times))
    angles = arm.solve(line.flanges(tools), line.configuration, motion.start)
    for row in angles:
        arm.check_range(row)
    speed = np.diff(angles, axis=0, prepend=motion.start[None]) / times[1]
    fastest = np.abs(speed).max(axis=0)
    limits = arm.robot.max_velocity
    joint = int(np.argmax(fastest / limits))
    if fastest[joint] > limits[joint]:
        asked, accepted = np.degrees([fastest[joint], limits[joint]])
        detail = f"the line asks for {asked:.0f} deg/s; accepted: up to {accepted:.0f}"
        raise VplusError(f"Soft envelope error* Mtr {joint + 1}", detail)
    acceleration = np.diff(speed[1:], axis=0) / times[1]
    needed = float((np.abs(acceleration) / arm.max_acceleration).max())
    if needed > 1.0:
        motion.profile = motion.profile.gentler(needed)
    motion.end = angles[-1]
