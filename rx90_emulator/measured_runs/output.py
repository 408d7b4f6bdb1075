"""Terminal output, page and files of a measured run against the closed loop."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import numpy as np
from bokeh.plotting import figure

from rx90_common.description.robot_files import MODEL_FILES, RobotFiles
from rx90_common.process.files import write_text
from rx90_common.report.charts import chart, over_one_x
from rx90_common.report.page import render_page
from rx90_emulator.identification.job import check_targets, steps
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.identification.output import plots
from rx90_emulator.identification.output.plots import DIFFERENCE, DRAWN_S, compared
from rx90_emulator.identification.output.summary import number, table
from rx90_emulator.identification.validation.verdict import verdict
from rx90_emulator.loop.setup import Setup
from rx90_emulator.measured_runs.compare import (
    MeasuredComparison,
    compare_measured,
    simulated_setup,
)
from rx90_emulator.measured_runs.options import MeasuredTolerances


def measured_facts(result: MeasuredComparison) -> tuple[str, ...]:
    """Return what was simulated and how it was compared, a sentence each."""
    saturated = zip(result.names, result.saturated, strict=True)
    return (
        f"set-points: {result.setpoints}",
        f"torques and positions are compared below {result.bandwidths.torque:.3g} Hz",
        f"the simulated motion is {abs(result.lag) * 1e3:.3f} ms {'later' if result.lag >= 0.0 else 'earlier'}, which "
        "is taken out",
        *(
            f"tip, {what}: {path.words}"
            for what, path in zip(("measured", "simulated"), result.paths, strict=True)
        ),
        *(
            f"{name}'s motor is at its limit in {share:.1%} of the simulated time"
            for name, share in saturated
            if share
        ),
        *result.remarks,
    )


def measured_verdict(result: MeasuredComparison) -> str:
    """Return the verdict, with the decisive values and their limits."""
    return verdict(result.source.path, ("agrees", "DOES NOT AGREE"), *result.criteria)


def measured_summary(result: MeasuredComparison) -> str:
    """Return set-points, filters and lag, a row for each joint, and the verdict."""
    torque = result.torque
    head = ("joint", "torque RMS, Nm", "of measured", "worst, Nm", "of largest", "compared", "position RMS, mrad",
            "worst, mrad")  # fmt: skip
    rows = [
        (
            name,
            number(torque.rms[k]),
            number(torque.rms_share[k], ".2%"),
            number(torque.worst[k]),
            number(torque.worst_share[k], ".2%"),
            f"{result.compared_share[k]:.0%}",
            f"{1e3 * result.position_rms[k]:.3f}",
            f"{1e3 * result.position_worst[k]:.3f}",
        )
        for k, name in enumerate(result.names)
    ]
    return "\n".join([*measured_facts(result), *table(head, rows), measured_verdict(result)])


def measured_page(result: MeasuredComparison, files: tuple[str, ...]) -> str:
    """Return the text of the page on a measured run.

    Args:
        result: of the comparison.
        files: that the robot was read from.
    """
    return render_page(
        "rx90_emulator.measured_runs",
        "measured.html.j2",
        date=datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        facts=measured_facts(result),
        verdict=measured_verdict(result),
        result=result,
        files=files,
        torques=plots.torques(result.torque, result.names, "simulated"),
        positions=_positions(result),
    )


def _positions(result: MeasuredComparison) -> list[figure]:
    """Show measured and simulated positions, each beside their difference."""
    time = result.torque.time - result.torque.time[0]
    rows = slice(0, int(np.searchsorted(time, DRAWN_S, side="right")))
    figures = []
    for k, name in enumerate(result.names):
        measured = result.position[rows, k]
        simulated = result.simulated_position[rows, k]
        positions = chart(name, "", "rad", height=120)
        compared(positions, time[rows], ("measured", measured), ("simulated", simulated))
        difference = chart(name, "", "mrad", height=120)
        difference.line(
            time[rows], 1e3 * (simulated - measured), name="simulated - measured", color=DIFFERENCE
        )
        figures += [positions, difference]
    over_one_x(figures, "time since the comparison began, s", across=2)
    return figures


def write_measured(
    result: MeasuredComparison, setup: Setup, page: Path | str, *, force: bool = False
) -> Path:
    """Write the report of a comparison and return its name.

    Args:
        result: the comparison.
        setup: the arm that was simulated.
        page: HTML file.
        force: whether an existing file is replaced.

    Raises:
        IdentificationError: for a file that exists without `force`, or whose folder is missing.
        OutputError: for a file that cannot be written.
    """
    page = Path(page)
    check_targets(page, force=force)
    files = tuple(setup.files.text(role) for role in MODEL_FILES)
    write_text(page, measured_page(result, files))
    return page


def run_comparison(
    bag: Path,
    files: RobotFiles,
    layout: MeasuredLayout,
    tolerances: MeasuredTolerances,
    bandwidth: float | None = None,
    page: Path | None = None,
    *,
    force: bool = False,
) -> bool:
    """Compare with a progress bar, write the report if requested, print a table, and return the verdict.

    The arguments are those of `compare_measured`, with the files of the robot; the report's place is checked first.
    """
    check_targets(page, force=force)
    setup = simulated_setup(files)
    with steps() as step:
        result = compare_measured(
            bag, setup, layout, tolerances, bandwidth=bandwidth, progress=step
        )
    print(measured_summary(result))
    if page is not None:
        print(f"report: {write_measured(result, setup, page, force=force)}")
    return result.passed
