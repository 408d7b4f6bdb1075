"""What `rx90_identify --excitation` does, apart from its options: imported once these are understood."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from rx90_common.base.versions import versions
from rx90_common.description.robot_files import FILES, RobotFiles
from rx90_emulator.identification.excitation.identify import identify_excitation
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.model.options import ExcitationTolerances, RobotOptions
from rx90_emulator.identification.output.excitation.parameters_file import parameters_text
from rx90_emulator.identification.output.excitation.report import report_page
from rx90_emulator.identification.output.excitation.summary import excitation_summary
from rx90_emulator.identification.output.files import check_folder, write_folder
from rx90_emulator.identification.output.robot.folder import IdentifiedRobot, folder_base, robot_texts
from rx90_emulator.identification.progress import steps

REPORT, PARAMETERS = "report.html", "parameters.yaml"
_FILES = (REPORT, PARAMETERS, *FILES.values())


def write_excitation(result: ExcitationIdentification, folder: Path | str, *, force: bool = False) -> Path:
    """Write what was identified into a folder, all files or none, and return it.

    The folder holds `report.html`, `parameters.yaml` and the files that the simulation loads.

    Args:
        result: what was identified.
        folder: made if it is not there; other files in it stay.
        force: whether files that exist are replaced.

    Raises:
        IdentificationError: for files that exist, or a place that takes no folder.
        OutputError: for files that cannot be written.
    """
    folder = Path(folder)
    check_folder(folder, _FILES, force=force)
    date = datetime.now(timezone.utc)
    texts = {REPORT: report_page(result, date, versions()), PARAMETERS: parameters_text(result, date, versions())}
    write_folder(folder, texts | _robot(result, date))
    return folder


def _base(result: ExcitationIdentification) -> tuple[RobotFiles | None, str]:
    """Return the files that the robot's folder begins with, None for no whole folder, and what that means."""
    own = result.robot.setup
    if own is not None and own.files is not None:
        return own.files, f"what was not identified is that of {own.files.urdf.parent.name}"
    assert result.robot.urdf is not None
    return folder_base(result.problem.arm, result.robot.urdf)


def _robot(result: ExcitationIdentification, date: datetime) -> dict[str, str]:
    sources = tuple(bag for use, bag in result.bags if use == "excitation")
    robot = IdentifiedRobot(
        result.problem.arm,
        result.inertias.bodies,
        result.problem.base.standard,
        result.elements,
        result.robot.fallback_name,
        sources,
    )
    assert result.robot.urdf is not None
    return robot_texts(robot, result.robot.urdf, _base(result)[0], date)


def run_excitation(
    bags: Sequence[Path],
    robot: RobotOptions,
    validation: Sequence[Path],
    tolerances: ExcitationTolerances,
    output: Path,
    *,
    bristles: bool = False,
    force: bool = False,
) -> bool:
    """Identify with a progress bar, write the folder, print a summary, and return whether no validation run disagrees.

    Args:
        bags: as in `identify_excitation`, as are robot, validation, tolerances and bristles.
        robot: that they come from.
        validation: runs to predict.
        tolerances: of the validation.
        output: folder; checked before anything long begins.
        bristles: whether they are tried.
        force: whether files that exist are replaced.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    check_folder(output, _FILES, force=force)
    with steps(len(bags) + 2 * len(validation) + 3) as step:
        result = identify_excitation(bags, robot, validation, tolerances, bristles=bristles, progress=step)
    folder = write_excitation(result, output, force=force)
    print(f"{excitation_summary(result)}\nrobot: {folder}: {_base(result)[1]}")
    print(f"report: {folder / REPORT}\nparameters: {folder / PARAMETERS}")
    return result.confirmed
