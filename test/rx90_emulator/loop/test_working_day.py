"""A line for hours: few cycles are simulated, and what comes of it is what all of them would give."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.application import with_parameters
from rx90_emulator.loop.setup import Setup
from rx90_emulator.loop.working_day import CHANGE, RepeatedLine, repeat_line

PART = TemperaturePart(30.0, 20.0, 90.0, 25.0, 25.0, 60.0, 5.0, 20.0, 0.3, 0.01, 0.01)


@pytest.fixture(scope="module")
def warm(shipped: Setup) -> Setup:
    """Return an arm whose joints warm within minutes."""
    elements = tuple(
        dataclasses.replace(element, temperature=dataclasses.replace(PART, capacity=60.0 + 20.0 * i))
        for i, element in enumerate(shipped.friction.elements)
    )
    return dataclasses.replace(shipped, friction=dataclasses.replace(shipped.friction, elements=elements))


@pytest.fixture(scope="module")
def short() -> LineTask:
    """Return the reference line with short rests."""
    return dataclasses.replace(load_task(), rest_before=0.05, rest_after=0.05)


@pytest.fixture(scope="module")
def day(warm: Setup, short: LineTask) -> RepeatedLine:
    """Return ten minutes with few cycles."""
    return repeat_line(warm, short, 600.0)


def test_few_cycles_give_what_all_of_them_give(warm: Setup, short: LineTask, day: RepeatedLine) -> None:
    """Temperatures, heat and path error are those of a run in which every cycle is simulated."""
    every = repeat_line(warm, short, 600.0, change=1e-9)
    assert len(every.times) == int(600.0 / every.cycle) > 1.5 * len(day.times)
    assert np.ptp(every.temperatures, axis=0).max() > 10.0
    for name, tolerance in (("temperatures", 0.02), ("heat", 0.02), ("worst", 2e-7)):
        values = getattr(every, name).reshape(len(every.times), -1)
        got = getattr(day, name).reshape(len(day.times), -1)
        want = np.array([np.interp(day.times, every.times, column) for column in values.T]).T
        assert np.abs(got - want).max() < tolerance, name


def test_no_temperature_changes_by_more_than_asked(day: RepeatedLine) -> None:
    """Between two simulated cycles no joint warms by more than the bound; the last cycle is one of them."""
    assert np.abs(np.diff(day.temperatures, axis=0)).max() < CHANGE * 1.1
    assert day.times[-1] == pytest.approx((math.floor(600.0 / day.cycle) - 1) * day.cycle)
    assert np.all(np.diff(day.temperatures[:, 0]) > 0)
    assert np.abs(day.friction[-1] / day.friction[0] - 1.0).max() > 0.005


def test_a_day_without_temperatures_is_refused(shipped: Setup, short: LineTask, warm: Setup) -> None:
    """An arm that does not get warm, and times that hold no cycle, are refused with what is accepted."""
    with pytest.raises(ConfigError, match="no friction element has a temperature; accepted: one or more"):
        repeat_line(shipped, short, 3600.0)
    for duration in (0.5, math.inf, math.nan):
        with pytest.raises(ConfigError, match=r"the time is .* s; accepted: from one cycle"):
            repeat_line(warm, short, duration)
    with pytest.raises(ConfigError, match="change between cycles is 0"):
        repeat_line(warm, short, 3600.0, change=0.0)


def test_start_and_surroundings_have_paths(warm: Setup) -> None:
    """A sweep, or a user in Python, gives start temperatures and surroundings; others than the law's are refused."""
    hot = with_parameters(warm, {"friction.joint_2.temperature.start": 60.0, "friction.*.temperature.ambient": 21.0})
    assert hot.plant().temperatures.now.tolist() == [25.0, 60.0, *[25.0] * 5]
    assert {e.temperature.ambient for e in hot.friction.elements if e.temperature} == {21.0}
    with pytest.raises(ConfigError, match=r"friction.joint_1.*start is 95 °C; accepted: from lowest to highest"):
        with_parameters(warm, {"friction.*.temperature.start": 95.0})
