"""What `rx90 identify` and `rx90 identify compare` do once their options have been checked: slow to import."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from tqdm import tqdm

from rx90_common.base.errors import IdentificationError, check_place, check_replaced, write_error
from rx90_common.base.share import versions
from rx90_common.description.robot import load_robot
from rx90_common.description.robot_files import FILES, MODEL_FILES, RobotFiles
from rx90_common.process.files import write_all, write_text
from rx90_controller.law.parameters import load_controller
from rx90_emulator.identification.excitation import identify_excitation
from rx90_emulator.identification.experiments.plan import IdentificationBags, read_index
from rx90_emulator.identification.identify import FrictionIdentification, check_friction, identify_friction
from rx90_emulator.identification.options import (
    ExcitationTolerances,
    GivenTolerances,
    MeasuredLayout,
    MeasuredTolerances,
    RobotOptions,
)
from rx90_emulator.identification.output.assumed_files import weight_warning
from rx90_emulator.identification.output.friction_file import friction_text
from rx90_emulator.identification.output.report import check_page, excitation_page, measured_page, report_page
from rx90_emulator.identification.output.robot_files import folder_base, parameters_text, robot_files
from rx90_emulator.identification.output.summary import (
    check_summary,
    excitation_summary,
    identification_summary,
    measured_summary,
)
from rx90_emulator.identification.result import ExcitationIdentification
from rx90_emulator.identification.validation.measured import MeasuredComparison, compare_measured, simulated_setup
from rx90_emulator.loop.setup import Setup

REPORT = "report.html"
PARAMETERS = "parameters.yaml"
_FILES = (REPORT, PARAMETERS, *FILES.values())
_BAR = "{desc:<40.40}{n_fmt} steps [{elapsed}]"


@contextmanager
def steps() -> Iterator[Callable[[str], None]]:
    """Show a progress line; yield the function to call with the name of each step before it."""
    # What is refused before the first step needs no line.
    with tqdm(bar_format=_BAR, disable=None, delay=1e-9, mininterval=0.0, file=sys.stderr) as bar:

        def step(text: str) -> None:
            bar.set_description_str(text, refresh=False)
            bar.update()

        yield step


def check_targets(*files: Path | None, force: bool) -> None:
    """Refuse files that could not be written at the end, before anything that takes long."""
    for file in filter(None, files):
        check_place(file)
        if file.exists() and not file.is_file():
            kind = "a folder" if file.is_dir() else "no regular file"
            raise IdentificationError(f"{file} is {kind}; accepted: the name of a file")
        check_replaced(file, force=force, kind=IdentificationError)
        folder = file.absolute().parent
        if not folder.is_dir():
            raise IdentificationError(f"{file}: the folder {folder} does not exist; accepted: a file in one that does")


def write_identification(
    result: FrictionIdentification, output: Path | str, report: Path | str | None = None, *, force: bool = False
) -> tuple[Path, Path]:
    """Write friction file and report, both or none, and return their names.

    Args:
        result: what was identified.
        output: friction file, .yaml.
        report: HTML page; by default beside the friction file.
        force: whether files that exist are replaced.

    Raises:
        IdentificationError: for files that exist without `force`, or names that are not acceptable.
        OutputError: for files that cannot be written.
    """
    file, page = _checked_targets(Path(output), report, force=force)
    write_all({file: friction_text(result).encode(), page: report_page(result, file.name).encode()})
    return file, page


def _checked_targets(output: Path, report: Path | str | None, *, force: bool) -> tuple[Path, Path]:
    page = output.with_suffix(".html") if report is None else Path(report)
    if output.resolve() == page.resolve():
        raise IdentificationError(f"--output and --report are both {output}; accepted: two files")
    check_targets(output, page, force=force)
    return output, page


def run_identification(
    bags: IdentificationBags | Path,
    robot: RobotOptions,
    tolerances: GivenTolerances,
    output: Path,
    report: Path | None = None,
    *,
    model: Sequence[str] | None = None,
    force: bool = False,
) -> bool:
    """Identify with a progress bar, write the files, print a summary, and return whether all validation bags agree.

    The arguments are those of `identify_friction` and `write_identification`; files are checked first.
    """
    _checked_targets(output, report, force=force)
    chosen = bags if isinstance(bags, IdentificationBags) else read_index(bags)
    with steps() as step:
        result = identify_friction(chosen, robot, tolerances, step, model=model)
    files = write_identification(result, output, report, force=force)
    print(f"{identification_summary(result)}\nfriction file: {files[0]}\nreport: {files[1]}")
    return result.confirmed


def run_check(
    friction: str,
    bags: Sequence[Path],
    robot: RobotOptions,
    tolerances: GivenTolerances,
    report: Path | None = None,
    *,
    force: bool = False,
) -> bool:
    """Compare a friction file with bags, write the report if requested, and return whether all bags agree.

    The arguments are those of `check_friction`; the report's place is checked first.
    """
    check_targets(report, force=force)
    with steps() as step:
        checks = check_friction(friction, bags, robot, tolerances, step)
    lines = [check_summary(checks)]
    if report is not None:
        write_text(report, check_page(checks, friction))
        lines.append(f"report: {report}")
    print("\n".join(lines))
    return all(check.passed and not check.alarms for check in checks)


def _check_folder(folder: Path, *, force: bool) -> None:
    """Refuse a folder, existing or not, into which the robot's files could not be written at the end."""
    if folder.exists() and not folder.is_dir():
        raise IdentificationError(f"{folder} is no folder; accepted: the name of a folder")
    check_targets(*([folder / name for name in _FILES] if folder.is_dir() else [folder]), force=force)


