"""The arm as V+ sees it, and its motions: joint-interpolated and straight ones, and how they follow on each other.

Joint values are in degrees from V+'s own zero, the world is where axes 1 and 2 meet. A motion goes its way in a share
from 0 to 1 with a ramp up, an even speed and a ramp down. On a continuous path the next one begins before the end of
the one before, so that the shorter of the two ramps that meet lies within the other: their velocities add up, and the
corner becomes a parabola.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from pinocchio import SE3, AngleAxis

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.branch import Branch
from rx90_common.description.inverse import SphericalWristArm, nearest_turn
from rx90_common.description.kinematics import Pose, forward
from rx90_common.description.robot import RobotModel, load_robot
from rx90_common.description.rotations import axis_rotation
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.values import Joints, VplusError

_MM = 1e3
_SINGULAR = 1e-7
"""Sine of joint 5 below which joints 4 and 6 turn about one axis: joint 4 stays then."""
_SLACK = 1e-6  # rad, at the limits
_TURN = 2.0 * math.pi
_STEP = 1e-4  # s, of differences
_GRID = 8e-3  # s, between places on a line that are checked beforehand
_MOST_PLACES = 4000
_RATE_TIME = 0.3  # s in which the monitor speed goes from 0 to 100 %
_OVERSHOOT = 1.5  # of the peak acceleration of a ramp without jumps
_SHORTEST_WAY = 1e-9  # mm, deg
STRAIGHT = ("MOVES", "MOVEST", "APPROS", "DEPARTS", "ALIGN")
"""Words of motions along a line."""


Configuration: TypeAlias = list[bool]
"""Whether LEFTY, BELOW and FLIP."""
CONFIGURATIONS = ("RIGHTY", "ABOVE", "NOFLIP", "LEFTY", "BELOW", "FLIP")


def _words(configuration: Configuration) -> str:
    return " ".join(CONFIGURATIONS[part + 3 * asked] for part, asked in enumerate(configuration))


class ProgrammedArm:
    """Kinematics and limits of an arm that V+ programs move.

    Attributes:
        full: what 100 % of speeds and accelerations is.
        robot: the arm without the tool of its setup.
        max_acceleration: that set-points may ask of it, rad/s^2, shape (6,).
        ready: joint angles of READY, rad, shape (6,).
    """

    def __init__(self, setup: Setup) -> None:
        solver = SphericalWristArm.from_chain(setup.robot.chain)
        full = setup.controller.vplus
        if solver is None or full is None:
            raise ConfigError(
                "no V+ on this arm; accepted: six joints with a spherical wrist, and a block vplus in controller.yaml"
            )
        self._solver = solver
        self.full = full
        self.robot = load_robot(setup.files.urdf)
        self._world = np.array([0.0, 0.0, self.robot.chain.origin[:2, 2].sum()])  # m, in the base
        self.max_acceleration = setup.controller.max_acceleration
        self.ready = self.angles(Joints(full.ready))

    def joints(self, q: Array) -> Joints:
        """Return joint values, degrees, of joint angles, rad, shape (6,)."""
        return Joints((np.degrees(q) + self.full.zero).tolist())

    def angles(self, joints: Joints) -> Array:
        """Return joint angles, rad, shape (6,), of joint values."""
        return np.radians(np.subtract(joints, self.full.zero))

    def flange(self, q: Array) -> SE3:
        """Return the transformation of the flange in the robot's own world."""
        pose = forward(self.robot.chain, q)
        return SE3(pose.rotation, _MM * (pose.position - self._world))

    def with_tool(self, tool: SE3) -> RobotModel:
        """Return the arm up to the tip of a tool, a transformation from the flange, mm."""
        chain = self.robot.chain
        tip = chain.tcp_position + chain.tcp_rotation @ tool.translation / _MM
        turned = np.ascontiguousarray(chain.tcp_rotation @ tool.rotation)
        return replace(self.robot, chain=chain._replace(tcp_position=tip, tcp_rotation=turned))

    def configuration(self, q: Array) -> Configuration:
        """Return the configuration of joint angles, at a border RIGHTY, ABOVE and NOFLIP."""
        reach = self._solver.forward_reach(self.robot.chain, q[None])[0]
        elbow = self._solver.elbow_angle(q[None])[0]
        lefty = bool(reach <= -_SLACK)
        return [lefty, bool(elbow > -_SLACK) == lefty, bool(q[4] <= -_SLACK)]

    def solve(self, flanges: Pose, configuration: Configuration, near: Array) -> Array:
        """Return joint angles, rad, shape (n, 6), of n flanges, mm.

        Joints turn on from `near`, shape (6,), and from one row to the next.

        Raises:
            VplusError: for a place that is out of reach.
        """
        pose = Pose(flanges.position / _MM + self._world, np.ascontiguousarray(flanges.rotation))
        lefty, below, flip = configuration
        branch = Branch(
            "back" if lefty else "front",
            "positive" if below == lefty else "negative",
            "negative" if flip else "positive",
        )
        rows = self._solver.solve(self.robot.chain, pose, branch)
        missed = np.flatnonzero(np.isnan(rows).any(axis=1))
        if len(missed):
            distance = np.linalg.norm(flanges.position[missed[0]]) / _MM
            is_close = distance < self._solver.reach / 2.0
            text = "Location too close" if is_close else "Location out of range"
            raise VplusError(text, f"{distance:.3f} m from the shoulder")
        for row in rows:
            if abs(np.sin(row[4])) < _SINGULAR and abs(row[4]) < 1.0:
                row[5] += row[3] - near[3]
                row[3] = near[3]
            row[:] = nearest_turn(row, near)
            near = row
        return rows

    def solve_target(self, flange: SE3, configuration: Configuration, near: Array) -> Array:
        """Return the joint angles, rad, shape (6,), of a flange, where possible within the joints' ranges."""
        pose = Pose(flange.translation[None], flange.rotation[None])
        q = self.solve(pose, configuration, near)[0]
        for joint in self.outside(q):
            for turn in (-_TURN, _TURN):
                if self.robot.lower[joint] <= q[joint] + turn <= self.robot.upper[joint]:
                    q[joint] += turn
        return np.asarray(q)

    def outside(self, q: Array) -> list[int]:
        """Return the joints that are outside of their ranges, counted from 0."""
        inside = (q >= self.robot.lower - _SLACK) & (q <= self.robot.upper + _SLACK)
        return [int(joint) for joint in np.flatnonzero(~inside)]

    def check_range(self, q: Array) -> None:
        """Check joint angles, rad, shape (6,).

        Raises:
            VplusError: naming the first joint outside of its range.
        """
        for joint in self.outside(q):
            low = self.joints(self.robot.lower)[joint]
            high = self.joints(self.robot.upper)[joint]
            detail = f"{self.joints(q)[joint]:.3f} deg; accepted: {low:.1f} to {high:.1f}"
            raise VplusError(f"Position out of range* Jt {joint + 1}", detail)


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
            detail = f"{_words(self.configuration)} to {_words(last)}"
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
