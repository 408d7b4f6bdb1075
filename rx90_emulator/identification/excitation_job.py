"""What `rx90_identify --excitation` does, apart from its options: imported once these are understood."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path

from rx90_common.base.versions import versions
from rx90_common.description.robot_files import FILES
from rx90_emulator.identification.excitation.identify import count_steps, identify_excitation
from rx90_emulator.identification.excitation.payload import read_payloads
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.model.options import ExcitationTolerances, RobotOptions
from rx90_emulator.identification.output.excitation.parameters_file import parameters_text
from rx90_emulator.identification.output.excitation.report import report_page
from rx90_emulator.identification.output.excitation.robot import robot_files
from rx90_emulator.identification.output.excitation.summary import excitation_summary
from rx90_emulator.identification.output.files import check_folder, write_folder
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
    robot, note = robot_files(result, date)
    page = report_page(result, date, versions(), (*robot, note))
    check_folder(folder, _FILES, force=force)  # again: another identification may have written there meanwhile
    write_folder(folder, {**robot, REPORT: page, PARAMETERS: parameters_text(result, date, versions())})
    return folder


def run_excitation(
    bags: Sequence[Path],
    robot: RobotOptions,
    validation: Sequence[Path],
    tolerances: ExcitationTolerances,
    output: Path,
    *,
    bristles: bool = False,
    payload: Path | None = None,
    load_part: bool = False,
    prior: float | None = None,
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
        payload: file of known payloads.
        load_part: whether they tell load parts of the friction, not drive gains.
        prior: relative standard deviation of the description's inertials.
        force: whether files that exist are replaced.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    check_folder(output, _FILES, force=force)
    payloads = {} if payload is None else read_payloads(payload)
    total = count_steps(len(bags), len(validation), bristles=bristles, payloads=bool(payloads))
    with steps(total) as step:
        result = identify_excitation(
            bags,
            robot,
            validation,
            tolerances,
            bristles=bristles,
            payloads=payloads,
            load_part=load_part,
            prior=prior,
            progress=step,
        )
    folder = write_excitation(result, output, force=force)
    print(f"{excitation_summary(result)}\n{folder}: {', '.join(sorted(path.name for path in folder.iterdir()))}")
    return result.confirmed