def write_excitation(result: ExcitationIdentification, folder: Path | str, *, force: bool = False) -> Path:
    """Write the result of an identification into a folder, all files or none, and return the folder.

    The folder holds `report.html`, `parameters.yaml` and the files that the simulation loads.

    Args:
        result: what was identified.
        folder: made if it does not exist; other files in it stay.
        force: whether files that exist are replaced.

    Raises:
        IdentificationError: for files that exist without `force`, or a place where no folder can be made.
        OutputError: for files that cannot be written.
    """
    folder = Path(folder)
    date = datetime.now(timezone.utc)
    _check_folder(folder, force=force)
    robot, note = robot_files(result, date)
    page = excitation_page(result, date, versions(), (*robot, note))
    texts = {**robot, REPORT: page, PARAMETERS: parameters_text(result, date, versions())}
    _check_folder(folder, force=force)  # again: another identification may have written there meanwhile
    new = not folder.is_dir()
    try:
        folder.mkdir(exist_ok=True)
        write_all({folder / name: text.encode() for name, text in texts.items()})
    except BaseException as error:
        if new:
            with suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise write_error(folder, error) from error
        raise
    return folder


def run_excitation(
    bags: Sequence[Path],
    robot: RobotOptions,
    validation: Sequence[Path],
    tolerances: ExcitationTolerances,
    output: Path,
    *,
    force: bool = False,
    **how: Any,
) -> bool:
    """Identify with a progress bar, write the folder, print a summary, and return whether all validation runs agree.

    The arguments are those of `identify_excitation`; the folder is checked first.
    """
    _check_folder(output, force=force)
    with steps() as step:
        result = identify_excitation(bags, robot, validation, tolerances, progress=step, **how)
    folder = write_excitation(result, output, force=force)
    print(f"{excitation_summary(result)}\n{folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}")
    if result.robot.setup is None:
        base, note = folder_base(result.problem.arm, Path(str(result.options.urdf)))
        print(f"{folder}: {note}")
        if base is not None:
            law = load_controller(folder / FILES["controller"])
            if lost := weight_warning(load_robot(folder / FILES["urdf"]), base.turning, law):
                print(f"warning: {folder}: {lost}")
    return result.confirmed


def write_measured(result: MeasuredComparison, setup: Setup, page: Path | str, *, force: bool = False) -> Path:
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
    files = () if setup.files is None else tuple(setup.files.text(role) for role in MODEL_FILES)
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
        result = compare_measured(bag, setup, layout, tolerances, bandwidth=bandwidth, progress=step)
    print(measured_summary(result))
    if page is not None:
        print(f"report: {write_measured(result, setup, page, force=force)}")
    return result.passed
