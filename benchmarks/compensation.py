"""What feed-forward by a model of arm and friction gains on the reference task, right and wrong, and what is left.

    python -m benchmarks.compensation [--plot FILE]

The plant keeps its parameters; the controller's model is right or wrong by what the conditions say. For the CS7B's own
feed-forward they concern its Coulomb and viscous values. Cold and hot are made by the temperature part of the plant's
friction: as warm as the room, and as warm as hours of work make it; the model has that part, or has the friction at the
reference temperature. The numbers are exact: the closed loop gives the same bits on each run. Speed is in CPU time, in
turns.

Bristles that follow the measured velocity instead of that of the set-points, the observer of Canudas de Wit, Olsson,
Astrom and Lischinsky (1995) with the exact bristle step every base tick, are measured beside them. The controller has
none of it; this is the evidence why:

    dz/dt = v - |v| / g(v) z + k e        v: measured velocity, e: position error, set-point minus measured
"""

from __future__ import annotations

import dataclasses
import statistics
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.report import PLOT, WIDTH, arguments, in_turns, merge, print_table, timed
from rx90_common.base.arrays import Array, Record
from rx90_common.base.config import read_yaml, yaml_text
from rx90_common.base.rates import Rates
from rx90_common.description.coupling import to_joint, to_motor_torque
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.arm_elements import add_to_joints, element_inputs
from rx90_common.friction.bristle import bristle_step
from rx90_common.friction.compiled_elements import element_arrays, load_elements
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.lanes import load, store
from rx90_common.report.picture import picture
from rx90_common.report.style import COLOURS, INK
from rx90_controller.law.cs7b import position_loop, velocity_loop
from rx90_controller.law.model import ModelFiles
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.line import LineRun, PathAccuracy, path_accuracy, plan_line, run_line
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant_step import plant_step

WORKSPACE = np.dtype(
    [
        ("z", np.float64, 7),
        ("velocity", np.float64, 6),
        ("error", np.float64, 6),
        ("joint", np.float64, 6),
        ("motor", np.float64, 6),
        ("held", np.float64, 6),
    ]
)


def scaled(friction: FrictionSet, scale: float) -> FrictionSet:
    """Return a friction set with all torques scaled; deflections and velocities stay."""
    names = (
        "tau_c_positive",
        "tau_c_negative",
        "tau_s_positive",
        "tau_s_negative",
        "c0",
        "c1",
        "c2",
    )
    elements = tuple(
        element.with_parameters({name: scale * element.parameters[name] for name in names})
        for element in friction.elements
    )
    return FrictionSet(friction.names, elements)


def run_measured(setup: Setup, task: LineTask, gain: float) -> tuple[PathAccuracy, Array]:
    """Run a line with the friction of the setup's model fed forward by measured velocities.

    Args:
        setup: its controller has `inverse_dynamics` on and the other parts for friction off.
        task: the line.
        gain: k, 1/s.

    Returns:
        The path error, and the joint positions, rad, shape (m, 6).
    """
    plan = plan_line(setup, task)
    plant, controller = setup.plant(), setup.cs7b()
    plant.reset(plan.start_pose)
    controller.reset(plant.motor_states()[0])
    controller.trajectory.accept(plan.points, 0, 0)
    rates = setup.rates
    count = rates.ticks_of(plan.duration) // rates.ratio
    setpoints, position = controller.trajectory.setpoints(0, count), np.empty((count, 6))
    model = setup.controller.model
    assert model is not None
    work = np.zeros(1, WORKSPACE)
    arguments = (
        plant.constants,
        plant.state,
        controller.law,
        controller.state,
        element_arrays(model.constants.friction),
        work,
    )
    _run(*arguments, setpoints, rates.ratio, gain, rates.period, position)
    times = np.arange(count) * rates.position_period
    return path_accuracy(setup.robot, task, times, position), position


