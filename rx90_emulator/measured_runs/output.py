"""Terminal output, page and files of a measured run against the closed loop."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

from bokeh.plotting import figure

from rx90_common.description.robot_files import MODEL_FILES
from rx90_common.process.files import write_text
from rx90_common.report.charts import stacked
from rx90_common.report.page import render_page
from rx90_emulator.identification.job import check_targets
from rx90_emulator.identification.output import plots
from rx90_emulator.identification.output.plots import DIFFERENCE, DRAWN_S
from rx90_emulator.identification.output.summary import number, table
from rx90_emulator.identification.validation.verdict import verdict
from rx90_emulator.loop.setup import Setup
from rx90_emulator.measured_runs.compare import (
    MeasuredComparison,
)


def measured_facts(result: MeasuredComparison) -> tuple[str, ...]:
    """Return what was simulated and how it was compared, a sentence each."""
    return (
        f"set-points: {result.setpoints}",
        f"torques and positions are compared below {result.bandwidths.torque:.3g} Hz",
        f"the simulated motion is {abs(result.lag) * 1e3:.3f} ms {'later' if result.lag >= 0.0 else 'earlier'}, which "
        "is taken out",
        *result.remarks,
    )


def measured_verdict(result: MeasuredComparison) -> str:
    """Return the verdict, with the decisive values and their limits."""
    return verdict(result.source.path, ("agrees", "DOES NOT AGREE"), result.criteria)


def measured_summary(result: MeasuredComparison) -> str:
    """Return set-points, filters and lag, a row for each joint, and the verdict."""
    torque = result.torque
    head = ("joint", "torque RMS, Nm", "of measured", "worst, Nm", "of largest", "position RMS, mrad",
            "worst, mrad")  # fmt: skip
    rows = [
        (
            name,
            number(torque.rms[k]),
            number(torque.rms_share[k], ".2%"),
            number(torque.worst[k]),
            number(torque.worst_share[k], ".2%"),
            f"{1e3 * result.position_rms[k]:.3f}",
            f"{1e3 * result.position_worst[k]:.3f}",
        )
        for k, name in enumerate(result.names)
    ]
    return "\n".join([*measured_facts(result), *table(head, rows), measured_verdict(result)])


def _position_differences(result: MeasuredComparison) -> list[figure]:
    """Show how far the simulated positions are from the measured ones in the first minute."""
    time = result.torque.time - result.torque.time[0]
    rows = time <= DRAWN_S
    difference = (1e3 * result.position_difference[rows], {"color": DIFFERENCE})
    labels = ("time since the comparison began, s", "mrad")
    return stacked(result.names, labels, time[rows], {"simulated - measured": difference}, across=2)


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
    text = render_page(
        "rx90_emulator.measured_runs",
        "measured.html.j2",
        date=datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC"),
        facts=measured_facts(result),
        verdict=measured_verdict(result),
        result=result,
        files=[setup.files.text(role) for role in MODEL_FILES],
        torques=plots.torques(result.torque, result.names, "simulated"),
        positions=_position_differences(result),
    )
    write_text(page, text)
    return page
