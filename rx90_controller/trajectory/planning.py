"""Trajectories that are joined to a copy of the generator, because that may take long, and handed over."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace

from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.generator import PastError, Schedule, TrajectoryGenerator
from rx90_controller.trajectory.points import TrajectoryPoints

_FEW, _SHORT = 20, 20.0  # points, s
# Later by so much a long trajectory begins whose start is "now": s, for each point, and for each second of it, in which
# a thousand set-points may have to be checked.
_LEAD, _LEAD_EACH, _LEAD_SECOND = 5e-3, 1e-4, 5e-4


@dataclass(frozen=True)
class Entrance:
    """How a trajectory comes into a generator.

    Attributes:
        points: checked.
        start: its start in position ticks; None for now.
        anywhere: whether points that are not later than the start may be left out wherever they are.
        first_point: whether a point at the start is followed to the bit (`TrajectoryGenerator.accept`); else, and where
            the start is over, the way leads to the points after it from where the path is (`join`).
    """

    points: TrajectoryPoints
    start: int | None
    anywhere: bool = False
    first_point: bool = False

    @property
    def long(self) -> bool:
        """Return whether to check it may take longer than a tick."""
        return len(self.points.times) > _FEW or bool(self.points.times[-1] > _SHORT)

    def lead(self, period: float) -> int:
        """Return how many ticks, a period in s apart, it should take at the most to join it."""
        count, duration = len(self.points.times), float(self.points.times[-1])
        return round((_LEAD + _LEAD_EACH * count + _LEAD_SECOND * duration) / period)

    def enter(self, generator: TrajectoryGenerator, now: int) -> Schedule:
        """Let a generator follow the trajectory; `now` is the first tick that may still be changed.

        Raises:
            PastError: if all its points lie in the past.
            TrajectoryError: if it starts elsewhere than the arm is, or breaks a limit.
        """
        late = self.start is not None and self.start < now
        if self.first_point and not self.anywhere and not late:
            return generator.accept(self.points, now, self.start)
        return generator.join(self.points, now, self.start, anywhere=self.anywhere)


class Plan:
    """A trajectory on its way into a generator, which goes on meanwhile.

    To be made between two ticks; then `join`, beside the ticks; then `adopt`, between two ticks again.
    """

    def __init__(self, generator: TrajectoryGenerator, entrance: Entrance, now: int, lead: int) -> None:
        """Plan for a generator, whose first tick that may still be changed is `now`.

        A trajectory whose start does not lie ahead begins `lead` ticks later, when it should be there; from rest, where
        it begins makes no difference, as soon as it is there.
        """
        generator._promote(now)
        motion = generator._current
        self._generator, self._revision, self._entrance = generator, generator.revision, entrance
        # From rest what begins "now" may as well begin later.
        self._may_be_late = entrance.start is None and not motion.runs(now)
        ahead = entrance.start is not None and entrance.start >= now
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
                self._schedule = self._entrance.enter(self._twin, self._earliest)
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
        return Schedule(schedule.begin + late, schedule.end + late, schedule.miss)

    def _begun(self, now: int) -> bool:
        """Return whether what waited for its start then may have begun meanwhile."""
        return self._waiting is not None and self._waiting.start < now

    @staticmethod
    def _late(schedule: Schedule, now: int) -> int:
        return max(0, now - schedule.begin)