@kernel
def _run(
    plants: Record,
    plant_states: Record,
    laws: Record,
    law_states: Record,
    elements: Record,
    work: Record,
    setpoints: Array,
    ratio: int,
    gain: float,
    period: float,
    position: Array,
) -> None:
    plant, law, own = plant_states[0], law_states[0], work[0]
    gear = laws[0].gear
    for k in range(len(setpoints) * ratio):
        row = k // ratio
        if k % ratio == 0:
            position[row] = plant.q
            position_loop(
                laws, law_states, setpoints[row], plant.motor_position, plant.motor_velocity
            )
            to_joint(gear, law.error, own.error)
            own.held[:] = law.feed_forward
        to_joint(gear, plant.motor_velocity, own.velocity)
        _add_friction(elements[0], own, gear, gain, period)
        for i in range(6):
            law.feed_forward[i] = own.held[i] + own.motor[i]
        velocity_loop(laws, law_states, plant.motor_velocity)
        plant_step(plants, plant_states, law.command, True)


@kernel
def _add_friction(elements: Any, own: Any, gear: Array, gain: float, period: float) -> None:
    z, torque = bristle_step(
        load_elements(elements, 7), load(own.z, 7), element_inputs(own.velocity), period
    )
    store(own.z, z + gain * period * element_inputs(own.error))
    own.joint[:] = 0.0
    add_to_joints(own.joint, torque)
    to_motor_torque(gear, own.joint, own.motor)


LAWS = {
    "CS7B's own": {},
    "+ inverse dynamics": {"inverse_dynamics": True},
    "+ friction model": {"friction_model": True},
    "both": {"inverse_dynamics": True, "friction_model": True},
}
OWN, BOTH = "CS7B's own", "both"
RIGHT = "right model"
OFF = {"friction 30 % too low": 0.7, "friction 30 % too high": 1.3}
LIGHT = "tool half as heavy"
COLD, HOT = "cold arm", "hot arm"
COLD_HALL, HOT_HALL = 10.0, 40.0  # degrees Celsius
KNOWN = ", temperature in the model"
WARMTH = TemperaturePart(
    # Forms, scale and floor are those of Bittencourt and Gunnarsson (2012) at 40 degrees (docs/explanation/
    # friction_curves.md). All else is assumed; their slopes, 0.04 and 0.07 1/K, hold for a warm gear alone.
    reference=30.0, lowest=5.0, highest=95.0, start=COLD_HALL, ambient=COLD_HALL, capacity=9000.0, resistance=0.6,
    viscous_scale=20.7, viscous_floor=0.4, speed_slope=0.02, static_slope=0.02,
)  # fmt: skip
RESISTANCES = (0.6, 0.6, 0.6, 2.5, 4.0, 8.0, 6.0)  # K/W of the seven elements; assumed
TIME_CONSTANT = 5400.0  # capacity times resistance, s; assumed
HOT_JOINTS = (51.57, 42.78, 42.38, 40.0, 42.6, 50.58, 44.55)
"""Temperatures after four hours of the line there and back at 0.6 m/s and 4 m/s^2 in the hot hall, degrees Celsius."""
GAINS = (0.0, 30.0)  # of the bristles that follow the measured velocity, 1/s
ROUNDS = 15
SETTLED = 300  # position ticks
TARGET = 0.03  # mm
_STIFF = 400.0  # times as stiff: bristles without presliding to speak of

_BUDGET: dict[str, dict[str, float]] = {
    "as shipped": {},
    "encoders of 24 bits": {"drives.encoder_counts": 2.0**24},
    "current loop that follows at once": {"controller.current_bandwidth": 1e5},
    "velocity measured by 1900 Hz instead of 400": {"drives.velocity_bandwidth": 1900.0},
}
_ALL = {path: value for changes in _BUDGET.values() for path, value in changes.items()}


