"""What `rx90_identify` does, apart from its options: imported once these are understood, for it takes seconds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rx90_common.base.errors import IdentificationError
from rx90_common.process.files import write_all, write_text
from rx90_emulator.identification.experiments.folder import IdentificationBags, read_index
from rx90_emulator.identification.friction_check import check_friction
from rx90_emulator.identification.identify import identify_friction
from rx90_emulator.identification.model.options import RobotOptions, ValidationTolerances
from rx90_emulator.identification.model.robot import RecordedRobot
from rx90_emulator.identification.output.files import check_targets
from rx90_emulator.identification.output.friction_file import friction_text
from rx90_emulator.identification.output.report import check_page, report_page
from rx90_emulator.identification.output.summary import check_summary, identification_summary
from rx90_emulator.identification.presliding.kinds import kind_steps
from rx90_emulator.identification.progress import steps
from rx90_emulator.identification.result.identification import FrictionIdentification


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
        IdentificationError: for files that exist, or that are not acceptable.
        OutputError: for files that cannot be written.
    """
    file, page = _targets(Path(output), None if report is None else Path(report), force=force)
    write_all({file: friction_text(result).encode(), page: report_page(result, file.name).encode()})
    return file, page


def _targets(output: Path, report: Path | None, *, force: bool) -> tuple[Path, Path]:
    page = report or output.with_suffix(".html")
    if output.resolve() == page.resolve():
        raise IdentificationError(f"--output and --report are both {output}; accepted: two files")
    check_targets((output, page), force=force)
    return output, page


def run_identification(
    bags: IdentificationBags | Path,
    robot: RobotOptions,
    tolerances: ValidationTolerances,
    output: Path,
    report: Path | None = None,
    *,
    bristle_kinds: bool = False,
    force: bool = False,
) -> bool:
    """Identify with a progress bar, write the files, print a summary, and return whether no validation bag disagrees.

    Args:
        bags: as in `identify_friction`, as are robot and tolerances.
        robot: that the bags come from.
        tolerances: of the validation.
        output: as in `write_identification`, as are report and force; checked before anything long begins.
        report: HTML page.
        bristle_kinds: as in `identify_friction`.
        force: whether files that exist are replaced.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    _targets(output, report, force=force)
    chosen = bags if isinstance(bags, IdentificationBags) else read_index(bags)
    total = sum(map(len, vars(chosen).values())) + 2 + len(chosen.validation)
    if bristle_kinds:
        total += kind_steps(RecordedRobot.load(robot).arm)
    with steps(total) as step:
        result = identify_friction(chosen, robot, tolerances, step, bristle_kinds=bristle_kinds)
    files = write_identification(result, output, report, force=force)
    print(f"{identification_summary(result)}\nfriction file: {files[0]}\nreport: {files[1]}")
    return result.confirmed


def run_check(
    friction: str,
    bags: Sequence[Path],
    robot: RobotOptions,
    tolerances: ValidationTolerances,
    report: Path | None = None,
    *,
    force: bool = False,
) -> bool:
    """Hold a friction file against bags, write the report if it is asked for, and return whether none disagrees.

    Args:
        friction: as in `check_friction`, as are bags, robot and tolerances.
        bags: one or more.
        robot: that the bags come from.
        tolerances: what counts as agreement.
        report: HTML page.
        force: whether a report that exists is replaced.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    if report is not None:
        check_targets((report,), force=force)
    with steps(2 * len(bags)) as step:
        checks = check_friction(friction, bags, robot, tolerances, step)
    if report is not None:
        write_text(report, check_page(checks, friction))
    print(check_summary(checks))
    if report is not None:
        print(f"report: {report}")
    return all(check.passed for check in checks)
