"""Trajectories joined to a copy of the generator, and handed over: as the generator itself would have taken them."""

from __future__ import annotations

from copy import copy

import numpy as np
import pytest
from joint_moves import HOME, LIMITS, NAMES, PERIOD, move

from rx90_common.base.arrays import Array
from rx90_controller.trajectory import TrajectoryGenerator, TrajectoryPoints
from rx90_controller.trajectory.request import GoalOptions, GoalTolerances, JoinedAhead, TrajectoryRequest

NOW, END = 500, 1000
LEAD = 24  # ticks: at the second attempt four times 5 ms, and a little for one point and one second
BACK = move(0.05, 1.0)


def running() -> TrajectoryGenerator:
    """Return a generator in the midst of a motion that ends at END."""
    generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    generator.accept(move(0.2, 1.0), 0, 0)
    generator.setpoints(0, NOW)
    return generator


def planned(
    generator: TrajectoryGenerator, points: TrajectoryPoints = BACK, now: int = NOW, start: int | None = None
) -> JoinedAhead:
    """Return a trajectory that was joined at a tick."""
    request = TrajectoryRequest(None, points, start, GoalTolerances.of_parameters(NAMES), GoalOptions(), is_goal=True)
    ahead = JoinedAhead(request, generator, now, 1)
    ahead.compute()
    return ahead


def rest(generator: TrajectoryGenerator, tick: int) -> Array:
    """Return what the generator does from a tick on."""
    return generator.setpoints(tick, 3000)


@pytest.mark.parametrize("late", [0, 10, LEAD])
def test_what_is_handed_over_in_time_is_what_the_generator_would_do(late: int) -> None:
    """It begins after the lead, to the bit; set-points that were sampled in advance are said to be out of date."""
    generator, alone = running(), running()
    plan, revision = planned(generator), generator.revision
    schedule = plan.adopt(NOW + late)
    assert schedule == alone.join(BACK, NOW, NOW + LEAD, anywhere=False)
    assert schedule.begin == NOW + LEAD
    assert generator.revision != revision
    assert np.array_equal(rest(generator, NOW + late), rest(alone, NOW + late))


def test_what_would_come_too_late_is_not_handed_over() -> None:
    """On the way, one tick behind the lead, or behind a start that has been stamped: to be joined anew."""
    for start, late in ((None, LEAD + 1), (NOW + 5, 6), (NOW, 1)):
        plan = planned(running(), start=start)
        assert not plan.fits(NOW + late)
        assert plan.fits(NOW + late - 1)


def test_from_rest_it_begins_when_it_is_there() -> None:
    """Then the time that it took shifts the motion, and when it is said to run."""
    generator = TrajectoryGenerator(LIMITS, PERIOD, HOME)
    alone = copy(generator)
    assert planned(generator).adopt(NOW + 77) == alone.join(BACK, NOW + 77, None, anywhere=False)
    assert np.array_equal(rest(generator, NOW + 77), rest(alone, NOW + 77))


def test_what_waits_is_replaced_unless_it_has_begun_meanwhile() -> None:
    """A trajectory that would have begun before the one that is joined never runs; once it runs, it is joined to."""
    generator, alone = running(), running()
    generator.join(move(0.6, 2.0), NOW, NOW + 10, anywhere=False)
    plan = planned(generator)
    assert not plan.fits(NOW + 11)
    assert plan.fits(NOW + 10)
    plan.adopt(NOW + 10)
    alone.join(BACK, NOW, NOW + LEAD, anywhere=False)
    assert np.array_equal(rest(generator, NOW + 10), rest(alone, NOW + 10))


def test_an_end_is_told_once() -> None:
    """Where the motion ends, and is said to have, while the next one is joined, the end is not told again."""
    generator = running()
    plan = planned(generator, now=END - 1)
    assert generator.ended(END) is not None
    plan.adopt(END + 1)
    assert [generator.ended(END + k) for k in range(1, LEAD - 1)] == [None] * (LEAD - 2)