class Outcome(NamedTuple):
    """What a run leaves: path error m, largest joint error rad, what PI and D give, by the peak torque."""

    worst: float
    rms: float
    joint: float
    feedback: float

    @classmethod
    def of(cls, run: LineRun) -> Outcome:
        """Return it of a run, from the line's beginning until it has settled at its end."""
        path, rates = run.path_accuracy, run.setup.rates
        rows = np.rint(path.times / rates.position_period).astype(int)
        drives = run.setup.drives
        left = run.slow.tracking_error[rows, 2] - run.slow.reference[rows, 2]
        share = np.sqrt(np.mean(left**2, axis=0)) / (drives.peak_torque * np.abs(drives.gear))
        error = run.slow.reference[rows, 0] - run.slow.joint_states[rows, 0]
        return cls(path.worst, path.rms, float(np.abs(error).max()), float(share.max()))


class Models:
    """Setups whose controllers have models that are wrong in a way of their own; files in a folder."""

    def __init__(self, setup: Setup, folder: Path) -> None:
        self._setup, self._folder = setup, folder
        assert setup.controller.model is not None
        self._files = setup.controller.model

    def all(self) -> dict[str, Setup]:
        """Return a setup for each condition."""
        return {
            RIGHT: self._setup,
            **{name: self._friction(factor) for name, factor in OFF.items()},
            LIGHT: self._with(self._files.replaced(tool=self._tool(0.5))),
        }

    def _with(self, files: ModelFiles) -> Setup:
        return dataclasses.replace(
            self._setup, controller=self._setup.controller.replaced(model=files)
        )

    def _friction(self, factor: float) -> Setup:
        """Return the setup with a controller that knows all friction by a factor wrong."""
        path = self._folder / f"friction_{factor}.yaml"
        elements = dict(
            zip(
                self._setup.friction.names,
                scaled(self._setup.friction, factor).elements,
                strict=True,
            )
        )
        path.write_text(FrictionFile.of(elements).text(), encoding="utf-8")
        setup = self._with(self._files.replaced(friction=path))
        own = setup.controller
        wrong = own.replaced(
            feed_forward={
                "coulomb_torque": factor * own.coulomb,
                "viscous_friction": factor * own.viscous,
            }
        )
        return dataclasses.replace(setup, controller=wrong)

    def _tool(self, factor: float) -> Path:
        """Return a tool file with other mass and inertia."""
        file = self._files.path("tool")
        assert file is not None
        content = read_yaml(file)
        inertial = content["inertial"]
        inertial["mass"] *= factor
        inertial["inertia"] = [factor * value for value in inertial["inertia"]]
        path = self._folder / f"tool_{factor}.yaml"
        path.write_text(yaml_text(content), encoding="utf-8")
        return path

    def at(self, hall: float, arm: Array, believed: Array | None) -> Setup:
        """Return the setup in surroundings of a temperature, degrees Celsius, with joints that begin at others, (7,).

        The model's begin at those that it believes; None for a model without temperatures.
        """
        warm = dataclasses.replace(
            self._setup.friction, elements=_warm(self._setup.friction, hall, arm)
        )
        there = dataclasses.replace(self._setup, friction=warm)
        if believed is None:
            return there
        path = self._folder / f"friction_{hall:g}_{believed.sum():.6f}.yaml"
        known = dict(zip(warm.names, _warm(warm, hall, believed), strict=True))
        path.write_text(FrictionFile.of(known).text(), encoding="utf-8")
        model = self._files.replaced(friction=path)
        return dataclasses.replace(there, controller=there.controller.replaced(model=model))


def _warm(friction: FrictionSet, hall: float, start: Array) -> tuple[FrictionElement, ...]:
    """Return elements that begin at temperatures, degrees Celsius, shape (7,)."""
    return tuple(
        element.replaced(
            temperature=WARMTH.replaced(
                start=float(begin),
                ambient=hall,
                resistance=resistance,
                capacity=TIME_CONSTANT / resistance,
            )
        )
        for element, begin, resistance in zip(friction.elements, start, RESISTANCES, strict=True)
    )


def with_law(setup: Setup, switches: Mapping[str, bool]) -> Setup:
    """Return the setup with these parts of the feed-forward on."""
    return dataclasses.replace(
        setup, controller=setup.controller.replaced(feed_forward=dict(switches))
    )


