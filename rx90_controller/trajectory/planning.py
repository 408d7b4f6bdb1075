"""Trajectories that are joined to a copy of the generator, because that may take long, and handed over."""

from __future__ import annotations

import copy
from dataclasses import replace

from rx90_common.base.errors import TrajectoryError
from rx90_controller.trajectory.generator import Schedule, TrajectoryGenerator
from rx90_controller.trajectory.points import TrajectoryPoints


class Plan:
    """A trajectory on its way into a generator, which goes on meanwhile.

    To be made between two ticks; then `join`, beside the ticks; then `adopt`, between two ticks again.
    """

    def __init__(self, generator: TrajectoryGenerator, now: int, lead: int) -> None:
        """Plan for a generator, whose first tick that may still be changed is `now`.

        Unless the arm rests, a trajectory begins `lead` ticks later at the earliest: by then it should be there.
        """
        motion = generator._current
        self._generator, self._revision = generator, generator.revision
        self._rests = not motion.runs(now)
        # What waits behind the running motion would become part of the plan's past.
        self._possible = generator._next is None and motion.before is None
        self._earliest = now if self._rests else now + lead
        self._motion = replace(motion, laws=[copy.copy(law) for law in motion.laws])
        self._twin = copy.copy(generator)
        self._twin._current = self._motion
        self._schedule: Schedule | None = None
        self._error: TrajectoryError | None = None
        self._now_wanted = False

    def join(self, points: TrajectoryPoints, start: int | None, *, anywhere: bool) -> None:
        """Compute what `TrajectoryGenerator.join` does; the arguments are the same."""
        self._now_wanted = start is None
        if self._possible:
            try:
                self._schedule = self._twin.join(points, self._earliest, start, anywhere=anywhere)
            except TrajectoryError as error:
                self._error = error

    def adopt(self, now: int) -> Schedule | None:
        """Let the generator follow the trajectory; return when it runs, or None if that has to be computed anew.

        That is so where other motions have come in between, or the computation took longer than there was time for.
        `now` is again the first tick that may still be changed.

        Raises:
            TrajectoryError: why the trajectory cannot be followed.
        """
        generator, twin, schedule = self._generator, self._twin, self._schedule
        if generator.revision != self._revision:
            return None
        if self._error is not None:
            raise self._error
        if schedule is None:
            return None
        late = max(0, now - (schedule.begin if self._rests else self._earliest))
        if late and not (self._rests and self._now_wanted):
            return None
        if twin._next is not None:
            twin._next.delay(late)
        self._motion.announced = generator._current.announced
        generator._current, generator._next = twin._current, twin._next
        generator.revision += 1
        return Schedule(schedule.begin + late, schedule.end + late, schedule.miss)
