"""Streamed set-points: from positions or velocities, received one after another, to a motion within the limits.

Each set-point is due at a time. Between them the reference is a cubic through the positions, whose slopes are the
received velocities, or those of parabolas through neighbours (Bessel's interpolation: de Boor 2001, chapter IV), as
`np.gradient` has them; velocities are joined by lines. The reference may exceed all limits: the motion follows it as
fast as velocities and accelerations allow, without overshoot where it rests (the discrete filter of Zanasi, Guarino Lo
Bianco and Tonielli 2000, Automatica 36), and from every point of it the arm can brake before its position limits. Each
set-point gives a whole motion, which ends at rest: at the newest position, or, when velocities cease to come, after
`StreamOptions.timeout`. So the arm stops without any detection of the stream's end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import TrajectoryError
from rx90_common.base.models import Model, quantity
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.kernels.compiled import inlined, kernel
from rx90_controller.trajectory.paths import JointLimits
from rx90_controller.trajectory.points import TrajectoryPoints, check_joints, joint_table
from rx90_controller.trajectory.spline import Spline, interpolate

POSITION = "position"
VELOCITY = "velocity"
INTERFACES = (POSITION, VELOCITY)
"""What a stream may consist of."""
LONGEST_PAUSE = 1.0
"""Interruption of a stream, s, after which its sender goes on from where it is by then; a longer one ends it."""
# s: a stamp further from the controller's time than this comes from another clock
_OTHER_CLOCK = 1.0
_SLOW = 1e-7  # rad/s: velocity that is rounded to rest at the end of a motion
_FAR = 1e6  # rad, rad/s, rad/s^2: beyond all limits; larger numbers are taken for it, so that none overflows


class StreamOptions(Model):
    """How set-points become a stream; each a parameter of the node, `stream.` before its name."""

    delay: Annotated[
        float,
        quantity(
            "s",
            "From the stamp of a streamed set-point, or its arrival where it has none, until it is due; two periods of "
            "the sender or more.",
            ge=1e-3,
            le=1.0,
        ),
    ] = 0.03
    timeout: Annotated[
        float,
        quantity(
            "s",
            "Time without set-points after which a stream has ended, and velocities are no longer held.",
            ge=1e-3,
            le=60.0,
        ),
    ] = 0.1
    window: Annotated[
        float,
        quantity(
            "s",
            "Trajectories on ~/joint_trajectory that end no further ahead are set-points of a stream; 0: none are.",
            ge=0.0,
            le=10.0,
        ),
    ] = 0.1
    commands: Annotated[
        Literal["position", "velocity"],
        Field(description=f"What ~/commands are: {', '.join(INTERFACES)}."),
    ] = "position"


class SetPoints(NamedTuple):
    """One or more set-points of a stream, in the robot's joint order.

    Attributes:
        interface: one of INTERFACES.
        stamp_ns: origin of `times`, ns; 0 for the time of arrival.
        times: due times, s from there, shape (n,), increasing.
        values: rad or rad/s, and their derivatives by time, NaN where none are given, shape (n, 2, j).
        named: the joints that they are for, shape (j,); the others brake and hold.
    """

    interface: str
    stamp_ns: int
    times: Array
    values: Array
    named: Mask


def from_message(
    names: Sequence[str], message: Any, options: StreamOptions, *, partial: bool
) -> SetPoints:
    """Return the set-point in a message: positions, with velocities or without, or velocities alone.

    Args:
        names: of the robot's joints.
        message: sensor_msgs/JointState, with these names in any order, or std_msgs/Float64MultiArray, with a number for
            each joint, as `options.commands` says.
        options: of the stream.
        partial: whether some joints may be missing.

    Raises:
        TrajectoryError: naming joint, field and what is accepted.
    """
    if hasattr(message, "data"):
        given = names
        stamp_ns = 0
        rows = [message.data, []] if options.commands == POSITION else [[], message.data]
    else:
        given = message.name
        stamp_ns = message_time_ns(message.header.stamp)
        rows = [message.position, message.velocity]
        check_joints(names, given, partial=partial)
        if len(message.effort):
            raise TrajectoryError(
                "carries effort; accepted: position, with velocity or without, or velocity alone"
            )
    columns = [names.index(name) for name in given]
    positions = joint_table("positions", rows[:1], columns, names, "")
    velocities = joint_table("velocities", rows[1:], columns, names, "")
    tables = [table for table in (positions, velocities) if table is not None]
    if not tables:
        raise TrajectoryError("neither position nor velocity; accepted: one of them, or both")
    tables.append(np.nan * tables[0])
    interface = VELOCITY if positions is None else POSITION
    values = np.stack(tables[:2], axis=1)
    return SetPoints(interface, stamp_ns, np.array([options.delay]), values, np.isin(names, given))


def from_trajectory(points: TrajectoryPoints, stamp_ns: int) -> SetPoints:
    """Return the points of a trajectory: due at their own times, without a delay."""
    slopes = np.nan * points.position if points.velocity is None else points.velocity
    values = np.stack([points.position, slopes], axis=1)
    return SetPoints(POSITION, stamp_ns, points.times, values, points.named)


@dataclass
class Stream:
    """The received set-points of a stream, and the resulting motion.

    Attributes:
        interface: one of INTERFACES.
        named: its joints, shape (j,).
        limits: that the motion respects.
        period: of the position loop, s.
        options: of the stream.
        count: number of received set-points.
        late: how many of them were due already.
        expires: end of the stream, s, unless there are more set-points.
        pause: s that the sender has been silent, if it goes on after a short interruption; its way has had that time.
        notes: problems, the first of each kind.
    """

    interface: str
    named: Mask
    limits: JointLimits
    period: float
    options: StreamOptions
    count: int = 0
    late: int = 0
    expires: float = 0.0
    pause: float = 0.0
    notes: dict[str, str] = field(default_factory=dict)
    _times: Array = field(default_factory=lambda: np.array([-np.inf]))
    _values: Array = field(init=False)

    @property
    def summary(self) -> str:
        """Return what has come, in words."""
        return f"{self.interface}, {counted(self.count, 'set-point')}, {self.late} late"

    def follow(self, points: SetPoints, tick: int, held: Array) -> Spline | None:
        """Take set-points; return the motion from a tick on, to rest, times in s from there; None if it stays.

        A set-point takes the place of those that were due later. One that is due already is followed at once, unless a
        later one is still to come. Until the next one is there the reference rests at the last position. Where it
        exceeds the limits, it is followed within them; but positions with which the stream begins must be in reach.

        Args:
            points: of the same interface and joints.
            tick: the first one of the position loop that may still be changed.
            held: the set-point at that tick, shape (3, j).

        Raises:
            TrajectoryError: if the stream begins farther away than its time allows.
        """
        # Whole ns: what is due at the same time is equal, and never less than that apart.
        now = round(tick * self.period, 9)
        quantity = INTERFACES.index(self.interface)
        origin = points.stamp_ns / NANOSECONDS or now
        if abs(origin - now) > _OTHER_CLOCK:
            origin = now
            self.notes.setdefault(
                "clock",
                "stamps are of another clock than the controller's time: set-points count from their arrival; "
                "accepted: simulated time (use_sim_time), or no stamps",
            )
        times = np.round(origin + points.times, 9)
        if not self.count and self.interface == POSITION:
            positions = np.clip(points.values[:, 0], -_FAR, _FAR)
            self._check_begin(times - now, positions * self.named, held * self.named)
        self.count += len(times)
        if times[-1] <= now:
            self.late += 1
            self.notes.setdefault(
                "late",
                f"a set-point came {now - times[-1]:.3g} s after it was due: the last one was held; accepted: within "
                f"stream.delay, {self.options.delay:g} s, of its stamp, or time_from_start ahead",
            )
            if self._times[-1] > now:
                return None
            times[-1] = now + self.period
        if self._times[-1] < now:  # the reference begins where the arm is
            self._times = np.array([now])
            self._values = held[None, quantity : quantity + 2] * self.named
        values = np.clip(points.values, -_FAR, _FAR)
        if not values[-1, 1].any():
            # senders usually let a single point rest; the next one is still to come
            values[-1, 1] = np.nan
        values = values[times > now]
        times = times[times > now]
        # the slope at the last one before now needs two
        begin = max(np.searchsorted(self._times, now) - 2, 0)
        end = np.searchsorted(self._times, times[0])
        self._times = np.concatenate([self._times[begin:end], times])
        self._values = np.concatenate([self._values[begin:end], values])
        self.expires = self._times[-1] + self.options.timeout

        reference = self._reference(now)
        free = ~self.named | (self.interface == VELOCITY)
        limits = self.limits
        bounds = np.stack([limits.velocity, limits.acceleration, limits.lower, limits.upper])
        states = _follow(reference, free, bounds, self.period, held)
        behind = abs(states[: len(reference)] - reference)[:-2, quantity].max(axis=0)
        names = ", ".join(np.array(limits.names)[(behind > limits.start_tolerance) & self.named])
        if names:
            self.notes.setdefault(
                "beyond", f"{names}: a {self.interface} beyond the limits; followed within them"
            )
        return interpolate(
            np.arange(float(len(states))) * self.period, states[:, 0], states[:, 1], None
        )

    def _check_begin(self, times: Array, positions: Array, held: Array) -> None:
        """Check that the arm can be at the first positions, shape (n, j), in their times, s, with any velocity there.

        One that turns round has to brake as well, which it may do later. A set-point that is due already has
        `StreamOptions.delay`, as if it came without a stamp.
        """
        limits = self.limits
        given = np.where(times > 0.0, times, self.options.delay)[:, None] + self.pause
        ways = positions - held[0]
        towards = np.maximum(np.sign(ways) * held[1], 0.0)
        ramps = np.clip((limits.velocity - towards) / limits.acceleration, 0.0, given)
        reach = towards * given + limits.acceleration * ramps * (given - 0.5 * ramps)
        far = np.flatnonzero((np.abs(ways) > reach + limits.start_tolerance).any(axis=1))
        if far.size:
            point = int(far[0])
            needed = limits.straight_time(ways[point])
            raise limits.too_early(point, ways[point], float(given[point, 0]), needed)

    def _reference(self, now: float) -> Array:
        """Return position and velocity asked for in each tick, shape (n, 2, j); at rest in the last two."""
        times = self._times - now
        values = self._values[:, 0]
        slopes = self._values[:, 1]
        if self.interface == POSITION:
            slopes = np.where(np.isnan(slopes), np.gradient(values, times, axis=0), slopes)
        else:
            # takes a while, which most runs do without
            from scipy.integrate import cumulative_trapezoid

            times = np.append(times, self.expires - now)
            slopes = np.vstack([values, values[-1]])
            values = cumulative_trapezoid(slopes, times, axis=0, initial=0)
        ticks = np.arange(math.ceil(times[-1] / self.period) + 2)
        return interpolate(times, values, slopes, None).sample(ticks * self.period)[:, :2]


@kernel
def _follow(reference: Array, free: Mask, limits: Array, period: float, held: Array) -> Array:
    """Follow a reference; return position and velocity in each tick until all joints rest, shape (m, 2, j).

    Args:
        reference: positions and velocities in each tick, shape (n, 2, j); at rest in the last.
        free: which joints follow velocities alone, shape (j,).
        limits: of velocity, rad/s, and acceleration, rad/s^2, and lower and upper ones of position, rad, shape (4, j).
        period: of a tick, s.
        held: the set-point at the first tick, shape (3, j).
    """
    last = len(reference) - 1
    states = np.empty_like(reference)
    states[0] = held[:2]
    i = 0
    moving = True
    while moving:
        moving = i < last
        if i + 1 == len(states):
            states = np.concatenate((states, np.empty_like(states)))
        for j in range(len(free)):
            top, acceleration, lower, upper = limits[:, j]
            step = acceleration * period
            q, v = states[i, :, j]
            r, w = reference[min(i, last), :, j]
            # For velocities alone the position is that from which the filter changes the velocity at once.
            error = -0.5 * period * (v - w) if free[j] else q - r
            feed = min(max(reference[min(i + 1, last), 1, j] - w, -0.5 * step), 0.5 * step)
            v1 = v + feed + _filter(error, v - w, step - abs(feed), period)
            # From where it may go, it must be possible to brake before the limits.
            middle = q + 0.5 * period * v
            v1 = min(v1, top, _room(upper - middle, acceleration, period))
            v1 = max(v1, -top, -_room(middle - lower, acceleration, period))
            v1 = min(max(v1, v - step), v + step)
            states[i + 1, 0, j] = middle + 0.5 * period * v1
            states[i + 1, 1, j] = v1
            moving = moving or abs(v) > _SLOW or abs(v1) > _SLOW
        i += 1
    return states[:i]


@inlined
def _filter(error: float, rate: float, most: float, period: float) -> float:
    """Return the change of the velocity in a tick, up to `most`, that takes error and its rate to 0 without overshoot.

    In the least number of ticks, for accelerations that are constant in each (Zanasi et al. 2000, equations 8 to 12).
    """
    z1 = (error / period + 0.5 * rate) / most
    m = math.floor(0.5 + math.sqrt(0.25 + 2.0 * abs(z1)))
    sigma = rate / most + z1 / m + math.copysign(0.5 * (m - 1.0), z1)
    return -most * min(max(sigma, -1.0), 1.0)


@inlined
def _room(distance: float, most: float, period: float) -> float:
    """Return the velocity at the next tick from which the arm still comes to rest within a distance, rad."""
    return most * (math.sqrt(period * period + 2.0 * max(distance, 0.0) / most) - period)