def print_conditions(runs: Mapping[str, Mapping[str, LineRun]]) -> None:
    """Print a table for each quantity: conditions down, laws across."""
    found = {
        condition: [Outcome.of(run) for run in laws.values()] for condition, laws in runs.items()
    }

    def table(title: str, cell: Callable[[Outcome], str]) -> None:
        print_table(
            (title, *LAWS), [(name, *map(cell, outcomes)) for name, outcomes in found.items()]
        )
        print()

    table("path error, worst (RMS), mm", lambda one: f"{one.worst * 1e3:.4f} ({one.rms * 1e3:.4f})")
    table("joint error, worst joint, µrad", lambda one: f"{one.joint * 1e6:.0f}")
    table("torque of PI and D, % of peak", lambda one: f"{one.feedback * 100:.1f}")
    print("the last: RMS along the line, of the joint that has most of it\n")


def budget(setup: Setup, task: LineTask) -> list[tuple[str, float, float]]:
    """Return (what is ideal, worst, RMS path error in m) with the right model."""
    both = with_law(setup, LAWS[BOTH])
    found = []
    for name, changes in {**_BUDGET, "all three": _ALL}.items():
        path = run_line(with_parameters(both, changes), task).path_accuracy
        found.append((name, path.worst, path.rms))
    faster = dataclasses.replace(with_parameters(both, _ALL), rates=Rates(16000, 4000))
    path = run_line(faster, task).path_accuracy
    return [*found, ("all three, rates fourfold", path.worst, path.rms)]


def own_budget(setup: Setup, task: LineTask) -> list[tuple[str, float, float]]:
    """Return the same of the CS7B's own feed-forward, as one after the other of what it does not know is taken away."""
    known = with_law(setup, LAWS["+ inverse dynamics"])
    # A ramp that is over within rounding of zero: the sign function as written.
    plain = with_parameters(known, {"controller.coulomb_velocity": 1e-12})
    coulomb = tuple(
        e.replaced(
            tau_s={"positive": e.tau_c.positive, "negative": e.tau_c.negative}, c0=_STIFF * e.c0
        )
        for e in setup.friction.elements
    )
    without = with_parameters(plain, {"controller.coulomb[5]": 0.0, "controller.viscous[5]": 0.0})
    none = dict.fromkeys(
        ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative"), 1e-9
    )
    wrist = tuple(
        element.with_parameters({**none, "c1": 0.0, "c2": 0.0}) for element in coulomb[5:]
    )

    def of(controlled: Setup, elements: tuple[FrictionElement, ...]) -> Setup:
        return dataclasses.replace(
            controlled, friction=dataclasses.replace(setup.friction, elements=elements)
        )

    cases = {
        "as shipped": setup,
        "inverse dynamics": known,
        "and Coulomb and viscous friction alone": of(plain, coulomb),
        "and none in joint 6 and joints 5+6": of(without, (*coulomb[:5], *wrist)),
    }
    paths = {name: run_line(one, task).path_accuracy for name, one in cases.items()}
    return [(name, path.worst, path.rms) for name, path in paths.items()]


def print_budget(title: str, found: Sequence[tuple[str, float, float]]) -> None:
    """Print what is left."""
    print_table(
        (title, "worst, µm", "RMS, µm"),
        [(n, f"{w * 1e6:.2f}", f"{r * 1e6:.3f}") for n, w, r in found],
    )
    print()


def print_measured(setups: Mapping[str, Setup], task: LineTask) -> None:
    """Print what bristles that follow the measured velocity would do, beside those of the product."""
    rows = []
    rest = dataclasses.replace(task, rest_after=2.0)
    blind = {"coulomb": False, "viscous": False, "inverse_dynamics": True}
    for name in (RIGHT, *OFF):
        run = run_line(with_law(setups[name], LAWS[BOTH]), rest)
        cases = [("set-points", run.path_accuracy.worst, run.slow.joint_states[-SETTLED:, 0])]
        for gain in GAINS:
            path, position = run_measured(with_law(setups[name], blind), rest, gain)
            cases.append((f"measured, k = {gain:g}/s", path.worst, position[-SETTLED:]))
        for kind, worst, settled in cases:
            swing = float(np.ptp(settled, axis=0).max())
            rows.append((f"{name}, {kind}", f"{worst * 1e3:.4f}", f"{swing * 1e6:.1f}"))
    print_table(("the model, its bristles follow", "worst, mm", "swing at rest, µrad"), rows)
    print()


