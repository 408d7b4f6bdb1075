"""What `rx90_compare_measured` does, apart from its options: imported once these are understood."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

from rx90_common.description.robot_files import MODEL_FILES, RobotFiles
from rx90_common.process.files import write_text
from rx90_emulator.identification.output.files import check_targets
from rx90_emulator.identification.progress import steps
from rx90_emulator.loop.setup import Setup
from rx90_emulator.measured.compare import compare_measured
from rx90_emulator.measured.comparison import MeasuredComparison
from rx90_emulator.measured.layout import simulated_setup
from rx90_emulator.measured.options import MeasuredLayout, MeasuredTolerances
from rx90_emulator.measured.report import report_page
from rx90_emulator.measured.summary import measured_summary

_STEPS = 3


def write_measured(result: MeasuredComparison, setup: Setup, page: Path | str, *, force: bool = False) -> Path:
    """Write the report of a comparison and return its name.

    Args:
        result: of the comparison.
        setup: that was simulated.
        page: HTML file.
        force: whether a file that exists is replaced.

    Raises:
        IdentificationError: for a file that exists, or whose folder is missing.
        OutputError: for a file that cannot be written.
    """
    page = Path(page)
    check_targets((page,), force=force)
    files = () if setup.files is None else tuple(setup.files.text(role) for role in MODEL_FILES)
    write_text(page, report_page(result, files, datetime.now(timezone.utc)))
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
    """Compare with a progress bar, write the report if it is asked for, print a table, and return the verdict.

    Args:
        bag: as in `compare_measured`, as are layout, tolerances and bandwidth.
        files: of the robot.
        layout: what the bag holds.
        tolerances: what counts as agreement.
        bandwidth: of the set-points, Hz.
        page: report to write; checked before anything long begins.
        force: whether a report that exists is replaced.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    if page is not None:
        check_targets((page,), force=force)
    setup = simulated_setup(files)
    with steps(_STEPS) as step:
        result = compare_measured(bag, setup, layout, tolerances, bandwidth=bandwidth, progress=step)
    print(measured_summary(result))
    if page is not None:
        print(f"report: {write_measured(result, setup, page, force=force)}")
    return result.passed
