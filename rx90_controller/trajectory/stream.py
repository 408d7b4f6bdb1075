"""Streamed set-points: from positions or velocities, received one after another, to a motion within the limits.

Each set-point is due at a time. Between them the reference is a cubic through the positions, whose slopes are the
received velocities, or those of parabolas through neighbours (Bessel's interpolation: de Boor 2001, chapter IV);
velocities are joined by lines. The reference may exceed all limits: the motion follows it as fast as velocities and
accelerations allow, without overshoot where it rests (the discrete filter of Zanasi, Guarino Lo Bianco and Tonielli
2000, Automatica 36), and from every point of it the arm can brake before its position limits. Each set-point gives a
whole motion, which ends at rest: at the newest position, or, when velocities cease to come, after
`StreamOptions.timeout`. So the arm stops without any detection of the stream's end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.declared import option
from rx90_common.base.errors import ConfigError, TrajectoryError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.kernels.compiled import inlined, kernel
from rx90_controller.trajectory.paths import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints, check_joints, joint_table
from rx90_controller.trajectory.spline import Spline, resting

POSITION, VELOCITY = "position", "velocity"
INTERFACES: Final = (POSITION, VELOCITY)
"""What a stream may consist of."""
_OTHER_CLOCK = 1.0  # s: a stamp further from the controller's time than this comes from another clock
_MARGIN = 64  # ticks that a motion is expected to need at most beyond the bound from its limits
_AT_REST, _SLOW = 1e-9, 1e-6  # rad, rad/s: position and velocity that are rounded to rest at the end of a motion


@dataclass(frozen=True)
class StreamOptions:
    """How set-points become a stream; each a parameter of the node, `stream.` before its name.

    Raises:
        ConfigError: if `commands` is none of INTERFACES.
    """

    delay: float = option(
        0.03,
        "from the stamp of a streamed set-point, or its arrival where it has none, until it is due, s; two periods of "
        "the sender or more",
        1e-3,
        1.0,
    )
    timeout: float = option(
        0.1,
        "time without set-points after which a stream has ended, and velocities are no longer held, s",
        1e-3,
        60.0,
    )
    window: float = option(
        0.1,
        "trajectories on ~/joint_trajectory that end no further ahead are set-points of a stream, s; 0: none are",
        0.0,
        10.0,
    )
    commands: str = option(POSITION, f"what ~/commands are: {', '.join(INTERFACES)}")

    def __post_init__(self) -> None:
        if self.commands not in INTERFACES:
            raise ConfigError(
                f"parameter stream.commands is {quoted(self.commands)}; accepted: {', '.join(INTERFACES)}"
            )


class SetPoints(NamedTuple):
    """One or more set-points of a stream, in the robot's joint order.

    Attributes:
        interface: one of INTERFACES.
        stamp_ns: origin of `times`, ns; None for the time of arrival.
        times: due times, s from there, shape (n,), increasing.
        values: rad or rad/s, shape (n, j).
        slopes: their derivatives by time, NaN where none are given, shape (n, j).
        named: the joints that they are for, shape (j,); the others brake and hold.
    """

    interface: str
    stamp_ns: int | None
    times: Array
    values: Array
    slopes: Array
    named: Mask


def from_joint_state(names: Sequence[str], message: Any, options: StreamOptions, *, partial: bool) -> SetPoints:
    """Return the set-point in a sensor_msgs/JointState: positions, with velocities or without, or velocities alone.

    Args:
        names: of the robot's joints.
        message: with these names in any order.
        options: of the stream.
        partial: whether some joints may be missing.

    Raises:
        TrajectoryError: naming joint, field and what is accepted.
    """
    given = list(message.name)
    check_joints(names, given, partial=partial)
    columns = [list(names).index(name) for name in given]
    fields = (("positions", message.position), ("velocities", message.velocity), ("efforts", message.effort))
    position, velocity, effort = (joint_table(what, [row], columns, names, "") for what, row in fields)
    if effort is not None:
        raise TrajectoryError("carries effort; accepted: position, with velocity or without, or velocity alone")
    named = np.isin(np.arange(len(names)), columns)
    return _one(position, velocity, message_time_ns(message.header.stamp), options, named)


def from_array(names: Sequence[str], message: Any, options: StreamOptions) -> SetPoints:
    """Return the set-point in a std_msgs/Float64MultiArray: a number for each joint, as `options.commands` says.

    Raises:
        TrajectoryError: for another count, or a number that is not finite.
    """
    if len(message.data) != len(names):
        raise TrajectoryError(f"{len(message.data)} numbers; accepted: {len(names)}, of {', '.join(names)}")
    what = "positions" if options.commands == POSITION else "velocities"
    values = joint_table(what, [message.data], range(len(names)), names, "")
    position, velocity = (values, None) if options.commands == POSITION else (None, values)
    return _one(position, velocity, 0, options, np.ones(len(names), dtype=np.bool_))


def _one(
    position: Array | None, velocity: Array | None, stamp_ns: int, options: StreamOptions, named: Mask
) -> SetPoints:
    if position is None and velocity is None:
        raise TrajectoryError("neither position nor velocity; accepted: one of them, or both")
    interface, values = (POSITION, position) if velocity is None or position is not None else (VELOCITY, velocity)
    assert values is not None
    slopes = np.full((1, len(named)), np.nan) if position is None or velocity is None else velocity
    return SetPoints(interface, stamp_ns or None, np.array([options.delay]), values, slopes, named)


def from_trajectory(points: TrajectoryPoints, stamp_ns: int | None) -> SetPoints:
    """Return the points of a trajectory: due at their own times, without a delay."""
    slopes = np.full_like(points.position, np.nan) if points.velocity is None else points.velocity.copy()
    return SetPoints(POSITION, stamp_ns, points.times, points.position, slopes, points.named)


class Stream:
    """The received set-points of a stream, and the resulting motion. Times are counted in position ticks.

    Args:
        interface: one of INTERFACES.
        named: its joints, shape (j,).
        limits: that the motion respects.
        period: of the position loop, s.
        timeout: `StreamOptions.timeout`, s.

    Attributes:
        interface, named: see above.
        count: number of received set-points.
        late: how many of them were due already.
        latest: the largest delay, s.
        own_clock: whether it is stamped by another clock than the controller's time.
        beyond: the first violation of a limit, in words; empty for none.
        reported: the kinds of `notes` that have been reported.
        expires: last tick of the stream, unless there are more set-points.
    """

    def __init__(self, interface: str, named: Mask, limits: JointLimits, period: float, timeout: float) -> None:
        self.interface, self.named = interface, named
        self._limits, self._period, self._timeout = limits, period, timeout / period
        self.count = self.late = self.expires = 0
        self.latest = 0.0
        self.own_clock, self._offset = False, 0  # ns, from the stamps of another clock to the controller's time
        self.beyond = ""
        self.reported: set[str] = set()
        self._times = np.zeros(0)
        self._values = self._slopes = np.zeros((0, len(named)))

    def take(self, points: SetPoints, now: int, held: Array) -> bool:
        """Take set-points; return whether they change the motion.

        A set-point takes the place of those that were due later. One that is due already is followed at once, unless a
        later one has been due as well. Until the next one is there the reference rests at the last position.

        Args:
            points: of the same interface and joints.
            now: the first tick that may still be changed.
            held: the set-point at that tick, shape (3, j).
        """
        times, values, slopes = self._due(points, now), points.values, points.slopes.copy()
        self.count += len(times)
        self.expires = math.ceil(max(float(now), times[-1]) + self._timeout - 1e-6)
        if self.interface == POSITION:
            values = np.clip(values, self._limits.lower, self._limits.upper)
            self._note_beyond(points.values - values, points.values, "position", "rad")
            slopes[values != points.values] = 0.0
            if not slopes[-1].any():
                slopes[-1] = np.nan  # senders usually let a single point rest; the next one is still to come
        if not len(self._times):
            self._times, self._values = np.array([float(now)]), held[None, 0 if self.interface == POSITION else 1]
            self._slopes = held[None, 1] if self.interface == POSITION else np.zeros((1, len(self.named)))
        elif self._times[-1] >= now:
            # The slope that the motion already uses stays: a change on the way there would be a jump.
            used = int(np.searchsorted(self._times, now)) + 1
            self._slopes[:used] = self._bessel()[:used]
        else:  # the reference has been held since
            if self.interface == POSITION and (values[-1] == held[0]).all() and not held[1].any():
                return False  # there already, as a sender that repeats itself wants it
            self._times = np.array([float(now)])
            self._values = self._values[-1:] if self.interface == POSITION else held[None, 1]
            self._slopes = np.zeros((1, len(self.named)))
        if times[-1] <= now:
            self.late += 1
            self.latest = max(self.latest, (now - times[-1]) * self._period)
            if times[-1] < self._times[-1] and self._times[-1] > now:
                return False
            # The reference so far, and from the next tick on this one.
            times, values, slopes = np.array([now + 1.0]), values[-1:], slopes[-1:]
        before = self._times < times[0]
        times = np.concatenate([self._times[before], times])
        values, slopes = np.vstack([self._values[before], values]), np.vstack([self._slopes[before], slopes])
        first = max(int(np.searchsorted(times, now, side="right")) - 2, 0)
        self._times, self._values, self._slopes = times[first:], values[first:], slopes[first:]
        return True

    def _due(self, points: SetPoints, now: int) -> Array:
        """Return when set-points are due, in ticks."""
        times = points.times / self._period
        if points.stamp_ns is None:
            return np.asarray(now + times)
        tick_ns = round(self._period * NANOSECONDS)
        ahead = points.stamp_ns - now * tick_ns  # whole ns: a stamp of today would lose some as a number of seconds
        if not self.count:
            self.own_clock = abs(ahead) > _OTHER_CLOCK * NANOSECONDS
            self._offset = -ahead if self.own_clock else 0
        elif self.own_clock and not 0.0 <= (ahead + self._offset) / tick_ns + times[-1] <= 2.0 * times[-1]:
            self._offset = -ahead  # the clocks have drifted, or the stream has paused
        return np.asarray(now + (ahead + self._offset) / tick_ns + times)

    def notes(self, delay: float) -> list[str]:
        """Return the problems of the stream that have not been reported yet, a line for each kind; `delay` is in s."""
        notes = {
            "late": f"a set-point came {self.latest:.3g} s after it was due: the last one was held; accepted: within "
            f"stream.delay, {delay:g} s, of its stamp, or time_from_start ahead" if self.late else "",
            "clock": "stamps are of another clock than the controller's time: set-points count from when they come; "
            "accepted: simulated time (use_sim_time), or no stamps" if self.own_clock else "",
            "beyond": f"{self.beyond}; followed within the limits" if self.beyond else "",
        }  # fmt: skip
        fresh = {kind: line for kind, line in notes.items() if line and kind not in self.reported}
        self.reported |= fresh.keys()
        return list(fresh.values())

    @property
    def ending(self) -> str:
        """Return how it ends by itself, in words."""
        if self.interface == VELOCITY and self._values[-1].any():
            return f"braked, because no velocity came for stream.timeout, {self._timeout * self._period:g} s; holding"
        return "holding"

    def motion(self, now: int, held: Array) -> Spline:
        """Return the motion from tick `now` on, at the set-point `held`, shape (3, j), to rest; times in s from there.

        Where the reference exceeds the limits, it is followed within them, and `beyond` says so.
        """
        free = ~self.named if self.interface == POSITION else np.ones_like(self.named)
        times, values = self._times, self._values
        slopes = self._bessel() if self.interface == POSITION else np.zeros_like(values)
        if self.interface == VELOCITY:
            values = np.where(self.named, values, 0.0)
            last = max(float(now), times[-1]) + self._timeout
            times, values = (
                np.append(times, [last, last + 1.0]),
                np.vstack([values, values[-1:], np.zeros((1, len(self.named)))]),
            )
        count = self._expected(now, times[-1], values[-1], held)
        while True:
            states, behind = np.empty((count + 1, 2, len(self.named))), np.zeros(len(self.named))
            states[0] = held[:2]
            limits = self._limits
            ticks = _follow(
                times - now, values, slopes * self._period, free, limits.velocity, limits.acceleration,
                limits.lower, limits.upper, self._period, states, behind,
            )  # fmt: skip
            if ticks <= count:
                break
            count *= 2
        what, unit = ("position", "rad") if self.interface == POSITION else ("velocity", "rad/s")
        if not self.beyond:
            joint = int(np.argmax(behind))
            if behind[joint] > self._limits.start_tolerance:
                self.beyond = f"{limits.names[joint]} is up to {behind[joint]:.3g} {unit} behind the {what} asked for"
        if ticks == 0:
            return resting(held[0].copy())
        states = states[: ticks + 1]
        coefficients = np.zeros((ticks, 6, len(self.named)))
        coefficients[:, :2] = states[:-1]
        coefficients[:, 2] = np.diff(states[:, 1], axis=0) / (2.0 * self._period)
        return Spline(
            np.asarray(np.arange(ticks + 1) * self._period, dtype=np.float64), coefficients, states[-1, 0].copy()
        )

    def _note_beyond(self, excess: Array, asked: Array, what: str, unit: str) -> None:
        if excess.any() and not self.beyond:
            row, joint = np.argwhere(excess)[0].tolist()
            low, high = self._limits.lower[joint], self._limits.upper[joint]
            self.beyond = (
                f"{self._limits.names[joint]} is asked for the {what} {asked[row, joint]:.6g} {unit}; accepted: "
                f"[{low:.6g}, {high:.6g}]"
            )

    def _bessel(self) -> Array:
        """Return the slopes at the set-points, 1/s, those that are not given from parabolas; shape (n, j)."""
        if len(self._times) == 1:
            return np.nan_to_num(self._slopes)
        span = np.diff(self._times)[:, None] * self._period
        rise = np.diff(self._values, axis=0) / span
        slopes = np.vstack(
            [rise[:1], (span[1:] * rise[:-1] + span[:-1] * rise[1:]) / (span[1:] + span[:-1]), rise[-1:]]
        )
        return np.where(np.isnan(self._slopes), slopes, self._slopes)

    def _expected(self, now: int, last: float, target: Array, held: Array) -> int:
        """Return in how many ticks the motion should have come to rest."""
        v, a = self._limits.velocity, self._limits.acceleration
        way = np.abs(target - held[0]) if self.interface == POSITION else np.zeros(len(held[0]))
        rest = float(((way / v) + 2.0 * v / a).max()) / self._period
        return math.ceil(max(last - now, 0.0) + rest) + _MARGIN


@kernel
def _follow(
    times: Array,
    values: Array,
    slopes: Array,
    free: Mask,
    velocity: Array,
    acceleration: Array,
    lower: Array,
    upper: Array,
    period: float,
    states: Array,
    behind: Array,
) -> int:
    """Follow a reference; return the ticks until all joints rest, or more than there is room for.

    Args:
        times: of the knots in ticks from now, shape (n,).
        values: at the knots: positions, of free joints velocities, shape (n, j).
        slopes: at the knots, rad for each tick, shape (n, j).
        free: which joints follow velocities, shape (j,).
        velocity: limits, rad/s, shape (j,).
        acceleration: limits, rad/s^2, shape (j,).
        lower: limits of positions, rad, shape (j,).
        upper: likewise.
        period: of a tick, s.
        states: positions and velocities, shape (m + 1, 2, j), of which the first is given; the others are filled in.
        behind: set to the largest distance from the reference up to the last knot, shape (j,).
    """
    room: int = states.shape[0] - 1
    last, ticks = times.size - 1, 0
    for j in range(velocity.size):
        most, top = acceleration[j], velocity[j]
        done, k = False, 0
        for i in range(room):
            q, v = states[i, 0, j], states[i, 1, j]
            if done:
                states[i + 1, 0, j], states[i + 1, 1, j] = q, v
                continue
            while k < last and times[k + 1] <= i:
                k += 1
            after = i >= times[last]
            if free[j]:
                desired = _line(times, values, j, i + 1.0)
                if i < times[last] - 1.0:
                    behind[j] = max(behind[j], abs(v - _line(times, values, j, float(i))))
                change = desired - v
                done = after and v == 0.0
            else:
                r, w = _cubic(times, values, slopes, j, k, float(i))
                w /= period
                _, then = _cubic(times, values, slopes, j, k, i + 1.0)
                if not after:
                    behind[j] = max(behind[j], abs(q - r))
                feed = min(max(then / period - w, -0.5 * most * period), 0.5 * most * period) if not after else 0.0
                done = after and abs(q - r) <= _AT_REST and abs(v) <= _SLOW
                if done:
                    states[i, 0, j], states[i, 1, j] = r, 0.0
                    states[i + 1, 0, j], states[i + 1, 1, j] = r, 0.0
                    ticks = max(ticks, i)
                    continue
                step = most * period
                change = feed + _filter(q - r, v - w, step - abs(feed), period)
            if done:
                states[i + 1, 0, j], states[i + 1, 1, j] = q, v
                ticks = max(ticks, i)
                continue
            v1 = v + change
            # From where it may go, it must be possible to brake before the limits.
            v1 = min(v1, _room(upper[j] - q - 0.5 * period * v, most, period))
            v1 = max(v1, -_room(q + 0.5 * period * v - lower[j], most, period))
            v1 = min(max(v1, -top), top)
            v1 = min(max(v1, v - most * period), v + most * period)
            states[i + 1, 0, j], states[i + 1, 1, j] = q + 0.5 * period * (v + v1), v1
        if not done:
            ticks = room + 1
    return ticks


@inlined
def _line(times: Array, values: Array, j: int, t: float) -> float:
    """Return the value at a time on the lines between the knots."""
    last: int = times.size - 1
    if t >= times[last]:
        return float(values[last, j])
    k: int = max(np.searchsorted(times, t, side="right") - 1, 0)  # type: ignore[assignment]
    share = max((t - times[k]) / (times[k + 1] - times[k]), 0.0)
    return float(values[k, j] + share * (values[k + 1, j] - values[k, j]))


@inlined
def _cubic(times: Array, values: Array, slopes: Array, j: int, k: int, t: float) -> tuple[float, float]:
    """Return value and derivative at a time on the cubic behind knot k; at rest behind the last one."""
    if t >= times[times.size - 1]:
        return values[times.size - 1, j], 0.0
    if t >= times[k + 1]:
        k += 1
    h = times[k + 1] - times[k]
    s = (t - times[k]) / h
    rise, a, b = values[k + 1, j] - values[k, j], slopes[k, j] * h, slopes[k + 1, j] * h
    c2, c3 = 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise
    return values[k, j] + s * (a + s * (c2 + s * c3)), (a + s * (2.0 * c2 + 3.0 * s * c3)) / h


@inlined
def _filter(error: float, rate: float, most: float, period: float) -> float:
    """Return the change of the velocity in a tick, up to `most`, that takes error and its rate to 0 without overshoot.

    In the least number of ticks, for accelerations that are constant in each (Zanasi et al. 2000, equations 8 to 12).
    """
    z1, z2 = (error / period + 0.5 * rate) / most, rate / most
    m = math.floor(0.5 * (1.0 + math.sqrt(1.0 + 8.0 * abs(z1))))
    sigma = z2 + z1 / m + 0.5 * (m - 1.0) * np.sign(z1)
    change: float = -most * min(max(sigma, -1.0), 1.0)
    return change


@inlined
def _room(distance: float, most: float, period: float) -> float:
    """Return the velocity at the next tick from which the arm still comes to rest within a distance, rad."""
    if distance <= 0.0:
        return 0.0
    return most * (math.sqrt(period * period + 2.0 * distance / most) - period)
