"""A line for hours: few cycles are simulated, and what comes of it is what all of them would give."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from own_model import by_model, with_friction

from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import Windings
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop import working_day
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.line import plan_line, run_line
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.result import MotionCommand
from rx90_emulator.loop.setup import Setup
from rx90_emulator.loop.working_day import CHANGE, Cycle, RepeatedLine, ThermalRun, repeat_line

Array = NDArray[np.float64]
PART = TemperaturePart(30.0, 20.0, 90.0, 25.0, 25.0, 60.0, 5.0, 20.0, 0.3, 0.01, 0.01, motor_share=0.2)

WINDING_TIME = 60.0
"""Time constant of the windings, s."""


@pytest.fixture(scope="module")
def warm(shipped: Setup) -> Setup:
    """Return an arm whose joints warm within minutes, and whose windings near their end in a minute."""
    elements = tuple(
        dataclasses.replace(element, temperature=dataclasses.replace(PART, capacity=60.0 + 20.0 * i))
        for i, element in enumerate(shipped.friction.elements)
    )
    friction = dataclasses.replace(shipped.friction, elements=elements)
    six = np.ones(6)
    winding = Windings(0.5 * six, 20.0 * six, WINDING_TIME / 20.0 * six, 20.0, 22.0, coefficient=0.0,
                       derating=150.0, limit=170.0)  # fmt: skip
    drives = dataclasses.replace(shipped.drives, winding=winding)
    return dataclasses.replace(shipped, friction=friction, drives=drives)


@pytest.fixture(scope="module")
def short() -> LineTask:
    """Return the reference line with short rests."""
    return dataclasses.replace(load_task(), rest_before=0.05, rest_after=0.05)


@pytest.fixture(scope="module")
def every(warm: Setup, short: LineTask) -> RepeatedLine:
    """Return ten minutes of which every cycle is simulated."""
    return repeat_line(warm, short, 600.0, change=1e-9)


@pytest.fixture(scope="module")
def day(warm: Setup, short: LineTask) -> RepeatedLine:
    """Return ten minutes with few cycles."""
    return repeat_line(warm, short, 600.0)


def test_few_cycles_give_what_all_of_them_give(every: RepeatedLine, day: RepeatedLine) -> None:
    """Temperatures, heat and path error are those of a run in which every cycle is simulated."""
    assert len(every.times) == int(600.0 / every.cycle) > 1.5 * len(day.times)
    assert np.ptp(every.temperatures, axis=0).max() > 10.0
    for name, tolerance in (("temperatures", 0.02), ("windings", 0.02), ("heat", 0.02), ("worst", 2e-7)):
        values = getattr(every, name).reshape(len(every.times), -1)
        got = getattr(day, name).reshape(len(day.times), -1)
        want = np.array([np.interp(day.times, every.times, column) for column in values.T]).T
        assert np.abs(got - want).max() < tolerance, name


def test_the_first_cycle_is_the_line_there_and_back(warm: Setup, short: LineTask, day: RepeatedLine) -> None:
    """Path error, friction and heat are those of one run without ROS: work of the friction, and I^2 R of the motors.

    With that heat in every cycle the windings near R_th R I^2 above the surroundings by their time constant.
    """
    home = dataclasses.replace(
        short, start=short.end, end=short.start, start_rpy=short.end_rpy, end_rpy=short.start_rpy
    )
    there, back = plan_line(warm, short).points, plan_line(warm, home).points
    ticks = warm.rates.start_tick(float(there.times[-1]))
    run = simulate_commands(warm, (MotionCommand(0, there), MotionCommand(ticks, back)), there.position[0], day.cycle,
                            record_fast=True)  # fmt: skip
    _, velocity, torque = run.slow.friction_states.transpose(1, 0, 2)
    assert day.friction[0] == pytest.approx(np.abs(torque).mean(axis=0), rel=1e-9)
    assert run.fast is not None
    motors = 0.5 * np.mean((run.fast.motor_states[:, 2] / warm.drives.torque_constant) ** 2, axis=0)
    power = np.mean(velocity * torque, axis=0) + 0.2 * np.array([*motors[:5], 0.0, motors[5]])
    assert day.heat[0] == pytest.approx(power, rel=0.01, abs=1e-3)
    accuracy = run_line(warm, short).path_accuracy
    assert (day.worst[0], day.rms[0]) == pytest.approx((accuracy.worst, accuracy.rms), rel=0.01)
    final = 20.0 + 20.0 * motors
    want = final + (22.0 - final) * np.exp(-day.times / WINDING_TIME)[:, None]
    assert day.windings == pytest.approx(want, abs=0.1 * np.ptp(want))
    assert np.ptp(want) > 30.0


def test_no_temperature_changes_by_more_than_asked(day: RepeatedLine) -> None:
    """Between two simulated cycles no joint warms by more than the bound; the last cycle is one of them."""
    assert np.abs(np.diff(day.temperatures, axis=0)).max() < CHANGE * 1.1
    assert day.times[-1] == pytest.approx((math.floor(600.0 / day.cycle) - 1) * day.cycle)
    assert np.all(np.diff(day.temperatures[:, 0]) > 0)
    assert np.abs(day.friction[-1] / day.friction[0] - 1.0).max() > 0.005


def test_windings_and_a_twelfth_of_the_time_bound_what_is_not_simulated(warm: Setup, short: LineTask) -> None:
    """Where the joints stay as they are no winding changes by more than ten bounds, and a curve has twelve points."""
    heavy = with_parameters(warm, {"friction.*.temperature.capacity": 1e9})
    plan = ThermalRun(heavy, short)
    while plan.advance(240):
        pass
    told = plan.result()
    assert np.ptp(told.temperatures, axis=0).max() < 1e-3
    passed = np.diff(told.times) / told.cycle
    assert passed == pytest.approx(np.round(passed))
    assert np.abs(np.diff(told.windings, axis=0)).max() < 10.0 * CHANGE * 1.1
    assert passed.max() == pytest.approx(20.0)
    assert passed[0] < 20.0
    assert told.times[-1] == pytest.approx(239 * told.cycle)


class HeatedJoints:
    """Cycles of joints whose heat is linear in their temperature, in place of simulated ones: P = 6 W + s (T - 25).

    Attributes:
        slope: s, in parts of the conductance of 0.2 W/K.
        capacity: J/K.
    """

    duration = 2.0
    slope = 0.0
    capacity = np.array([60.0 + 20.0 * i for i in range(7)])

    def __init__(self, *_: object) -> None:
        pass

    def after(self, joints: Array, time: float | Array) -> Array:
        """Return the temperatures after a time, by the answer of C dT/dt = P - (T - 25) / R."""
        loss = 0.2 * (1.0 - self.slope)
        end = 25.0 + 6.0 / loss
        return np.asarray(end + (joints - end) * np.exp(-loss / self.capacity * time))

    def run(self, joints: Array, windings: Array) -> Cycle:
        """Return a cycle; the mean heat is what the joints gain and lose in it."""
        begin, none = joints[:7], np.zeros(7)
        end, middle = self.after(begin, self.duration), self.after(begin, 0.5 * self.duration)
        mean = (begin + 4.0 * middle + end) / 6.0
        heat = 6.0 + 0.2 * self.slope * (mean - 25.0)
        both = [np.concatenate([one, none]) for one in (0.5 * (begin + end), end, heat)]
        return Cycle(both[0], both[1], windings, both[2], none, 0.0, 0.0)


@pytest.mark.parametrize(("slope", "tolerance"), [(-0.6, 0.02), (0.0, 0.02), (0.4, 0.02), (1.2, 0.4)])
def test_heat_that_goes_with_the_temperature_is_followed(
    monkeypatch: pytest.MonkeyPatch, warm: Setup, short: LineTask, slope: float, tolerance: float
) -> None:
    """Joints whose heat falls or rises as they warm have the temperatures of the analytic answer, K.

    So do, more roughly, those that warm without end because heat feeds itself. Cycles are no more than are needed.
    """
    monkeypatch.setattr(working_day, "_Cycles", HeatedJoints)
    monkeypatch.setattr(HeatedJoints, "slope", slope)
    cold = dataclasses.replace(warm, drives=dataclasses.replace(warm.drives, winding=Windings()))
    plan = ThermalRun(cold, short)
    while plan.advance(450):
        pass
    told = plan.result()
    want = HeatedJoints().after(np.full(7, 25.0), told.times[:, None])
    assert np.ptp(want, axis=0).min() > 10.0
    assert np.abs(told.temperatures - want).max() < tolerance
    passed, risen = np.diff(told.times), np.abs(np.diff(want, axis=0)).max(axis=1)
    full = (passed > 3.0 * HeatedJoints.duration) & (passed < 450 // 12 * HeatedJoints.duration)
    assert np.all(risen[full][:-1] > CHANGE * (1.0 - 1.5 * HeatedJoints.duration / passed[full][:-1]))


def test_a_time_that_is_typed_has_its_whole_cycles(warm: Setup, short: LineTask, day: RepeatedLine) -> None:
    """As many cycles as a decimal number holds, whatever rounding does to it, and none that it does not hold."""
    plan, cycle = ThermalRun(warm, short), Fraction(round(day.cycle * 4000), 4000)
    assert float(cycle) == day.cycle
    for k in range(1, 2000):
        assert plan.whole_cycles(float(k * cycle)) == k
        assert plan.whole_cycles(float((k + 1) * cycle) - 1e-3) == k


def test_the_model_of_the_controller_warms_with_the_arm(
    warm: Setup, short: LineTask, day: RepeatedLine, tmp_path: Path, edited_yaml: Callable[..., Path]
) -> None:
    """Over minutes it believes the joints as warm as they are, and the path error stays; one that is off has none."""
    known = by_model(with_friction(warm, warm.friction.elements, tmp_path / "friction.yaml"))
    model = known.controller.model
    assert model is not None
    winding = {name: np.array(value).tolist() for name, value in vars(warm.drives.winding).items()}
    model = dataclasses.replace(model, drives=edited_yaml(model.drives, ("winding",), winding))
    known = dataclasses.replace(known, controller=dataclasses.replace(known.controller, model=model))
    told = repeat_line(known, short, 300.0)
    assert np.ptp(told.temperatures, axis=0).max() > 10.0
    assert np.abs(told.believed - told.temperatures).max() < 0.02 * np.ptp(told.temperatures, axis=0).max()
    assert told.worst.max() < 2e-6
    assert not day.believed.any()
    switched_off = ThermalRun(with_parameters(known, {"controller.feed_forward.friction_model": False}), short)
    switched_off.advance(1)
    assert not switched_off.result().believed.any()


def test_a_day_without_temperatures_is_refused(shipped: Setup, short: LineTask, warm: Setup) -> None:
    """An arm that does not get warm, and times that hold no cycle, are refused with what is accepted."""
    with pytest.raises(ConfigError, match="no friction element has a temperature; accepted: one or more"):
        repeat_line(shipped, short, 3600.0)
    for duration in (0.5, math.inf, math.nan):
        with pytest.raises(ConfigError, match=r"the time is .* s; accepted: from one cycle"):
            repeat_line(warm, short, duration)
    with pytest.raises(ConfigError, match="change between cycles is 0"):
        repeat_line(warm, short, 3600.0, change=0.0)
