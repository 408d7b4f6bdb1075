"""The check of a controller: each case with it and with the CS7B, and the findings as text, JSON and a page."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from bokeh.plotting import figure

from rx90_common.description.robot_files import provenance_of
from rx90_common.report.charts import chart
from rx90_common.report.page import render_page
from rx90_common.report.style import COLOURS
from rx90_emulator.conformance.battery import CASES, Nominal, run_cs7b
from rx90_emulator.conformance.bench import Candidate, run_on_topics
from rx90_emulator.conformance.case import Record
from rx90_emulator.conformance.metrics import TORQUE_OFF
from rx90_emulator.loop.setup import Setup


class Finding(NamedTuple):
    """One value, with the CS7B's and the limit; `joint` is its name, or "tool"."""

    case: str
    quantity: str
    joint: str
    value: float
    cs7b: float
    limit: float
    unit: str

    @property
    def words(self) -> str:
        """Return value and limit in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return (
            f"{self.case}: {self.quantity} of {self.joint} is {self.value:.4g}{unit}; accepted: up to "
            f"{self.limit:.4g}{unit} (CS7B {self.cs7b:.4g})"
        )


@dataclass(frozen=True, eq=False)
class CaseResult:
    """One case: the controller's run, and the CS7B's."""

    record: Record
    cs7b: Record

    @property
    def findings(self) -> list[Finding]:
        """Return what the case measures; of a run that ended early the time without torque alone."""
        case = self.record.case
        found = []
        for metric in case.metrics if self.record.complete else (TORQUE_OFF,):
            values = metric.measure(self.record).tolist()
            joints = case.setup.robot.joint_names if len(values) > 1 else ("tool",)
            for joint, value, cs7b in zip(
                joints, values, metric.measure(self.cs7b).tolist(), strict=True
            ):
                limit = metric.factor * cs7b + metric.allowance
                found.append(
                    Finding(case.name, metric.name, joint, value, cs7b, limit, metric.unit)
                )
        return found


@dataclass(frozen=True, eq=False)
class CheckResult:
    """A check: the controller in words, the nominal arm, and the cases."""

    controller: str
    nominal: Setup
    cases: Sequence[CaseResult]

    @property
    def nearest(self) -> list[Finding]:
        """Return for each case and quantity the joint nearest to its limit, or furthest beyond."""
        rows = [row for case in self.cases for row in case.findings]
        # Of rows with the same case and quantity the dictionary keeps the last, here the nearest to its limit.
        return list(
            {row[:2]: row for row in sorted(rows, key=lambda row: row.value - row.limit)}.values()
        )

    @property
    def deciding(self) -> list[str]:
        """Return what decided: why runs ended early, and for each exceeded limit the joint furthest beyond."""
        faults = [
            f"{case.record.case.name}: {case.record.fault}"
            for case in self.cases
            if case.record.fault
        ]
        return faults + [row.words for row in self.nearest if row.value > row.limit]

    @property
    def text(self) -> str:
        """Return a line for each case and quantity, and the verdict."""
        verdict = f"{self.controller}: {'NOT PASSED' if self.deciding else 'passed'}"
        return "\n".join([*(row.words for row in self.nearest), verdict])

    @property
    def json(self) -> str:
        """Return the result as JSON."""
        rows = [row._asdict() for case in self.cases for row in case.findings]
        return json.dumps(
            {"controller": self.controller, "passed": not self.deciding, "findings": rows}, indent=1
        )

    @property
    def page(self) -> str:
        """Return the report."""
        provenance = provenance_of(self.nominal.files)
        plots = [_errors(case.record, case.cs7b) for case in self.cases]
        return render_page(
            "rx90_emulator.conformance",
            "check.html.j2",
            result=self,
            provenance=provenance,
            plots=plots,
        )


def check_controller(
    candidate: Candidate,
    nominal: Setup,
    names: Sequence[str],
    folder: Path,
    progress: Callable[[int, int], None],
) -> CheckResult:
    """Run cases with a controller and with the CS7B.

    Args:
        candidate: the controller.
        nominal: the arm that it was designed for, and the CS7B for comparison.
        names: of the cases.
        folder: for the controller's logs, and the files of modified arms.
        progress: called with the number of finished cases, and of all.

    Raises:
        ExchangeError: for a controller that does not appear, ends, or does not answer.
    """
    arms = folder / "arms"
    arms.mkdir(parents=True)
    cases = [CASES[name](Nominal(nominal, arms), name) for name in names]
    results: list[CaseResult] = []
    for case in cases:
        progress(len(results), len(cases))
        results.append(CaseResult(run_on_topics(case, candidate, folder), run_cs7b(case, nominal)))
    return CheckResult(
        " ".join(candidate.command) or f"the node {candidate.node}", nominal, results
    )


_MRAD = 1e3


def _errors(record: Record, cs7b: Record) -> list[figure]:
    """Show the error of each joint over the time, with a controller and with the CS7B."""
    figures = []
    for j, name in enumerate(record.case.setup.robot.joint_names):
        shown = chart(name, "time, s", "error, mrad", height=130)
        shown.line(record.times, _MRAD * record.error[:, j], name="controller", color=COLOURS[1])
        shown.line(cs7b.times, _MRAD * cs7b.error[:, j], name="CS7B", color=COLOURS[0])
        figures.append(shown)
    return figures
