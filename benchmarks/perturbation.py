"""Speed and error of the perturbation method beside the full closed loop, and where it stops being valid.

    python -m benchmarks.perturbation [--plot FILE]

Speed: a prepared model against `simulate`, CPU times of one thread, taking turns; every run of a batch has another
friction. Error: the tip's distance from the path and from the nominal motion, on the reference line and on the same
line at 300 mm/s. Validity: line speed by friction, with five controllers.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.hybrid_reference import Work
from benchmarks.report import PLOT, arguments, in_turns, merge, print_table, print_times, ratios, timed
from rx90_common.base.arrays import Array
from rx90_common.description.kinematics import forward
from rx90_common.friction import FrictionSet
from rx90_common.report.picture import write_picture
from rx90_common.report.plot import COLOURS, Curve, Dots, Level, Mark, Panel, Plot
from rx90_controller.law.parameters import CS7BParameters, FeedForward
from rx90_controller.lines.task import LineTask, load_task
from rx90_emulator.loop.line import path_accuracy
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup
from rx90_emulator.perturbation.model import PerturbationModel, PerturbationResult, prepare_perturbation


class Agreement(NamedTuple):
    """Distances of the tip from the nominal motion, m, and how far they differ.

    Attributes:
        worst: largest distance, full simulation and perturbation method.
        rms: root mean square distance, likewise.
        difference: largest distance between the two tips at the same time.
    """

    worst: tuple[float, float]
    rms: tuple[float, float]
    difference: float

    @property
    def relative_worst(self) -> float:
        """Return by which share the largest distances differ."""
        return abs(self.worst[1] / self.worst[0] - 1.0)

    @property
    def relative_rms(self) -> float:
        """Return by which share the root mean square distances differ."""
        return abs(self.rms[1] / self.rms[0] - 1.0)

    @property
    def relative_difference(self) -> float:
        """Return the largest distance between the tips, as a share of the largest distance from the motion."""
        return self.difference / self.worst[0]


def agreement(
    full: RunResult, result: PerturbationResult, run: int = 0, begin: float = 0.0, end: float = np.inf
) -> Agreement:
    """Compare a run with the full simulation from `begin` to `end`, s."""
    model = result.model
    window = (model.times >= begin) & (model.times <= end)
    tip = forward(model.setup.robot.chain, full.slow.joint_states[window, 0]).position - model.nominal_tip[window]
    ours = result.tip_deviation[run][window]
    distances = [np.linalg.norm(deviation, axis=1) for deviation in (tip, ours)]
    worst, rms = ([float(norm(d)) for d in distances] for norm in (np.max, _root_mean_square))
    return Agreement((worst[0], worst[1]), (rms[0], rms[1]), float(np.linalg.norm(tip - ours, axis=1).max()))


def _root_mean_square(distance: Array) -> float:
    return float(np.sqrt(np.mean(distance**2)))


ROUNDS = 9
BATCH = 64
ACCEPTED_SPEEDUP, ACCEPTED_ERROR = 5.0, 0.05
SPEEDS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
SCALES = (0.5, 1.0, 2.0, 3.0)
SPACINGS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)
RAMP = 0.1
"""How long a line of the validity table takes to reach its speed, s."""


def prepare(work: Work, spacing: float = 0.01) -> PerturbationModel:
    """Prepare the perturbation model of a line."""
    return prepare_perturbation(work.setup, work.points, work.start, work.duration, spacing=spacing)


def scaled(friction: FrictionSet, scale: float) -> FrictionSet:
    """Return a friction set with all torques scaled; deflections and velocities stay."""
    names = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c0", "c1", "c2")
    elements = tuple(
        dataclasses.replace(element, **{name: scale * getattr(element, name) for name in names})
        for element in friction.elements
    )
    return FrictionSet(friction.names, elements)


def unlimited(shipped: CS7BParameters) -> CS7BParameters:
    """Return the controller without the limits that would refuse a fast ramp, or cut the power of a soft servo."""
    far = np.full(6, 10.0)
    return dataclasses.replace(shipped, following_error=far, over_speed=10.0, max_acceleration=100.0 * far)


def controllers(shipped: CS7BParameters) -> dict[str, CS7BParameters]:
    """Return the controllers of the validity table."""
    blind = dataclasses.replace(shipped, feed_forward=FeedForward.off())
    weak = dataclasses.replace(blind, kp=0.3 * shipped.kp, kv=0.3 * shipped.kv, ki=0.1 * shipped.ki)
    soft, softer = (
        dataclasses.replace(blind, kp=share * shipped.kp, kv=share * shipped.kv, ki=0.0 * shipped.ki)
        for share in (0.2, 0.06)
    )
    return {
        "as shipped": shipped,
        "FF and dq_r off": blind,
        "FF and dq_r off, weak gains": weak,
        "FF and dq_r off, no integral, soft gains": soft,
        "FF and dq_r off, no integral, softer gains": softer,
    }


def speed(work: Work, rounds: int = ROUNDS) -> dict[str, list[float]]:
    """Return the times per tick and run of all rounds, s."""
    model = prepare(work)
    scales = np.linspace(0.8, 1.2, BATCH).tolist()
    frictions = [scaled(work.setup.friction, scale) for scale in scales]
    ticks = work.duration * work.setup.rates.base_hz
    runs = {
        "full closed loop": timed(work.run, ticks),
        "perturbation, one run": timed(lambda: model.run(frictions[:1]), ticks),
        f"perturbation, batch of {BATCH}": timed(lambda: model.run(frictions), ticks * BATCH),
        "perturbation, preparation": timed(lambda: prepare(work), ticks),
    }
    return in_turns(runs, rounds)


class PathError(NamedTuple):
    """Worst and RMS distance of the tip from the line, m: full simulation and perturbation method."""

    worst: tuple[float, float]
    rms: tuple[float, float]

    @property
    def relative(self) -> float:
        """Return the larger of the two relative differences."""
        return max(abs(pair[1] / pair[0] - 1.0) for pair in self)


def line_error(work: Work) -> tuple[PathError, Agreement]:
    """Compare both methods on a line."""
    full, result = work.run(), prepare(work).run_one()
    chain, task = work.setup.robot, work.task
    ours, theirs = (
        path_accuracy(chain, task, full.times, position)
        for position in (result.joint_position(0), full.slow.joint_states[:, 0])
    )
    error = PathError((theirs.worst, ours.worst), (theirs.rms, ours.rms))
    return error, agreement(full, result, 0, *work.task.counted)


class Case(NamedTuple):
    """One cell of the validity table."""

    controller: str
    scale: float
    speed: float
    agreement: Agreement
    diverged: bool


def at_speed(task: LineTask, line_speed: float) -> LineTask:
    """Return the line at a speed, m/s, reached in RAMP."""
    return dataclasses.replace(task, speed=line_speed, acceleration=line_speed / RAMP)


def validity(setup: Setup, task: LineTask) -> list[Case]:
    """Compare both methods over speed, friction and controller."""
    cases = []
    for line_speed in SPEEDS:
        work = Work.plan(setup, at_speed(task, line_speed))
        model = prepare(work)
        grid = [(name, c, scale) for name, c in controllers(setup.controller).items() for scale in SCALES]
        frictions = [scaled(setup.friction, scale) for *_, scale in grid]
        result = model.run(frictions, [controller for _, controller, _ in grid])
        for run, (name, controller, scale) in enumerate(grid):
            full = work.run(dataclasses.replace(setup, friction=frictions[run], controller=controller))
            compared = agreement(full, result, run, *work.task.counted)
            cases.append(Case(name, scale, line_speed, compared, bool(result.diverged[run])))
    return cases


def print_validity(cases: list[Case]) -> None:
    """Print how far the methods disagree, one table for each controller."""
    for name in dict.fromkeys(case.controller for case in cases):
        print(f"\n{name}: largest tip deviation, um; disagreement about largest and RMS, and tips apart, %")
        rows = []
        for line_speed in SPEEDS:
            row = [f"{line_speed * 1e3:.0f} mm/s"]
            for case in cases:
                if case.controller == name and case.speed == line_speed:
                    a = case.agreement
                    row += [
                        f"{a.worst[0] * 1e6:.0f}",
                        f"{max(a.relative_worst, a.relative_rms) * 100:.2f}",
                        f"{a.relative_difference * 100:.2f}",
                    ]
            rows.append(row)
        headers = ["line"]
        for scale in SCALES:
            headers += [f"friction x {scale:g}", "%", "tips %"]
        print_table(headers, rows)


def plot(cases: list[Case], spacing: list[tuple[float, float]], file: Path) -> None:
    """Draw the disagreement over speed, over the size of the deviation, and over the spacing of the coarse points."""
    names = list(dict.fromkeys(case.controller for case in cases))
    accepted = Level(ACCEPTED_ERROR * 100, "accepted")
    over_speed: list[Mark] = [accepted]
    for scale, colour in zip(SCALES, COLOURS, strict=False):
        line = [c for c in cases if c.controller == names[0] and c.scale == scale]
        apart = np.array([c.agreement.relative_difference * 100 for c in line])
        speeds = np.array([c.speed * 1e3 for c in line])
        over_speed.append(Curve(speeds, apart, f"friction x {scale:g}", colour, dots=True))
    over_size: list[Mark] = [accepted]
    for name, colour in zip(names, COLOURS, strict=False):
        line = [c for c in cases if c.controller == name]
        apart = np.array([c.agreement.relative_difference * 100 for c in line])
        over_size.append(Dots(np.array([c.agreement.worst[0] * 1e3 for c in line]), apart, name, colour))
    coarse = np.array(spacing)
    over_spacing = Curve(coarse[:, 0] * 1e3, coarse[:, 1] * 1e6, dots=True)
    panels = [
        Panel(over_speed, "Controller as shipped", "line speed, mm/s", "tips apart, % of deviation", "log", "log"),
        Panel(over_size, "All speeds, frictions and controllers", "largest deviation of the tip, mm", "tips apart, %",
              "log", "log"),
        Panel([over_spacing], f"As shipped, {SPEEDS[-1] * 1e3:.0f} mm/s", "from coarse point to coarse point, ms",
              "tips apart, µm", "log", from_zero=True),
    ]  # fmt: skip
    write_picture(Plot(panels, height=3.2), file)


def spacings(work: Work) -> list[tuple[float, float]]:
    """Return (spacing in s, largest distance of the tips in m) of one line."""
    full = work.run()
    return [(s, agreement(full, prepare(work, s).run_one(), 0, *work.task.counted).difference) for s in SPACINGS]


def main() -> int:
    """Measure, print the tables, merge the figures and draw the plot if asked for."""
    options = arguments(__doc__, PLOT)
    setup = Setup.load()
    task = load_task()
    works = [Work.plan(setup, task), Work.plan(setup, dataclasses.replace(task, speed=0.3))]
    times = speed(works[0])
    print_times("perturbation method, per run", times, "full closed loop", setup.rates.period)
    speedup = {name: 1.0 / ratio for name, ratio in ratios(times, "full closed loop").items()}
    errors = [line_error(work) for work in works]
    print()
    print_table(
        (
            "tip, um: full / perturbation",
            "path worst",
            "path RMS",
            "deviation worst",
            "RMS",
            "tips apart",
            "relative %",
        ),
        [
            (
                f"{work.task.speed * 1e3:.0f} mm/s",
                *(f"{a * 1e6:.2f} / {b * 1e6:.2f}" for a, b in (*line, *deviation[:2])),
                f"{deviation.difference * 1e6:.2f}",
                f"{_relative(line, deviation) * 100:.2f}",
            )
            for work, (line, deviation) in zip(works, errors, strict=True)
        ],
    )
    relative = max(_relative(*pair) for pair in errors)
    print(f"accepted: at least {ACCEPTED_SPEEDUP:g} x the full closed loop, relative at most {ACCEPTED_ERROR:.0%}")
    free = dataclasses.replace(setup, controller=unlimited(setup.controller))
    cases = validity(free, task)
    print_validity(cases)
    if options.plot:
        fastest = Work.plan(free, at_speed(task, SPEEDS[-1]))
        plot(cases, spacings(fastest), options.plot)
    merge(
        {
            "perturbation_speedup": speedup[f"perturbation, batch of {BATCH}"],
            "perturbation_one_run_speedup": speedup["perturbation, one run"],
            "perturbation_preparation_speedup": speedup["perturbation, preparation"],
            "perturbation_tip_error_relative": relative,
        }
    )
    return 0


def _relative(line: PathError, deviation: Agreement) -> float:
    return max(line.relative, deviation.relative_worst, deviation.relative_rms)


if __name__ == "__main__":
    sys.exit(main())
