"""The files of an identification, and the line of progress while one runs: slow to import."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tqdm import tqdm

from rx90_common.base.errors import IdentificationError, check_place, check_replaced
from rx90_common.description.robot_files import FILES
from rx90_common.process.files import made_folder, write_all
from rx90_emulator.identification.output.friction_file import sweeps_text
from rx90_emulator.identification.output.report import identification_page
from rx90_emulator.identification.output.robot_files import (
    parameters_text,
    robot_files,
)
from rx90_emulator.identification.result import (
    ExcitationIdentification,
    FrictionIdentification,
)

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


def identification_targets(output: Path, *, folder: bool, force: bool) -> None:
    """Refuse places into which the files of an identification could not be written at the end.

    Args:
        output: friction file, or a folder.
        folder: which of them.
        force: whether files that exist are replaced.
    """
    if not folder:
        if output.suffix == ".html":
            raise IdentificationError(
                f"--output {output} is the place of the report; accepted: the name of a .yaml"
            )
        check_targets(output, output.with_suffix(".html"), force=force)
        return
    if output.exists() and not output.is_dir():
        raise IdentificationError(f"{output} is no folder; accepted: the name of a folder")
    check_targets(
        *([output / name for name in _FILES] if output.is_dir() else [output]), force=force
    )


def write_identification(
    result: FrictionIdentification | ExcitationIdentification,
    output: Path | str,
    *,
    force: bool = False,
) -> tuple[Path, ...]:
    """Write the files of an identification, all or none, and return their names.

    Args:
        result: what was identified.
        output: of sweeps the friction file, .yaml, beside which the report is written; of excitation runs a folder for
            `report.html`, `parameters.yaml` and the files that the simulation loads. It is made if it does not exist;
            other files in it stay.
        force: whether files that exist are replaced.

    Raises:
        IdentificationError: for files that exist without `force`, or names that are not acceptable.
        OutputError: for files that cannot be written.
    """
    output = Path(output)
    if isinstance(result, FrictionIdentification):
        page = identification_page(result, (output.name,))
        texts = {output: sweeps_text(result), output.with_suffix(".html"): page}
        identification_targets(output, folder=False, force=force)
        write_all({file: text.encode() for file, text in texts.items()})
        return tuple(texts)
    robot, note = robot_files(result)
    page = identification_page(result, (*robot, note))
    texts = {output / name: text for name, text in robot.items()}
    texts |= {output / REPORT: page, output / PARAMETERS: parameters_text(result)}
    identification_targets(output, folder=True, force=force)
    with made_folder(output):
        write_all({file: text.encode() for file, text in texts.items()})
    return tuple(texts)
