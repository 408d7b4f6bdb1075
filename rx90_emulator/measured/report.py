"""The report of a comparison: one self-contained HTML page."""

from __future__ import annotations

from datetime import datetime

from rx90_common.report.page import render_page
from rx90_emulator.measured.comparison import MeasuredComparison
from rx90_emulator.measured.plots import position_plot, torque_plot
from rx90_emulator.measured.summary import facts, verdict


def report_page(result: MeasuredComparison, files: tuple[str, ...], date: datetime) -> str:
    """Return the page's text.

    Args:
        result: of the comparison.
        files: that the robot was read from.
        date: of the comparison.
    """
    return render_page(
        "rx90_emulator.measured",
        "measured.html.j2",
        result=result,
        files=files,
        date=date.strftime("%Y-%m-%d %H:%M UTC"),
        facts=facts(result),
        verdict=verdict(result),
        torques=torque_plot(result),
        positions=position_plot(result),
    )