def speed(setup: Setup, task: LineTask) -> dict[str, float]:
    """Return how many times faster than real time the closed loop is, without and with both parts."""
    setups = {
        "feed-forward as shipped": setup,
        "both parts of the model": with_law(setup, LAWS[BOTH]),
    }
    plan = plan_line(setup, task)
    runs = {
        name: timed(lambda one=one: simulate(one, plan.points, plan.start_pose, plan.duration))  # type: ignore[misc]
        for name, one in setups.items()
    }
    return {
        name: plan.duration / statistics.median(times)
        for name, times in in_turns(runs, ROUNDS).items()
    }


def draw(runs: Mapping[str, Mapping[str, LineRun]], file: Path) -> None:
    """Draw the path error along the line for the right model and those that are off."""
    shown = {RIGHT: list(LAWS), **{name: [OWN, BOTH] for name in (*OFF, COLD, HOT)}}
    with picture(file) as figure:
        figure.set_size_inches(WIDTH, 2.3 * len(shown))
        panels = figure.subplots(len(shown))
        for panel, (condition, laws) in zip(panels, shown.items(), strict=True):
            panel.axhline(TARGET, color=INK, linewidth=0.7, linestyle="dotted", label="0.03 mm")
            for law in laws:
                path = runs[condition][law].path_accuracy
                colour = COLOURS[list(LAWS).index(law)]
                panel.plot(path.along * 1e3, path.perpendicular * 1e3, color=colour, label=law)
            if condition in (COLD, HOT):
                path = runs[condition + KNOWN][BOTH].path_accuracy
                name = BOTH + KNOWN
                panel.plot(
                    path.along * 1e3, path.perpendicular * 1e3, color=COLOURS[len(LAWS)], label=name
                )
            panel.set(title=condition.capitalize(), ylabel="path error, mm", ylim=(0.0, None))
            panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=5)
        panels[-1].set_xlabel("along the line, mm")


def main() -> int:
    """Run all of it, print the tables, merge the figures and draw the plot if asked for."""
    options = arguments(__doc__, PLOT)
    setup, task = Setup.load(), load_task()
    with tempfile.TemporaryDirectory() as folder:
        models = Models(setup, Path(folder))
        cold = np.full(7, COLD_HALL)
        hot = np.array(HOT_JOINTS)
        setups = models.all() | {
            COLD: models.at(COLD_HALL, cold, None),
            COLD + KNOWN: models.at(COLD_HALL, cold, cold),
            HOT: models.at(HOT_HALL, hot, None),
            HOT + KNOWN: models.at(HOT_HALL, hot, hot),
        }
        runs = {
            name: {law: run_line(with_law(one, switches), task) for law, switches in LAWS.items()}
            for name, one in setups.items()
        }
        print_conditions(runs)
        print_budget("both of the right model, what is left", budget(setup, task))
        print_budget("CS7B's own, what is left", own_budget(setup, task))
        print_measured(setups, task)
    faster = speed(setup, task)
    print_table(
        ("closed loop, one core", "x real time"),
        [(name, f"{value:.0f}") for name, value in faster.items()],
    )
    if options.plot is not None:
        draw(runs, options.plot)
    merge(
        {
            "path_error_model_cold_mm": runs[COLD][BOTH].path_accuracy.worst * 1e3,
            "path_error_model_cold_known_mm": runs[COLD + KNOWN][BOTH].path_accuracy.worst * 1e3,
            "path_error_model_hot_mm": runs[HOT][BOTH].path_accuracy.worst * 1e3,
            "path_error_model_hot_known_mm": runs[HOT + KNOWN][BOTH].path_accuracy.worst * 1e3,
        }
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
