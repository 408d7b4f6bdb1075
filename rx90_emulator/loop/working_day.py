"""A line there and back for hours: simulated in full once in a while, with exact steps of the temperatures between.

A cycle lasts seconds and a joint warms over an hour, so few cycles need to be simulated. With the heat P that a cycle
brought at the temperature T_0 in its middle, and its slope s over temperature, as the cycles before show it,

    capacity dT/dt = P + s (T - T_0) - (T - ambient) / resistance

is linear and has an exponential as its answer (Rosenbrock's method; what is left out is of the third order in the
temperature's change, or of the second until the slope is known). It is followed over as many whole cycles as no
temperature changes by more than a bound in, then the next cycle is simulated. Windings go with an exponential of their
own time constant towards where the simulated cycle drove them. What the controller's model believes of the joints goes
the way of the joints, as elements of its own: arrays of 2 e, the e of the plant first.

Each simulated cycle begins with a reset, so with the same random numbers: else what scatter changes between two cycles
would count as the slope s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, check_type
from rx90_controller.law.model import ModelTemperatures
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.closed_loop import run_setpoints, setpoints_of
from rx90_emulator.loop.line import path_accuracy, plan_line
from rx90_emulator.loop.result import MotionCommand, empty_series
from rx90_emulator.loop.setup import Setup

CHANGE = 0.5
"""K by which no temperature changes between two simulated cycles, unless the caller says otherwise."""
LONGEST = 1000.0 * 3600.0
"""Time that may be simulated, s."""
_MIN_CYCLES = 12  # cycles that are simulated, if there are so many: a curve needs points
_WINDING_CHANGE = 10.0  # of the windings, in parts of that of the joints: 10 K change their resistance by 4 %
_MIN_CHANGE = 0.2  # in parts of the bound, from which on a change of heat is more than its noise
_MAX_FEEDBACK = 0.5  # of slope times resistance: beyond, heat would feed itself

_CYCLE_FIELDS = ("heat", "friction", "worst", "rms")  # of a cycle, of which a repeated line has a row each

ProgressCallback = Callable[[int, int], None]


class Cycle(NamedTuple):
    """What one simulated cycle gave, in plant and controller.

    Attributes:
        warm: temperatures in its middle, degrees Celsius, shape (2 e,).
        end: temperatures at its end, degrees Celsius, shape (2 e,).
        windings: temperatures at its end, degrees Celsius, shape (6,).
        heat: mean, of friction and motors, W, shape (2 e,).
        friction: mean size of the friction torque, Nm, shape (7,).
        worst: path error of the way there, m.
        rms: the same.
    """

    warm: Array
    end: Array
    windings: Array
    heat: Array
    friction: Array
    worst: float
    rms: float


@dataclass(frozen=True, eq=False)
class RepeatedLine:
    """A line there and back, again and again; a row for each cycle that was simulated.

    Attributes:
        setup: what ran.
        task: the line.
        cycle: how long one lasts, s.
        times: when they began, s, shape (n,).
        temperatures: of the friction elements then, degrees Celsius, 0 where one has none, shape (n, 7).
        windings: of the motors, degrees Celsius, shape (n, 6).
        heat: mean of friction and motors in the cycle, W, shape (n, 7).
        believed: temperatures of the friction elements in the controller's model, degrees Celsius, 0 where it has none
            or is off, shape (n, 7).
        friction: mean size of the friction torque in the cycle, Nm, shape (n, 7).
        worst: largest path error on the way there, m, shape (n,).
        rms: root mean square path error there, m, shape (n,).
    """

    setup: Setup
    task: LineTask
    cycle: float
    times: Array
    temperatures: Array
    windings: Array
    heat: Array
    believed: Array
    friction: Array
    worst: Array
    rms: Array


def repeat_line(
    setup: Setup, task: LineTask, duration: float, *, change: float = CHANGE, tell: ProgressCallback | None = None
) -> RepeatedLine:
    """Run a line there and back for so long, from the temperatures that its files have at the start.

    Args:
        setup: robot, drives, friction, controller, rates; one friction element or more with a temperature.
        task: the line.
        duration: s; as many whole cycles as it has.
        change: K by which no joint's temperature changes between two cycles that are simulated.
        tell: is called with the cycles that are done and those that there are; what it raises comes out.

    Raises:
        ConfigError: for elements without a temperature, a duration shorter than a cycle, a change that is not above 0.
        LineError: if the arm cannot travel the line, there or back.
        DivergenceError: naming joint and tick.
        SupervisionError: if the controller's supervision cuts the power.
    """
    day = ThermalRun(setup, task, change)
    total = day.whole_cycles(duration)
    while day.advance(total):
        if tell is not None:
            tell(day.done, total)
    return day.result()


class ThermalRun:
    """What `repeat_line` does, step by step, so that whoever is interrupted has what was done.

    Temperatures are those of 2 e joints, of the plant and of the controller's model, and of the windings.

    Attributes:
        done: how many cycles have been passed.
    """

    def __init__(self, setup: Setup, task: LineTask, change: float = CHANGE) -> None:
        check_type(setup=(setup, Setup), task=(task, LineTask))
        parts = [element.temperature for element in setup.friction.elements]
        motors, elements, _ = setup.drives.turning.size
        self._count = 2 * elements
        if not any(parts):
            where = "" if setup.friction.file is None else f"{setup.friction.file}: "
            raise ConfigError(f"{where}no friction element has a temperature; accepted: one or more")
        if not (math.isfinite(change) and change > 0.0):
            raise ConfigError(f"the change between cycles is {change} K; accepted: a finite number > 0")
        setup.warn_of_friction()
        self._setup, self._task, self._cycles = setup, task, _Cycles(setup, task)
        self._bound = change * np.repeat([1.0, _WINDING_CHANGE], [2 * elements, motors])
        controller = setup.controller
        known = (
            controller.model.constants.friction if controller.model and controller.feed_forward.friction_model else ()
        )
        parts += [element.temperature for element in known] or [None] * elements
        # J/K, W/K, degrees Celsius; what has no temperature stays at 0.
        self._capacity, self._conductance, self._ambient, start = np.array(
            [(1.0, 0.0, 0.0, 0.0) if one is None else (one.capacity, 1.0 / one.resistance, one.ambient, one.start)
             for one in parts]
        ).T  # fmt: skip
        self._now = np.concatenate([start, np.full(motors, setup.drives.winding.initial)])
        self._slope = np.zeros(self._count)
        self._known: Cycle | None = None
        self._rows: list[tuple[float, Array, Cycle]] = []
        self.done = 0

    def whole_cycles(self, duration: float) -> int:
        """Return how many cycles a time, s, has.

        Raises:
            ConfigError: if it has none, or is not finite.
        """
        if not self._cycles.duration <= duration <= LONGEST:
            raise ConfigError(
                f"the time is {duration:g} s; accepted: from one cycle, {self._cycles.duration:g} s, to {LONGEST:g} s"
            )
        return int(duration / self._cycles.duration + 1e-9)

    def advance(self, total: int) -> bool:
        """Simulate a cycle and go on to where the next one is to be, at most the last; return whether there is one."""
        cycle, duration = self._cycles.run(self._now[: self._count], self._now[self._count :]), self._cycles.duration
        self._rows.append((self.done * duration, self._now, cycle))
        left = total - 1 - self.done
        if left <= 0:
            self.done = total
            return False
        self._learn(cycle)
        rate, end = self._rate_and_end(cycle)
        way = np.abs(end - self._now)
        far, seconds = (way > self._bound) & (rate > 0.0), math.inf  # until a temperature reaches the bound
        if far.any():
            seconds = float(np.min(-np.log1p(-self._bound[far] / way[far]) / rate[far]))
        count = max(1, min(left, int(min(seconds / duration, LONGEST)), total // _MIN_CYCLES))
        if count == 1:
            self._now = np.concatenate([cycle.end, cycle.windings])
        else:
            self._now = end + (self._now - end) * np.exp(-rate * (count * duration))
        self.done += count
        return True

    def result(self) -> RepeatedLine:
        """Return the cycles that were simulated, and warn of joints that got too warm for their law."""
        times, temperatures, cycles = zip(*self._rows, strict=True)
        now = np.array(temperatures)
        e = len(self._setup.friction.names)
        self._setup.warn_of_heat(now[:, :e])
        heat, *values = (np.array([getattr(one, name) for one in cycles]) for name in _CYCLE_FIELDS)
        rows = (np.array(times), now[:, :e], now[:, 2 * e :], heat[:, :e], now[:, e : 2 * e], *values)
        return RepeatedLine(self._setup, self._task, self._cycles.duration, *rows)

    def _learn(self, cycle: Cycle) -> None:
        """Take the slope of the heat over temperature from this cycle and the last one that was far enough from it."""
        known = self._known = self._known or cycle
        risen = cycle.warm - known.warm
        far = np.abs(risen) > _MIN_CHANGE * self._bound[: self._count]
        slope = np.minimum((cycle.heat - known.heat) / np.where(far, risen, 1.0), _MAX_FEEDBACK * self._conductance)
        self._slope = np.where(far, slope, self._slope)
        self._known = known._replace(
            warm=np.where(far, cycle.warm, known.warm), heat=np.where(far, cycle.heat, known.heat)
        )

    def _rate_and_end(self, cycle: Cycle) -> tuple[Array, Array]:
        """Return the rate, 1/s, with which each temperature nears its end, and this end, degrees Celsius.

        That of windings from their time constant, and from how far the cycle brought them.
        """
        loss, end = self._conductance - self._slope, self._now.copy()
        inflow = cycle.heat - self._slope * cycle.warm + self._conductance * self._ambient
        np.divide(inflow, loss, out=end[: self._count], where=loss > 0.0)
        winding = self._setup.drives.winding
        winding_rate = np.zeros(len(winding.resistance))
        if winding.used:
            winding_rate += 1.0 / (winding.heat_capacity * winding.thermal_resistance)
            end[self._count :] -= (cycle.windings - end[self._count :]) / np.expm1(
                -winding_rate * self._cycles.duration
            )
        return np.concatenate([loss / self._capacity, winding_rate]), end


class _Cycles:
    """Simulates cycles from given temperatures.

    Attributes:
        duration: of one, s.
    """

    def __init__(self, setup: Setup, task: LineTask) -> None:
        there = plan_line(setup, task).points
        home = replace(task, start=task.end, end=task.start, start_rpy=task.end_rpy, end_rpy=task.start_rpy)
        back = plan_line(setup, home).points
        rates = setup.rates
        turn = rates.start_tick(float(there.times[-1]))
        ticks = rates.ticks_of(turn * rates.position_period + float(back.times[-1]))
        self._setup, self._task, self._ticks = setup, task, ticks
        self._plant, self._controller = setup.plant(), setup.cs7b()
        self._believed = ModelTemperatures(self._controller.law, self._controller.state)
        self._fast, self._slow = empty_series(ticks, rates.ratio, record_fast=False, arm=setup.drives.turning.size)
        self._start = there.position[0]
        self._plant.reset(self._start)
        self._controller.reset(self._plant.motor_states()[0])
        commands = (MotionCommand(0, there), MotionCommand(turn, back))
        self._setpoints = setpoints_of(self._controller.trajectory, commands, len(self._slow.joint_states))
        self._there, self.duration = turn, ticks * rates.period

    def run(self, joints: Array, windings: Array) -> Cycle:
        """Return what a cycle gives that begins with these temperatures, degrees Celsius, shapes (2 e,) and (n,)."""
        plant, believed = self._plant, self._believed
        plant.reset(self._start)
        plant.temperatures.set(joints[: joints.size // 2])
        plant.state["temperature"] = windings
        self._controller.reset(plant.motor_states()[0])
        believed.set(joints[joints.size // 2 :])
        run_setpoints(plant, self._controller, self._setpoints, self._ticks, self._fast, self._slow)
        end = np.concatenate([plant.temperatures.now, believed.now])
        times = np.arange(self._there, dtype=np.float64) * self._setup.rates.position_period
        accuracy = path_accuracy(self._setup.robot, self._task, times, self._slow.joint_states[: self._there, 0])
        return Cycle(
            0.5 * (joints + end),
            end,
            plant.winding_temperatures(),
            np.concatenate([plant.temperatures.heat, believed.heat]) / self.duration,
            np.abs(self._slow.friction_states[:, 2]).mean(axis=0),
            accuracy.worst,
            accuracy.rms,
        )
