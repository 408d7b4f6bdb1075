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

POSITION = "position"
VELOCITY = "velocity"
INTERFACES: Final = (POSITION, VELOCITY)
"""What a stream may consist of."""
_OTHER_CLOCK = 1.0  # s: a stamp further from the controller's time than this comes from another clock
_MARGIN = 64  # ticks that a motion may take beyond its reference before it is computed anew with more room
# rad, rad/s: position and velocity that are rounded to rest at the end of a motion
_AT_REST = 1e-9
_SLOW = 1e-6


@dataclass(frozen=True)
class StreamOptions:
    """How set-points become a stream; each a parameter of the node, `stream.` before its name."""

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
    check_joints(names, list(message.name), partial=partial)
    if len(message.effort):
        raise TrajectoryError("carries effort; accepted: position, with velocity or without, or velocity alone")
    stamp_ns = message_time_ns(message.header.stamp) or None
    return _set_point(names, list(message.name), message.position, message.velocity, stamp_ns, options.delay)


def from_array(names: Sequence[str], message: Any, options: StreamOptions) -> SetPoints:
    """Return the set-point in a std_msgs/Float64MultiArray: a number for each joint, as `options.commands` says.

    Raises:
        TrajectoryError: for another count, or a number that is not finite.
    """
    position, velocity = (message.data, ()) if options.commands == POSITION else ((), message.data)
    return _set_point(names, names, position, velocity, None, options.delay)


