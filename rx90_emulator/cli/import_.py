"""From other simulators: friction of BAM or MuJoCo into a friction file, an arm of MuJoCo into a robot folder."""

from __future__ import annotations

import argparse
from pathlib import Path

from rx90_common.base.errors import ConfigError
from rx90_emulator.cli.options import new_folder

_EPILOG = """\
Only what is exact is taken: BAM's models m1, m2 and, without motor terms, m5; <dcmotor lugre> or frictionloss of an
MJCF. What a source does not have, such as bristles, stands in the files as assumed. docs/howto/export.md says more.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.epilog = _EPILOG
    parser.set_defaults(interrupted="nothing was written")
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE",
                        help="BAM's parameters (.json), an element for each file; or one MJCF (.xml)")  # fmt: skip
    parser.add_argument("--output", required=True, type=new_folder, metavar="PATH",
                        help="new friction file (.yaml), or of an MJCF a new robot folder")  # fmt: skip


def main(options: argparse.Namespace) -> None:
    """Write what was read.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    # Here, because --help must not wait for them.
    from rx90_common.base.quoting import plain
    from rx90_common.process.files import write_text
    from rx90_emulator.export.export import write_folder
    from rx90_emulator.export.imports import import_arm, import_bam, import_mjcf_friction

    files, output = options.files, options.output
    if output.suffix.lower() in {".yml", ".xml", ".json"}:
        raise ConfigError(f"--output {plain(output)}; accepted: a .yaml file, or the name of a folder")
    kinds, whole = {file.suffix.lower() for file in files}, output.suffix.lower() != ".yaml"
    if kinds == {".json"}:
        if whole:
            raise ConfigError(f"--output {plain(output)}; accepted: a .yaml file for BAM's parameters")
        texts = {output.name: import_bam(files).text()}
    elif kinds == {".xml"} and len(files) == 1:
        texts = import_arm(files[0]) if whole else {output.name: import_mjcf_friction(files[0]).text()}
    else:
        raise ConfigError(f"{', '.join(map(plain, files))}; accepted: .json files of BAM, or one .xml file of MuJoCo")
    if whole:
        write_folder(output, texts)
        print(f"written: {', '.join(texts)} in {output}; what they say is assumed is not in {plain(files[0])}")
    else:
        write_text(output, texts[output.name])
        print(f"written: {output}")
