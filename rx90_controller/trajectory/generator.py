"""The set-point generator: holds a position, follows a trajectory, holds its last point."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.correction import Correction, PlayedCorrection, cut_at
from rx90_controller.trajectory.paths import JointLimits, check_time, connect, stop
from rx90_controller.trajectory.points import TrajectoryPoints
from rx90_controller.trajectory.spline import (
    FollowedPath,
    Path,
    Spline,
    joined,
    merged,
    remainder,
    resting,
    smooth,
)
from rx90_controller.trajectory.stream import POSITION, SetPoints, Stream, StreamOptions

_ADVICE = (
    ", or velocities_from_positions, where the points' velocities do not belong to their positions"
)
_CORRECTION_SLACK = 1e-6  # rad, as planners have it
_MAX_HALT_RATIO = 3  # a stop along the path may take so many times as long as one joint by joint


class PastError(TrajectoryError):
    """All points of a trajectory lie in the past."""


class Schedule(NamedTuple):
    """When an accepted trajectory runs, in position ticks, and by how much it misses its points at most, rad.

    The end is that at full speed.
    """

    begin: int
    end: int
    blend_error: float


class TrajectoryGenerator:
    """Set-points q, dq/dt and d2q/dt2 on the ticks of the position loop.

    One motion runs or holds, and one may wait for its start. Time is counted in position ticks and never read from a
    clock. A trajectory replaces the running one at its start tick; a refused one leaves everything untouched.

    Args:
        limits: that set-points keep.
        period: of the position loop, s.
        hold: position to hold, rad, shape (j,).

    Attributes:
        revision: changes whenever set-points that were sampled in advance may be out of date.
        factor: the last argument of `set_speed_scaling`, 1 in the beginning.
    """

    def __init__(self, limits: JointLimits, period: float, hold: Array) -> None:
        self.limits = limits
        self.period = period
        self.revision = 0
        self.factor = 1.0
        # of a fork: revision, and start of the waiting motion
        self._origin: tuple[int, int | None] = (0, None)
        self.reset(hold)

    def warm_up(self) -> None:
        """Compile, or load, the kernels that a running arm may need."""
        joints = len(self.limits.names)
        rest = np.zeros((2, joints))
        held = np.zeros((3, joints))
        spline = smooth(np.array([0.0, 1.0]), rest, rest)
        spline.bounds()
        self._followed(0, Path(spline, 0.0, 1.0)).halted(0, 1)
        every = np.ones(joints, dtype=np.bool_)
        stream = Stream(POSITION, every, self.limits, self.period, StreamOptions())
        stream.follow(SetPoints(POSITION, 0, np.array([self.period]), rest[None], every), 0, held)

    def reset(self, hold: Array) -> None:
        """Drop every trajectory and hold a position, rad, shape (j,)."""
        self._current = self._followed(0, Path(resting(np.array(hold, dtype=np.float64)), 0.0, 0.0))
        self._current.announced = True
        self._next: FollowedPath | None = None
        self._played: list[PlayedCorrection] = []
        self.revision += 1

    def _followed(self, start: int, path: Path, *, fixed: bool = False) -> FollowedPath:
        return FollowedPath(start, path, self.period, self.limits.acceleration, fixed)

    def delay(self, count: int, now: int) -> None:
        """Shift the running trajectory by `count` ticks, which passed without set-points up to tick `now`.

        A trajectory that is to follow it is shifted as well, because it begins where the running one will then be. If
        the arm rests, it keeps its start tick, or starts now if that has passed.
        """
        self._promote(now - count)
        at_rest = not self._current.runs(now - count)
        self._current.delay(count)
        later = count
        if self._next is not None:
            later = max(now - self._next.start, 0) if at_rest else count
            self._next.delay(later)
        self._played = [
            one.shifted(count if one.begin < now - count else later) for one in self._played
        ]
        self.revision += 1

    # What the set-points are.

    def setpoints(self, tick: int, count: int = 1) -> Array:
        """Return the set-points of `count` position ticks from `tick` on, shape (count, 3, j).

        Ticks must not go back to before the last `accept`.
        """
        return self._sampled(FollowedPath.setpoints, tick, count)

    def _sampled(
        self, sample: Callable[[FollowedPath, int, int], Array], tick: int, count: int
    ) -> Array:
        """Return samples of the running motion and, from its start on, of the waiting one."""
        waiting = self._next
        if waiting is None:
            return sample(self._current, tick, count)
        head = min(max(waiting.start - tick, 0), count)
        before = sample(self._current, tick, head)
        return np.concatenate([before, sample(waiting, tick + head, count - head)])

    def corrected(self, tick: int, count: int = 1) -> Array:
        """Return set-points as the law takes them, and a played correction's offsets beneath, rad, (count, 4, j).

        Their accelerations are those of `FollowedPath.leading`.
        """
        setpoints = self._sampled(FollowedPath.leading, tick, count)
        if not self._played:
            return setpoints
        ticks = np.arange(tick, tick + count)
        offsets = sum(
            (one.at(ticks) for one in self._played), np.zeros((count, setpoints.shape[2]))
        )
        return np.concatenate([setpoints, offsets[:, None]], axis=1)

    def moving(self, tick: int) -> bool:
        """Return whether a trajectory runs, is held on its path, or waits for its start at position tick `tick`."""
        return (self._next or self._current).runs(tick)

    def ended(self, tick: int) -> tuple[int, bool] | None:
        """Return in which tick a motion has come to its end, and whether it was a stop, once for each that does.

        To be called in every position tick. A trajectory that another one has replaced has no end.
        """
        self._promote(tick)
        motion = self._current
        if motion.announced or not motion.over(tick):
            return None
        motion.announced = True
        return tick if motion.laws else motion.end, motion.path.stop

    def state(self, tick: float) -> Array:
        """Return the set-point of the running trajectory at a time in position ticks, whole or not, shape (3, j).

        Past times as far as the running trajectory goes back, future times with the present scaling.

        Raises:
            TrajectoryError: for a time before that.
        """
        motion = self._effective(tick)
        since = motion.start if motion.oldest is None else motion.oldest
        if not tick >= since:
            raise TrajectoryError(
                f"time {tick * self.period:.6g} s; accepted: from {since * self.period:.6g} s on, where the running "
                "motion begins"
            )
        state: Array = motion.states(np.array([tick], dtype=np.float64))[0]
        return state

    def progress(self, tick: int) -> tuple[float, float]:
        """Return times on the path from the beginning of the newest trajectory, s: now, below 0 before, and its end."""
        motion = self._next or self._current
        return motion.at(tick)[0] - motion.path.begin, motion.path.last - motion.path.begin

    # Speed scaling.

    def speed_scaling(self, tick: int) -> float:
        """Return the speed along the path at a position tick, as a share of the trajectory's own; at rest `factor`."""
        motion = self._effective(tick)
        return motion.at(tick)[1] if motion.runs(tick) else self.factor

    def set_speed_scaling(self, factor: float, now: int) -> None:
        """Follow trajectories at `factor` of their speed, in [0, 1], from position tick `now` on; 0 holds on the path.

        Also while one runs: the time on its path then runs slower or faster, as quickly as the accelerations allow.
        A motion that waits behind a running one comes later by as much as that one is slowed down; one that waits at
        rest keeps its start. A stop that begins at once is not slowed down. The factor survives `reset`.

        Raises:
            TrajectoryError: if the factor is not a number in [0, 1].
        """
        if not 0.0 <= factor <= 1.0:
            raise TrajectoryError(f"speed scaling {factor:g}; accepted: a number in [0, 1]")
        self._promote(now)
        if factor == self.factor:
            return
        self.factor = factor
        # it belongs to the speed at which it was learned
        self._played = cut_at(self._played, now, now)
        motion = self._effective(now)
        waiting = self._next
        if motion.runs(now) and not motion.fixed:
            if waiting is not None and motion is not waiting:
                # One path, which changes over to the other at the point that it will have reached, at its present rate,
                # by its start.
                at = motion.at(waiting.start)[0]
                (spline, _, last, stops) = waiting.path
                path = Path(joined(motion.path.spline, at, spline), at, at + last, stops)
                self._current = motion.on(path, motion.path)
                self._next = None
                motion = self._current
            motion.go_at(factor, now)
        elif waiting is not None and motion is not waiting:
            waiting.go_at(factor, waiting.start, 1.0 if motion.runs(waiting.start) else factor)
        self.revision += 1

    # New motions.

    def accept(
        self,
        points: TrajectoryPoints,
        now: int,
        start: int | None,
        correction: Correction | None = None,
    ) -> Schedule:
        """Take a trajectory; return when it runs.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`.
            correction: offsets of the position set-points, played along.

        Raises:
            TrajectoryError: if it lies in the past, starts elsewhere than the arm is, or breaks a limit.
        """
        begin = self._begin(now, start)
        return self._take(points, now, begin, correction, follow=False)

    def join(
        self,
        points: TrajectoryPoints,
        now: int,
        start: int | None,
        correction: Correction | None = None,
        *,
        anywhere: bool,
    ) -> Schedule:
        """Take a trajectory from where the path then is, without a jump; return when it runs.

        As `accept`, but points that are not later than its begin are left out: those in the past, and one at the begin
        itself, which must be as near as `accept` wants it unless `anywhere`. Joints that the points do not name hold,
        or with `anywhere` go on along the running trajectory.

        Args:
            points: the checked points.
            now: the first position tick that may still be changed.
            start: its start tick, None for `now`; may lie in the past.
            correction: offsets of the position set-points, played along.
            anywhere: whether points may be left out that the arm is not near to.

        Raises:
            PastError: if all its points lie in the past.
            TrajectoryError: if it starts elsewhere than the arm is, or breaks a limit.
        """
        begin, late, remaining = points_left(points, now, start, self.period)
        self._promote(now)
        if late > 0.0 and correction is not None:
            raise TrajectoryError(
                f"a correction begins {late:.6g} s late; accepted: with its trajectory's first point"
            )
        if late == 0.0 and points.times[0] == 0.0 and not anywhere:
            reference = self._base(now).entry(begin)
            first = points.held_at(reference[0])
            self.limits.check_near(first, reference)
            if first.velocity is not None and (first.degrees is None or first.degrees[0] > 1):
                self.limits.check_start(reference, first.velocity[0], self.period)
        return self._take(remaining, now, begin, correction, follow=anywhere)

    def follow_stream(self, stream: Stream, points: SetPoints, now: int) -> None:
        """Follow set-points of a stream from position tick `now` on, in place of whatever runs or waits.

        With speed scaling, within that share of the velocities. The motion's end is not announced by `ended`.

        Raises:
            TrajectoryError: if the stream begins farther away than its time allows.
        """
        self._promote(now)
        base = self._base(now)
        rate = self._rate(base, now)
        reference = base.setpoints(now, 1)[0] if rate == 0.0 else base.entry(now)
        spline = stream.follow(points, now, reference)
        if spline is not None:
            self._follow(base, Path(spline, 0.0, spline.duration), now, now, rate or self.factor)
            assert self._next is not None
            self._next.announced = True

    def stop(self, now: int, start: int | None) -> Schedule:
        """Brake every joint to rest from tick `start` on, `now` for None, and hold; return when that happens.

        Raises:
            TrajectoryError: if it lies in the past.
        """
        begin = self._begin(now, start)
        base = self._base(now)
        # A stop at once begins from the present motion; a later one along the path, whose speed may have changed by
        # then.
        position, velocity, _ = base.setpoints(now, 1)[0] if begin == now else base.entry(begin)
        spline = stop(position, velocity, self.limits.acceleration)
        rate = None if begin == now else self._rate(base, begin)
        return self._follow(base, Path(spline, 0.0, spline.duration, stop=True), now, begin, rate)

    def halt(self, now: int) -> Schedule:
        """Come to rest on the path, within the accelerations, from position tick `now` on, and hold.

        If the path leaves so little room that this would take more than three times as long as `stop`, it is
        `stop`. A waiting motion is dropped. Return when the stop begins and ends.
        """
        self._promote(now)
        base = self._base(now)
        acceleration = self.limits.acceleration
        if base.fixed and base.runs(now):
            self._current = base
            self._next = None
            self._played = cut_at(self._played, now, now)
            self.revision += 1
            return Schedule(base.start, base.end, 0.0)
        position, velocity, _ = base.setpoints(now, 1)[0]
        shortest = float((np.abs(velocity) / acceleration).max())
        spline = base.halted(now, _MAX_HALT_RATIO * math.ceil(shortest / self.period) + 2)
        if spline is None:
            spline = stop(position, velocity, acceleration)
        return self._follow(base, Path(spline, 0.0, spline.duration, stop=True), now, now, None)

    # New motions that are computed outside the ticks.

    def fork(self, now: int) -> TrajectoryGenerator | None:
        """Return a generator that continues as this one does from tick `now` on, for another thread to `join` to.

        It does not contain the waiting motion, which a joined one replaces. None if the scaling has changed while
        a motion waited: the set-points until then would depend on that.
        """
        self._promote(now)
        if self._current.before is not None:
            return None
        fork = copy.copy(self)
        fork._origin = (self.revision, None if self._next is None else self._next.start)
        # a fork must not change this generator's laws
        laws = [copy.copy(law) for law in self._current.laws]
        fork._current = replace(self._current, laws=laws)
        fork._next = None
        return fork

    def continues(self, fork: TrajectoryGenerator, now: int) -> bool:
        """Return whether a fork still begins as this generator does: no other motion has come in between."""
        revision, waited = fork._origin
        return self.revision == revision and (waited is None or waited >= now)

    def adopt(self, fork: TrajectoryGenerator, late: int) -> None:
        """Continue as a fork that this one `continues` does; the motion joined to it comes `late` ticks later."""
        if fork._next is not None:
            begin = fork._next.start
            fork._next.delay(late)
            fork._played = [
                one.shifted(late) if one.begin == begin else one for one in fork._played
            ]
        fork._current.announced = self._current.announced
        self._current = fork._current
        self._next = fork._next
        self._played = fork._played
        self.revision += 1

    def _effective(self, tick: float) -> FollowedPath:
        """Return the motion whose set-point a tick gets."""
        return self._current if self._next is None or tick < self._next.start else self._next

    def _promote(self, tick: int) -> None:
        """Make a trajectory that began before position tick `tick` the running one."""
        if self._next is not None and self._next.start < tick:
            self._current = self._next
            self._next = None

    def _begin(self, now: int, start: int | None) -> int:
        begin = now if start is None else start
        if begin < now:
            late = (now - begin) * self.period
            raise TrajectoryError(
                f"start time {begin * self.period:.6g} s is {late:.6g} s in the past; accepted: now or later"
            )
        self._promote(now)
        return begin

    def _base(self, now: int) -> FollowedPath:
        """Return the running motion without the waiting one."""
        motion = self._current
        if motion.before is None or motion.at(now)[0] >= motion.path.begin:
            return motion
        base = motion.on(motion.before)
        base.go_at(self.factor, now)
        return base

    def _rate(self, base: FollowedPath, begin: int) -> float:
        """Return the rate at which something begins behind a motion: that of the motion, or `factor` from rest."""
        return base.at(begin)[1] if base.runs(begin) else self.factor

    def _take(
        self,
        points: TrajectoryPoints,
        now: int,
        begin: int,
        correction: Correction | None,
        *,
        follow: bool,
    ) -> Schedule:
        """Check a trajectory and run it; joints that it does not name hold, or follow the running one."""
        limits = self.limits
        base = self._base(now)
        partial = not points.named.all()
        rate = self._rate(base, begin)
        # Held on the path, the arm rests, and may go elsewhere from there.
        stands_still = begin == now and rate == 0.0 and not (follow and partial)
        reference = base.setpoints(begin, 1)[0] if stands_still else base.entry(begin)
        outside = limits.outside(reference[0])
        # An arm that was pushed beyond a limit may come back: from there on only inwards.
        allowed = np.where(outside > 0.0, outside + limits.start_tolerance, 0.0)
        points = points.held_at(reference[0])
        limits.check_points(points, allowed)
        held = np.where(
            points.named, reference, [reference[0], 0.0 * reference[1], 0.0 * reference[2]]
        )
        if len(points.times) == 1 and points.times[0] > 0.0:
            check_time(points, held, limits, self.period, allowed)
        spline = connect(points, held, limits)
        last = spline.duration
        if points.velocity is not None and points.velocity[-1].any():
            spline = joined(
                spline, last, stop(spline.final, points.velocity[-1], limits.acceleration)
            )
        if partial and follow:
            spline = merged(spline, remainder(base.path.spline, base.at(begin)[0]), ~points.named)
        elif partial:
            spline = merged(
                spline, stop(reference[0], reference[1], limits.acceleration), ~points.named
            )
        limits.check_start(reference, spline.sample(np.zeros(1))[0, 1], self.period, points.first)
        try:
            limits.check_motion(spline, self.period, points, allowed)
        except TrajectoryError as error:
            if points.velocity is None or points.smooth or np.count_nonzero(points.times) < 2:
                raise
            raise TrajectoryError(f"{error}{_ADVICE}") from None
        if correction is not None:
            self._check_correction(correction, spline)
        schedule = self._follow(
            base, Path(spline, 0.0, last), now, begin, self.factor if stands_still else rate
        )
        if correction is not None:
            self._played = [*self._played, PlayedCorrection.started(correction, begin)]
        return schedule

    def _check_correction(self, correction: Correction, spline: Spline) -> None:
        """Refuse a correction of another rate or speed, and one that leads beyond the position limits."""
        if correction.period != self.period:
            raise TrajectoryError(
                f"the correction has an offset every {correction.period:g} s; accepted: every {self.period:g} s, one "
                "for each set-point"
            )
        if self.factor != 1.0:
            raise TrajectoryError(
                f"speed scaling {self.factor:g} with a correction; accepted: 1, as it was learned"
            )
        times = np.arange(len(correction.offsets), dtype=np.float64) * self.period
        position = spline.sample(times)[:, 0]
        offsets = correction.offsets
        beyond = (
            self.limits.outside(position + offsets)
            > self.limits.outside(position) + _CORRECTION_SLACK
        )
        if beyond.any():
            row, joint = np.argwhere(beyond)[0].tolist()
            raise TrajectoryError(
                f"the correction takes {self.limits.names[joint]} to {position[row, joint] + offsets[row, joint]:.6g} "
                f"rad at {row * self.period:.3f} s; accepted: within the joint's limits"
            )

    def _follow(
        self, base: FollowedPath, path: Path, now: int, begin: int, rate: float | None
    ) -> Schedule:
        """Follow a path from a tick on, after `base`, from a rate on; None for full speed whatever the scaling is."""
        self.revision += 1
        self._played = cut_at(self._played, now, begin)
        self._current, self._next = base, self._followed(begin, path, fixed=rate is None)
        end = self._next.end
        if rate is not None:
            self._next.go_at(self.factor, begin, rate)
        return Schedule(begin, end, path.spline.blend_error)


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
    remaining = points if late == 0.0 and len(points.times) == 1 else points.after(late)
    if not len(remaining.times):
        ended = (begin * period - late) + points.times[-1]
        raise PastError(
            f"the last point is at {ended:.6g} s, the controller's time is {now * period:.6g} s; accepted: points "
            "later than that"
        )
    return begin, late, remaining