def _set_point(
    names: Sequence[str], given: Sequence[str], position: Sequence[float], velocity: Sequence[float],
    stamp_ns: int | None, delay: float,
) -> SetPoints:  # fmt: skip
    columns = [list(names).index(name) for name in given]
    positions = joint_table("positions", [position], columns, names, "")
    velocities = joint_table("velocities", [velocity], columns, names, "")
    unknown = np.full((1, len(names)), np.nan)
    named = np.isin(np.arange(len(names)), columns)
    times = np.array([delay])
    if positions is not None:
        return SetPoints(POSITION, stamp_ns, times, positions, unknown if velocities is None else velocities, named)
    if velocities is None:
        raise TrajectoryError("neither position nor velocity; accepted: one of them, or both")
    return SetPoints(VELOCITY, stamp_ns, times, velocities, unknown, named)


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
        options: of the stream.

    Attributes:
        interface, named: see above.
        count: number of received set-points.
        late: how many of them were due already.
        expires: last tick of the stream, unless there are more set-points.
        notes: problems that have not been reported yet; each kind comes once.
    """

    def __init__(self, interface: str, named: Mask, limits: JointLimits, period: float, options: StreamOptions) -> None:
        self.interface = interface
        self.named = named
        self.notes = list[str]()
        self._limits = limits
        self._period = period
        self._options = options
        self.count = self.late = self.expires = 0
        self._noted: set[str] = set()
        self._times = np.zeros(0)
        self._values = self._slopes = np.zeros((0, len(named)))

    def take(self, points: SetPoints, now: int, held: Array) -> bool:
        """Take set-points; return whether they change the motion.

        A set-point takes the place of those that were due later. One that is due already is followed at once, unless a
        later one is still to come. Until the next one is there the reference rests at the last position.

        Args:
            points: of the same interface and joints.
            now: the first tick that may still be changed.
            held: the set-point at that tick, shape (3, j).
        """
        times = self._due(points, now)
        values = points.values
        slopes = points.slopes.copy()
        self.count += len(times)
        self.expires = math.ceil(max(float(now), times[-1]) + self._options.timeout / self._period - 1e-6)
        if self.interface == POSITION:
            values = np.clip(values, self._limits.lower, self._limits.upper)
            slopes[values != points.values] = 0.0
            self._note_beyond((values != points.values).any(axis=0))
            if not slopes[-1].any():
                slopes[-1] = np.nan  # senders usually let a single point rest; the next one is still to come
        if not len(self._times) or self._times[-1] < now:  # the reference begins where the arm is
            row = INTERFACES.index(self.interface)
            self._times = np.array([float(now)])
            self._values = held[[row]]
            self._slopes = held[[row + 1]]
        ahead = times > now
        if not ahead[-1]:
            self.late += 1
            late = (now - times[-1]) * self._period
            accepted = f"within stream.delay, {self._options.delay:g} s, of its stamp, or time_from_start ahead"
            self._note(
                "late", f"a set-point came {late:.3g} s after it was due: the last one was held; accepted: {accepted}"
            )
            if self._times[-1] > now:
                return False
            times[-1] = now + 1.0
            ahead[-1] = True
        times = times[ahead]
        kept = self._times < times[0]
        # Two before now are needed: for the slope at the later one.
        kept[: max(int(np.searchsorted(self._times, now)) - 2, 0)] = False
        self._times = np.concatenate([self._times[kept], times])
        self._values = np.vstack([self._values[kept], values[ahead]])
        self._slopes = np.vstack([self._slopes[kept], slopes[ahead]])
        return True

    def _due(self, points: SetPoints, now: int) -> Array:
        """Return when set-points are due, in ticks."""
        tick_ns = round(self._period * NANOSECONDS)
        # Whole ns: a stamp of today would lose some as a number of seconds.
        ahead = 0 if points.stamp_ns is None else points.stamp_ns - now * tick_ns
        if abs(ahead) > _OTHER_CLOCK * NANOSECONDS:
            self._note("clock", "stamps are of another clock than the controller's time: set-points count from their "
                       "arrival; accepted: simulated time (use_sim_time), or no stamps")  # fmt: skip
            ahead = 0
        return np.asarray(now + ahead / tick_ns + points.times / self._period)

    def _note(self, kind: str, text: str) -> None:
        if kind not in self._noted:
            self._noted.add(kind)
            self.notes.append(text)

    def _note_beyond(self, joints: Mask) -> None:
        """Note that some joints are asked for more than their limits, if any are."""
        if joints.any():
            names = ", ".join(np.array(self._limits.names)[joints])
            self._note("beyond", f"{names}: a {self.interface} beyond the limits; followed within them")

    def motion(self, now: int, held: Array) -> Spline:
        """Return the motion from tick `now` on, at the set-point `held`, shape (3, j), to rest; times in s from there.

        Where the reference exceeds the limits, it is followed within them, with a note.
        """
        free = ~self.named if self.interface == POSITION else np.ones_like(self.named)
        last = max(self._times[-1] - now, 0.0)
        if self.interface == VELOCITY:
            last += self._options.timeout / self._period
        count = math.ceil(last) + _MARGIN
        limits = np.stack([self._limits.velocity, self._limits.acceleration, self._limits.lower, self._limits.upper])
        while True:
            reference = self._reference(now, last, count)
            states = np.zeros_like(reference)
            states[0] = held[:2]
            ticks = _follow(reference, free, last, limits, self._period, states)
            if ticks <= count:
                break
            count *= 2
        behind = np.abs(states - reference)[: int(last), INTERFACES.index(self.interface)].max(axis=0, initial=0.0)
        self._note_beyond((behind > self._limits.start_tolerance) & self.named)
        if ticks == 0:
            return resting(held[0].copy())
        states = states[: ticks + 1]
        coefficients = np.zeros((ticks, 6, len(self.named)))
        coefficients[:, :2] = states[:-1]
        coefficients[:, 2] = np.diff(states[:, 1], axis=0) / (2.0 * self._period)
        times = np.arange(ticks + 1, dtype=np.float64) * self._period
        return Spline(times, coefficients, states[-1, 0].copy())

    def _reference(self, now: int, last: float, count: int) -> Array:
        """Return position and velocity asked for in each tick, shape (count + 1, 2, j); at rest from `last` on."""
        at = np.arange(count + 1.0)
        reference = np.zeros((count + 1, 2, len(self.named)))
        times = (self._times - now) * self._period
        if self.interface == POSITION:
            from scipy.interpolate import CubicHermiteSpline  # takes a while, which most runs do without

            cubic = CubicHermiteSpline(times, self._values, self._bessel())
            inside = np.minimum(at, last) * self._period
            reference[:, 0] = cubic(inside)
            reference[:, 1] = np.where((at < last)[:, None], cubic(inside, 1), 0.0)
        else:
            for j, velocity in enumerate(self._values.T):
                reference[:, 1, j] = np.where(at < last, np.interp(at * self._period, times, velocity), 0.0)
        reference[:, 1, ~self.named] = 0.0
        return reference

    def _bessel(self) -> Array:
        """Return the slopes at the set-points, 1/s, those that are not given from parabolas; shape (n, j)."""
        span = np.diff(self._times)[:, None] * self._period
        rise = np.diff(self._values, axis=0) / span
        inner = (span[1:] * rise[:-1] + span[:-1] * rise[1:]) / (span[1:] + span[:-1])
        return np.where(np.isnan(self._slopes), np.vstack([rise[:1], inner, rise[-1:]]), self._slopes)


@kernel
def _follow(reference: Array, free: Mask, last: float, limits: Array, period: float, states: Array) -> int:
    """Follow a reference; return the ticks until all joints rest, or more than there is room for.

    Args:
        reference: positions and velocities in each tick, shape (m + 1, 2, j).
        free: which joints follow velocities alone, shape (j,).
        last: tick from which on the reference rests, not necessarily a whole number.
        limits: of velocity, rad/s, and acceleration, rad/s^2, and lower and upper ones of position, rad, shape (4, j).
        period: of a tick, s.
        states: positions and velocities, shape (m + 1, 2, j), of which the first is given; the others are filled in.
    """
    room: int = states.shape[0] - 1
    ticks = 0
    for j in range(limits.shape[1]):
        top, acceleration, lower, upper = limits[:, j]
        step = acceleration * period
        done = False
        for i in range(room):
            q = states[i, 0, j]
            v = states[i, 1, j]
            r = reference[i, 0, j]
            w = reference[i, 1, j]
            then = reference[i + 1, 1, j]
            at_rest = v == 0.0 if free[j] else abs(q - r) <= _AT_REST and abs(v) <= _SLOW
            if i >= last and at_rest:
                done = True
                ticks = max(ticks, i)
                states[i:, 0, j] = q if free[j] else r
                states[i:, 1, j] = 0.0
                break
            if free[j]:
                change = then - v
            else:
                feed = min(max(then - w, -0.5 * step), 0.5 * step) if i < last else 0.0
                change = feed + _filter(q - r, v - w, step - abs(feed), period)
            v1 = v + change
            # From where it may go, it must be possible to brake before the limits.
            v1 = min(v1, _room(upper - q - 0.5 * period * v, acceleration, period))
            v1 = max(v1, -_room(q + 0.5 * period * v - lower, acceleration, period))
            v1 = min(max(v1, -top), top)
            v1 = min(max(v1, v - step), v + step)
            states[i + 1, 0, j] = q + 0.5 * period * (v + v1)
            states[i + 1, 1, j] = v1
        if not done:
            ticks = room + 1
    return ticks


@inlined
def _filter(error: float, rate: float, most: float, period: float) -> float:
    """Return the change of the velocity in a tick, up to `most`, that takes error and its rate to 0 without overshoot.

    In the least number of ticks, for accelerations that are constant in each (Zanasi et al. 2000, equations 8 to 12).
    """
    z1 = (error / period + 0.5 * rate) / most
    z2 = rate / most
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
