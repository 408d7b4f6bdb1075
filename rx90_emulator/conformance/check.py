"""The check of a controller: each case with it and with the CS7B, and the findings as text, JSON and a page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.description.robot_files import provenance_of
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, Curve, Level, Panel, Plot
from rx90_emulator.conformance.battery import Case, Nominal, Record, make_case, run_cs7b, set_points
from rx90_emulator.conformance.bench import Candidate, run_on_topics
from rx90_emulator.conformance.quantities import (
    QUANTITIES,
    CheckLimits,
    Finding,
    judge,
    loops,
    measure,
    tracking_error,
)
from rx90_emulator.loop.setup import Setup

_MRAD = 1e3
_PROGRESS_TICKS = 100


@dataclass(frozen=True, eq=False)
class CaseResult:
    """One case.

    Attributes:
        record: of the controller.
        of_cs7b: of the CS7B.
        set_points: one for each tick of the position loop, shape (m, 3, n).
        findings: all that was measured.
    """

    record: Record
    of_cs7b: Record
    set_points: Array
    findings: tuple[Finding, ...]

    @property
    def case(self) -> Case:
        """Return the case."""
        return self.record.case

    @property
    def nearest(self) -> list[Finding]:
        """Return for each quantity the joint nearest to its limit, or furthest beyond."""
        found: dict[str, Finding] = {}
        for one in self.findings:
            before = found.get(one.quantity)
            if before is None or _share(one) > _share(before):
                found[one.quantity] = one
        return list(found.values())

    @property
    def plot(self) -> Plot:
        """Return the loops of a sweep, else the errors of the joints over the time."""
        runs = ((self.record, "controller", COLOURS[1]), (self.of_cs7b, "CS7B", COLOURS[0]))
        names, panels = [one.joint for one in self.findings if one.quantity == "gain_margin"], []
        if self.case.sines is not None and names:
            open_loops = [(loops(record), label, colour) for record, label, colour in runs]
            for level, y_label in ((0.0, "gain, dB"), (-180.0, "phase, deg")):
                for j, name in enumerate(names):
                    marks = [Curve(own[j].frequency, own[j].bode[y_label], label, colour, dots=True)
                             for own, label, colour in open_loops]  # fmt: skip
                    title, x_label = (name, "") if level == 0.0 else ("", "frequency, Hz")
                    panels.append(Panel([Level(level, "", GREY), *marks], title, x_label, y_label, "log"))
            return Plot(panels, columns=3, height=1.8)
        rows = [slice(None, None, max(1, self.case.setup.rates.ratio // record.ticks)) for record, *_ in runs]
        errors = [_MRAD * tracking_error(record, self.set_points) for record, *_ in runs]
        for j, name in enumerate(self.case.setup.robot.joint_names):
            marks = [Curve(record.times[every], error[every, j], label, colour)
                     for (record, label, colour), error, every in zip(runs, errors, rows, strict=True)]  # fmt: skip
            panels.append(Panel(marks, name, "time, s", "error, mrad"))
        return Plot(panels, columns=3, height=1.8)


def _share(one: Finding) -> float:
    """Return the share of its limit that a value takes, for sorting only."""
    if math.isnan(one.value):
        return -math.inf
    if math.isnan(one.limit):
        return 0.0
    value, limit = (one.limit, one.value) if QUANTITIES[one.quantity].least else (one.value, one.limit)
    return value / limit if limit > 0.0 else math.inf if value > limit else 0.0


@dataclass(frozen=True, eq=False)
class CheckResult:
    """A check.

    Attributes:
        controller: the checked controller, in words.
        nominal: the arm, and the CS7B for comparison.
        limits: of the quantities.
        cases: the results.
    """

    controller: str
    nominal: Setup
    limits: CheckLimits
    cases: tuple[CaseResult, ...]

    @cached_property
    def deciding(self) -> list[Finding]:
        """Return the exceeded limits: for each case and quantity the joint furthest beyond."""
        return [one for result in self.cases for one in result.nearest if not one.passed]

    @property
    def passed(self) -> bool:
        """Return whether all limits are kept."""
        return not self.deciding

    @property
    def text(self) -> str:
        """Return a table: for each case and quantity the joint nearest to its limit."""
        lines = [f"{'case':<14}{'quantity':<21}{'joint':<9}{'value':>11}{'CS7B':>11}{'limit':>11}  unit"]
        for result in self.cases:
            for one in result.nearest:
                numbers = "".join(f"{_number(value):>11}" for value in (one.value, one.of_cs7b, one.limit))
                verdict = "" if one.passed else "  BEYOND"
                unit = QUANTITIES[one.quantity].unit
                lines.append(f"{one.case:<14}{one.quantity:<21}{one.joint:<9}{numbers}  {unit}{verdict}")
            if result.record.fault:
                lines.append(f"{result.case.name:<14}{result.record.fault}")
        beyond = len(self.deciding)
        lines.append(f"{self.controller}: " + ("passed" if self.passed else f"NOT PASSED, {beyond} beyond the limits"))
        return "\n".join(lines)

    @property
    def json(self) -> str:
        """Return the result as JSON; null for missing values."""
        content = {
            "controller": self.controller,
            "passed": self.passed,
            "limits": asdict(self.limits),
            "cases": [
                {
                    "case": result.case.name,
                    "about": result.case.about,
                    "fault": result.record.fault,
                    "findings": [
                        {"quantity": one.quantity, "joint": one.joint, "unit": QUANTITIES[one.quantity].unit,
                         "value": _or_none(one.value), "cs7b": _or_none(one.of_cs7b), "limit": _or_none(one.limit),
                         "passed": one.passed}
                        for one in result.findings
                    ],
                }
                for result in self.cases
            ],
        }  # fmt: skip
        return json.dumps(content, indent=1, allow_nan=False)

    @property
    def page(self) -> str:
        """Return the report."""
        files = self.nominal.files
        return render_page(
            "rx90_emulator.conformance", "check.html.j2", result=self, quantities=QUANTITIES, number=_number,
            provenance={} if files is None else provenance_of(files),
        )  # fmt: skip


def _number(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.4g}"


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def check_controller(
    candidate: Candidate, nominal: Setup, names: Sequence[str], limits: CheckLimits, folder: Path,
    progress: Callable[[int, int], None],
) -> CheckResult:  # fmt: skip
    """Run cases with a controller and with the CS7B.

    Args:
        candidate: the controller.
        nominal: the arm that it was designed for, and the CS7B for comparison.
        names: of the cases.
        limits: of the quantities.
        folder: for the controller's logs, and the files of modified arms.
        progress: called with the number of finished ticks, and their total.

    Raises:
        ExchangeError: for a controller that does not appear, ends, or does not answer.
        ConfigError: for a case that the arm cannot do.
    """
    arms = folder / "arms"
    arms.mkdir(parents=True, exist_ok=True)
    of_cs7b = Nominal(nominal, arms, lambda case: np.asarray(np.nanmax(np.abs(run_cs7b(case, nominal).sent), axis=0)))
    cases = [make_case(name, of_cs7b) for name in names]
    total = sum(case.ticks for case in cases)

    def results() -> Iterator[CaseResult]:
        before = 0
        for case in cases:
            points, other = set_points(case, nominal), run_cs7b(case, nominal)

            def tell(tick: int, before: int = before) -> None:
                if tick % _PROGRESS_TICKS == 0:
                    progress(before + tick, total)

            record = run_on_topics(case, points, candidate, folder, tell)
            values, of_other = (measure(one, points, candidate.at_joints) for one in (record, other))
            found = judge(case, values, of_other, limits)
            yield CaseResult(record, other, points, tuple(found))
            before += case.ticks
            progress(before, total)

    words = " ".join(candidate.command) if candidate.command else f"the node {candidate.node}"
    return CheckResult(words, nominal, limits, tuple(results()))
