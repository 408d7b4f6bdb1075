"""The set-point generator: holds a position, follows a trajectory, holds its last point."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.joining import braked, check_near, connect, merged, remainder
from rx90_controller.trajectory.limits import JointLimits
from rx90_controller.trajectory.motions import FollowedPath, Motions, Path
from rx90_controller.trajectory.path_time import PathTime
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.ramps import stop
from rx90_controller.trajectory.spline import Bounds, Spline, smooth

_ANEW = ", or velocities_from_positions, where the points' velocities do not belong to their positions"
_PATIENCE = 3  # a stop along the path may take so many times as long as one joint by joint
_CHECKED_AT_ONCE = 4096
# The largest acceleration lies between two set-points, and may be a little more than the largest set-point.
_SLACK = 1e-3  # of the limit


class PastError(TrajectoryError):
    """All points of a trajectory lie in the past."""


class Schedule(NamedTuple):
    """When an accepted trajectory runs, in position ticks, and by how much it misses its points at most, rad.

    The end is that at full speed.
    """

    begin: int
    end: int
    blend_error: float


class TrajectoryGenerator(Motions):
    """Set-points q, dq/dt and d2q/dt2 on the ticks of the position loop.

    Time is counted in position ticks and never read from a clock. A trajectory replaces the running one at
    its start tick; a refused one leaves everything untouched.
    """

    def warm_up(self) -> None:
        """Compile, or load, the kernels that a running arm may need."""
        rest = np.zeros((2, 6))
        spline = smooth(np.array([0.0, 1.0]), rest, rest)
        Bounds.of(spline.coefficients, np.ones(1))
        law = PathTime(spline, self.limits.acceleration, self.period, tick=0, time=0.0, rate=1.0, wanted=0.0)
        law.settles(1)

    def refined(self, ratio: int) -> TrajectoryGenerator:
        """Return a generator of the same motions, at full speed, whose ticks are `ratio` times as frequent."""
        finer = TrajectoryGenerator(self.limits, self.period / ratio, self._current.path.spline.final)
        finer._current = self._current.refined(ratio)
        finer._next = self._next and self._next.refined(ratio)
        return finer

    def enter(self, points: TrajectoryPoints, now: int, start: int | None, *, anywhere: bool, exact: bool) -> Schedule:
        """Take a trajectory as `accept` does if `exact`, else, and where its start is over, as `join` does."""
        late = start is not None and start < now
        if exact and not anywhere and not late:
            return self.accept(points, now, start)
        return self.join(points, now, start, anywhere=anywhere)

    def accept(self, points: TrajectoryPoints, now: int, start: int | None) -> Schedule:
        """Take a trajectory; return when it runs.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`.

        Raises:
            TrajectoryError: if it lies in the past, starts elsewhere than the arm is, or breaks a limit.
        """
        begin = self._begin(now, start)
        return self._take(points, now, begin, follow=False)

    def join(self, points: TrajectoryPoints, now: int, start: int | None, *, anywhere: bool) -> Schedule:
        """Take a trajectory from where the path then is, without a jump; return when it runs.

        As `accept`, but points that are not later than its begin are left out: those in the past, and one at the begin
        itself, which must be as near as `accept` wants it unless `anywhere`. Joints that the points do not name hold,
        or with `anywhere` go on along the running trajectory.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`; may lie in the past.
            anywhere: whether points may be left out that the arm is not near to.

        Raises:
            PastError: if all its points lie in the past.
            TrajectoryError: if it starts elsewhere than the arm is, or breaks a limit.
        """
        begin, late, left = points_left(points, now, start, self.period)
        self._promote(now)
        if late == 0.0 and points.times[0] == 0.0 and not anywhere:
            held = self._base(now).entry(begin)
            first = points.held_at(held[0])
            check_near(first, held, self.limits)
            if first.velocity is not None and (first.degrees is None or first.degrees[0] > 1):
                self.limits.check_start(held, np.stack([held[0], first.velocity[0]]), self.period)
        return self._take(left, now, begin, follow=anywhere)

    def stop(self, now: int, start: int | None) -> Schedule:
        """Brake every joint to rest from tick `start` on, `now` for None, and hold; return when that happens.

        Raises:
            TrajectoryError: if it lies in the past.
        """
        begin = self._begin(now, start)
        base = self._base(now)
        # At once from what the arm does; later along the path, whose speed may have changed by then.
        position, velocity, _ = base.setpoints(now, 1)[0] if begin == now else base.entry(begin)
        rate = None if begin == now else self._rate(base, begin)
        return self._run(base, Path.of(stop(position, velocity, self.limits.acceleration), stop=True), begin, rate)

    def halt(self, now: int) -> Schedule:
        """Come to rest on the path, within the accelerations, from position tick `now` on, and hold.

        Where the path leaves so little room that this would take more than three times as long as `stop`, it is
        `stop`. What waits for its start is dropped. Return when the stop begins and ends.
        """
        self._promote(now)
        base, acceleration = self._base(now), self.limits.acceleration
        if base.fixed and base.runs(now):
            self._current, self._next = base, None
            self.revision += 1
            return Schedule(base.start, base.end, 0.0)
        position, velocity, _ = base.setpoints(now, 1)[0]
        shortest = float((np.abs(velocity) / acceleration).max())
        spline = base.halted(now, acceleration, _PATIENCE * math.ceil(shortest / self.period) + 2)
        if spline is None:
            spline = stop(position, velocity, acceleration)
        return self._run(base, Path.of(spline, stop=True), now, None)

    def _begin(self, now: int, start: int | None) -> int:
        begin = now if start is None else start
        if begin < now:
            late = (now - begin) * self.period
            raise TrajectoryError(
                f"start time {begin * self.period:.6g} s is {late:.6g} s in the past; accepted: now or later"
            )
        self._promote(now)
        return begin

    def _take(self, points: TrajectoryPoints, now: int, begin: int, *, follow: bool) -> Schedule:
        """Check a trajectory and run it; joints that it does not name hold, or follow the running one."""
        limits, base, partial = self.limits, self._base(now), not points.named.all()
        rate = self._rate(base, begin)
        # Held on the path, the arm rests, and may go elsewhere from there.
        rests = begin == now and rate == 0.0 and not (follow and partial)
        held = base.setpoints(begin, 1)[0] if rests else base.entry(begin)
        outside = limits.outside(held[0])
        # An arm that was pushed beyond a limit may come back: from there on only inwards.
        allowed = np.where(outside > 0.0, outside + limits.start_tolerance, 0.0)
        points = points.held_at(held[0])
        limits.check_points((points.position, points.velocity, points.acceleration), allowed, points.first)
        spline = connect(points, np.where(points.named, held, [held[0], np.zeros(6), np.zeros(6)]), limits)
        last = spline.duration
        if points.velocity is not None and points.velocity[-1].any():
            spline = braked(spline, points.velocity[-1], limits)
        if partial:
            others = (
                remainder(base.path.spline, base.at(begin)[0])
                if follow
                else stop(held[0], held[1], limits.acceleration)
            )
            spline = merged(spline, others, ~points.named)
        limits.check_start(held, spline.sample(np.zeros(1))[0], self.period, points.first)
        try:
            check_spline(spline, self.period, points, limits, allowed)
        except TrajectoryError as error:
            if points.velocity is None or points.smooth or np.count_nonzero(points.times) < 2:
                raise
            raise TrajectoryError(f"{error}{_ANEW}") from None
        return self._run(base, Path.of(spline, last), begin, self.factor if rests else rate)

    def _run(self, base: FollowedPath, path: Path, begin: int, rate: float | None) -> Schedule:
        self._follow(base, path, begin, rate)
        return Schedule(begin, FollowedPath(begin, path, self.period).end, path.spline.blend_error)


def points_left(
    points: TrajectoryPoints, now: int, start: int | None, period: float
) -> tuple[int, float, TrajectoryPoints]:
    """Return the tick at which `TrajectoryGenerator.join` would begin, how late that is, s, and the points after it.

    Raises:
        PastError: if there are none.
    """
    begin = now if start is None else max(start, now)
    late = 0.0 if start is None else (begin - start) * period
    # Nothing but the start: whoever is there already has reached it.
    left = points if late == 0.0 and len(points.times) == 1 else points.after(late)
    if not len(left.times):
        ended = (begin * period - late) + points.times[-1]
        raise PastError(
            f"the last point is at {ended:.6g} s, the controller's time is {now * period:.6g} s; accepted: points "
            "later than that"
        )
    return begin, late, left


class Plan:
    """A trajectory on its way into a generator, which goes on meanwhile.

    To be made between two ticks; then `join`, beside the ticks; then `adopt`, between two ticks again.
    """

    def __init__(
        self,
        generator: TrajectoryGenerator,
        points: TrajectoryPoints,
        start: int | None,
        now: int,
        lead: int,
        *,
        anywhere: bool,
        exact: bool,
    ) -> None:
        """Plan for a generator, whose first tick that may still be changed is `now`; the others as `enter` has them.

        A trajectory whose start does not lie ahead begins `lead` ticks later, when it should be there; from rest, where
        it begins makes no difference, as soon as it is there.
        """
        generator._promote(now)
        motion = generator._current
        self._generator, self._revision = generator, generator.revision
        self._points, self._start, self._anywhere, self._exact = points, start, anywhere, exact
        # From rest what begins "now" may as well begin later.
        self._may_be_late = start is None and not motion.runs(now)
        ahead = start is not None and start >= now
        # Where the scaling has changed while something waited, what runs until `now` would depend on that.
        self._possible = motion.before is None
        self._now = now
        self._earliest = now if self._may_be_late or ahead else now + lead
        self._waiting = generator._next
        self._motion = replace(motion, laws=[copy.copy(law) for law in motion.laws])
        self._twin = copy.copy(generator)
        # What waits for its start is replaced: the twin has not got it.
        self._twin._current, self._twin._next = self._motion, None
        self._schedule: Schedule | None = None
        self._error: TrajectoryError | None = None

    def join(self) -> None:
        """Compute what the generator would."""
        if self._possible:
            try:
                self._schedule = self._twin.enter(
                    self._points, self._earliest, self._start, anywhere=self._anywhere, exact=self._exact
                )
            except PastError as error:
                # By then, but perhaps not yet.
                self._error = error if self._earliest == self._now else None
            except TrajectoryError as error:
                self._error = error

    def fits(self, now: int) -> bool:
        """Return whether `adopt` will not return None at this tick."""
        if self._generator.revision != self._revision or self._begun(now):
            return False
        if self._error is not None:
            return True
        return self._schedule is not None and (self._late(self._schedule, now) == 0 or self._may_be_late)

    def adopt(self, now: int) -> Schedule | None:
        """Let the generator follow the trajectory; return when it runs, or None if that has to be computed anew.

        That is so where other motions have come in between, or the computation took longer than there was time for.
        `now` is again the first tick that may still be changed.

        Raises:
            TrajectoryError: why the trajectory cannot be followed.
        """
        if not self.fits(now):
            return None
        if self._error is not None:
            raise self._error
        generator, twin, schedule = self._generator, self._twin, self._schedule
        assert schedule is not None
        late = self._late(schedule, now)
        if twin._next is not None:
            twin._next.delay(late)
        self._motion.announced = generator._current.announced
        generator._current, generator._next = twin._current, twin._next
        generator.revision += 1
        return Schedule(schedule.begin + late, schedule.end + late, schedule.blend_error)

    def _begun(self, now: int) -> bool:
        """Return whether what waited for its start then may have begun meanwhile."""
        return self._waiting is not None and self._waiting.start < now

    @staticmethod
    def _late(schedule: Schedule, now: int) -> int:
        return max(0, now - schedule.begin)


def check_spline(spline: Spline, period: float, points: TrajectoryPoints, limits: JointLimits, allowed: Array) -> None:
    """Check a motion: its set-points, and the accelerations between them.

    What passes is within the accelerations wherever it is, so that it can be travelled at every lower speed too.

    Args:
        spline: the motion.
        period: of the position loop, s.
        points: that it goes through, to say which one is meant.
        limits: to keep.
        allowed: how far beyond the position limits the first set-point may lie, rad, shape (6,).

    Raises:
        TrajectoryError: naming joint, point, time, amount and limit.
    """
    if not allowed.any() and _surely_within(spline, points, limits):
        return
    last = int(np.ceil(spline.duration / period - 1e-6))
    for first in range(0, last, _CHECKED_AT_ONCE):
        # The blocks share a set-point, so that the step from one to the next is checked, too.
        ticks = np.arange(first, min(first + _CHECKED_AT_ONCE, last) + 1)
        times = np.asarray(ticks * period, dtype=np.float64)
        allowed = limits.check(spline.sample(times), times, points.times, allowed, points.first)
    _check_between(spline, points, limits)


def _surely_within(spline: Spline, points: TrajectoryPoints, limits: JointLimits) -> bool:
    """Return whether bounds tell that a spline is within the limits.

    With a whole spline within the accelerations, its set-points are too, and the steps between them.
    """
    coefficients, span, bounds = spline.coefficients, np.diff(spline.times), []
    if points.way is not None and len(span) == len(points.way.coefficients) + 1:
        # Left is what leads to the first point.
        coefficients, span, bounds = coefficients[:1], span[:1], [points.way.bounds]
    bounds.append(Bounds.of(coefficients, span))
    return all(limits.contain(*each) for each in bounds)


def _check_between(spline: Spline, points: TrajectoryPoints, limits: JointLimits) -> None:
    """Check the largest accelerations of all pieces."""
    c, span = spline.coefficients, np.diff(spline.times)[:, None]
    # The derivative of the acceleration is 6 c3 + 24 c4 s + 60 c5 s^2; the extremes lie at its roots or at the ends.
    half, square = 12.0 * c[:, 4], 60.0 * c[:, 5]
    with np.errstate(divide="ignore", invalid="ignore"):
        root = half + np.copysign(np.sqrt(half * half - square * 6.0 * c[:, 3]), half)
        extremes = (-root / square, -6.0 * c[:, 3] / root)
    for at in (np.zeros_like(half), span + np.zeros_like(half), *extremes):
        inside = np.where((at > 0.0) & (at < span), at, np.where(at == span, at, 0.0))
        value = 2.0 * c[:, 2] + inside * (6.0 * c[:, 3] + inside * (12.0 * c[:, 4] + inside * 20.0 * c[:, 5]))
        beyond = np.argwhere(~(np.abs(value) <= (1.0 + _SLACK) * limits.acceleration))
        if len(beyond):
            row, joint = beyond[0]
            time, most = spline.times[row] + inside[row, joint], limits.acceleration[joint]
            middle = 0.5 * (spline.times[row] + spline.times[row + 1])
            point = points.first + min(int(np.searchsorted(points.times, middle)), len(points.times) - 1)
            raise TrajectoryError(
                f"point {point}: {limits.names[joint]} gets an acceleration of {value[row, joint]:.6g} rad/s^2 on the "
                f"way there, between two set-points, at {time:.6g} s; accepted: [{-most:.6g}, {most:.6g}]"
            )
