"""`rx90_identify`: from recorded bags to a friction file, a report, and a verdict on a bag that was not used."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from rx90_common.compiled import announce_compilation
from rx90_common.errors import Rx90Error
from rx90_identification.errors import IdentificationError
from rx90_identification.experiments.folder import Bags, read_index
from rx90_identification.friction_file import friction_text
from rx90_identification.identify import Identification, identify
from rx90_identification.reading import read_record
from rx90_identification.report import report_page
from rx90_identification.robot_options import Robot, add_robot_arguments, robot_of
from rx90_identification.summary import summary
from rx90_identification.validation import Tolerances, Validation
from rx90_identification.validation_run import validate

CONFIRMED, NOT_CONFIRMED, REFUSED, INTERRUPTED = 0, 1, 3, 130
_SLIDING_RATE = 250.0  # Hz: plateaus are averaged anyway
_EPILOG = """\
exit status: 0 identified, and confirmed by the validation bag where there is one; 1 identified, but not confirmed;
2 wrong usage; 3 refused, nothing written; 130 interrupted, nothing written.
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rx90_identify", description=__doc__, epilog=_EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, help="folder that rx90_experiment wrote")
    bags = parser.add_argument_group("bags, instead of a folder")
    for name, what in (
        ("sliding", "sweeps at constant velocity"),
        ("presliding", "micro-oscillations"),
        ("validation", "a run to hold the result against, not used before"),
    ):
        bags.add_argument(f"--{name}", type=Path, nargs="+", default=[], metavar="BAG", help=what)
    result = parser.add_argument_group("result")
    result.add_argument("--output", type=Path, required=True, metavar="FILE", help="friction file to write (.yaml)")
    result.add_argument("--report", type=Path, metavar="FILE", help="report to write (beside the friction file, .html)")
    result.add_argument("--force", action="store_true", help="replace files that exist")
    limits = Tolerances()
    result.add_argument("--torque-tolerance", type=float, default=limits.torque, metavar="SHARE",
                        help="RMS difference over RMS torque, of each joint (%(default)s)")  # fmt: skip
    result.add_argument("--worst-torque-tolerance", type=float, default=limits.worst_torque, metavar="SHARE",
                        help="largest difference over largest torque, of each joint (%(default)s)")  # fmt: skip
    result.add_argument("--tip-tolerance", type=float, default=limits.tip, metavar="M",
                        help="largest distance of the tips, m (%(default)s)")  # fmt: skip
    add_robot_arguments(parser)
    return parser


def _bags(options: argparse.Namespace) -> Bags:
    given = Bags(tuple(options.sliding), tuple(options.presliding), tuple(options.validation))
    single = given.sliding + given.presliding + given.validation
    if options.folder is not None and single:
        raise IdentificationError(f"{options.folder} and {single[0]}; accepted: a folder or single bags, not both")
    bags = given if options.folder is None else read_index(options.folder)
    if not bags.sliding:
        raise IdentificationError("no bag with sweeps at constant velocity; accepted: a folder, or --sliding BAG ...")
    used = {bag.resolve() for bag in (*bags.sliding, *bags.presliding)}
    for bag in bags.validation:
        if bag.resolve() in used:
            raise IdentificationError(
                f"{bag}: also used for the identification; accepted: another bag for the validation"
            )
    return bags


def _targets(options: argparse.Namespace) -> tuple[Path, Path]:
    output: Path = options.output
    report: Path = options.report or output.with_suffix(".html")
    if output.resolve() == report.resolve():
        raise IdentificationError(f"--output and --report are both {output}; accepted: two files")
    for file in (output, report):
        if file.exists() and not options.force:
            raise IdentificationError(f"{file} exists; accepted: another name, or --force to replace it")
        if not file.absolute().parent.is_dir():
            raise IdentificationError(f"{file}: the folder {file.absolute().parent} does not exist")
    return output, report


def _run(options: argparse.Namespace) -> int:
    output, report = _targets(options)
    bags = _bags(options)
    robot = robot_of(options)
    announce_compilation("rx90_identify")
    result, checks = _identify(bags, robot, options)
    print(summary(result, checks))
    pages = {
        output: friction_text(result, robot.fallback_name),
        report: report_page(result, checks, output.name),
    }
    _write(pages)
    print(f"friction file: {output}\nreport: {report}")
    if all(check.passed for check in checks):
        return CONFIRMED
    print("rx90_identify: the validation does not confirm the result", file=sys.stderr)
    return NOT_CONFIRMED


def _identify(bags: Bags, robot: Robot, options: argparse.Namespace) -> tuple[Identification, list[Validation]]:
    total = len(bags.sliding) + len(bags.presliding) + 2 + len(bags.validation)
    with tqdm(total=total, bar_format="{desc:<40.40}{bar}| {n_fmt}/{total_fmt} [{elapsed}]", file=sys.stderr) as bar:

        def step(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        sliding = []
        for path in bags.sliding:
            step(path.name)
            sliding.append(read_record(path, robot.layout(path, fast=False), _SLIDING_RATE))
        presliding = []
        for path in bags.presliding:
            step(path.name)
            presliding.append(read_record(path, robot.layout(path, fast=True)))
        result = identify(sliding, presliding, robot.arm, robot.fallback, options.torque_delay, step)
        tolerances = Tolerances(options.torque_tolerance, options.worst_torque_tolerance, options.tip_tolerance)
        checks = []
        for path in bags.validation:
            step(path.name)
            checks.append(validate(result, robot, path, tolerances))
    return result, checks


def _write(pages: dict[Path, str]) -> None:
    """Write all files or none: beside their places first, then under their names."""
    written = []
    try:
        for file, text in pages.items():
            beside = file.with_name(f".{file.name}.{os.getpid()}")
            written.append((beside, file))
            beside.write_text(text, encoding="utf-8")
        for beside, file in written:
            beside.replace(file)
    except OSError as error:
        raise IdentificationError(f"{error.filename}: cannot be written ({error.strerror})") from error
    finally:
        for beside, _ in written:
            beside.unlink(missing_ok=True)


def main(args: Sequence[str] | None = None) -> int:
    """Run `rx90_identify` and return its exit status."""
    options = _parser().parse_args(args)
    try:
        return _run(options)
    except KeyboardInterrupt:
        print("\nrx90_identify: interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    except Rx90Error as error:
        print(f"rx90_identify: {error}", file=sys.stderr)
        return REFUSED


if __name__ == "__main__":
    sys.exit(main())
