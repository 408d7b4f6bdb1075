"""`rx90_identify`: from recorded bags to a friction file, a report, and a verdict on a bag that was not used."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from rx90_common.compiled import announce_compilation
from rx90_common.errors import Rx90Error
from rx90_common.interrupts import terminations_as_interrupts
from rx90_identification.errors import IdentificationError
from rx90_identification.experiments.folder import Bags, read_index
from rx90_identification.friction_file import friction_text
from rx90_identification.identify import Identification, identify
from rx90_identification.output_files import check_targets, write_all
from rx90_identification.reading import read_record
from rx90_identification.record import JointRecord
from rx90_identification.report import report_page
from rx90_identification.robot_options import Robot, add_robot_arguments, number, robot_of
from rx90_identification.summary import summary
from rx90_identification.validation import Tolerances, Validation
from rx90_identification.validation_run import validate

CONFIRMED, NOT_CONFIRMED, REFUSED, INTERRUPTED = 0, 1, 3, 130
_RATES = {"sliding": 250.0, "presliding": None, "validation": 1000.0}
"""Hz that records are averaged to: plateaus are averaged anyway, and the validation looks below 40 Hz."""
_USAGE = """
  rx90_identify FOLDER --output FILE [options]
  rx90_identify --sliding BAG ... [--presliding BAG ...] [--validation BAG ...] --output FILE [options]
  rx90_identify --sliding BAG ... --output FILE --urdf FILE [--topic T] [--joints J ...] [options]"""
_EPILOG = """\
example of another robot, with currents of its motors on /arm/motors:
  rx90_identify --sliding sweeps.bag --presliding wiggle.bag --validation run.bag --output friction.yaml \\
      --urdf arm.urdf --topic arm/motors --joints shoulder elbow --names m1 m2 --gear 100 80 --torque-constant 0.12 0.1
a bag is a rosbag2 folder, an .mcap or .db3 file, or a .bag file of ROS 1; docs/identification.md says what the motions
should be.

exit status: 0 identified, and confirmed by the validation bag where there is one; 1 identified, but not confirmed;
2 wrong usage; 3 refused, nothing written; 130 interrupted, nothing written.
"""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="rx90_identify",
        usage=_USAGE,
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="?", type=Path, help="folder that rx90_experiment wrote")
    bags = parser.add_argument_group("bags, instead of a folder")
    for name, what in (
        ("sliding", "sweeps at constant velocity: 5 speeds or more in both directions, at several poses"),
        (
            "presliding",
            "micro-oscillations, 500 samples per second or more; without them c0 and c1 are those of --fallback",
        ),
        ("validation", "a run to hold the result against, not used before"),
    ):
        bags.add_argument(f"--{name}", type=Path, nargs="+", default=[], metavar="BAG", help=what)
    result = parser.add_argument_group("result")
    result.add_argument("--output", type=Path, required=True, metavar="FILE", help="friction file to write (.yaml)")
    result.add_argument("--report", type=Path, metavar="FILE", help="report to write (beside the friction file, .html)")
    result.add_argument("--force", action="store_true", help="replace files that exist")
    limits = Tolerances()
    share = number("a positive number", lambda value: value > 0.0)
    result.add_argument("--torque-tolerance", type=share, default=limits.torque, metavar="SHARE",
                        help="RMS difference over RMS torque, of each joint (%(default)s)")  # fmt: skip
    result.add_argument("--worst-torque-tolerance", type=share, default=limits.worst_torque, metavar="SHARE",
                        help="largest difference over largest torque, of each joint (%(default)s)")  # fmt: skip
    result.add_argument("--tip-tolerance", type=share, default=limits.tip, metavar="M",
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
    for name, paths in vars(bags).items():
        places = [bag.resolve() for bag in paths]
        for bag in paths:
            if places.count(bag.resolve()) > 1:
                raise IdentificationError(f"{bag}: given twice for --{name}; accepted: each bag once")
    return bags


def _targets(options: argparse.Namespace) -> tuple[Path, Path]:
    output: Path = options.output
    report: Path = options.report or output.with_suffix(".html")
    if output.resolve() == report.resolve():
        raise IdentificationError(f"--output and --report are both {output}; accepted: two files")
    check_targets((output, report), force=options.force)
    return output, report


def _run(options: argparse.Namespace) -> int:
    output, report = _targets(options)
    bags = _bags(options)
    robot = robot_of(options)
    if not bags.presliding and robot.fallback is None:
        raise IdentificationError(
            "no bag with micro-oscillations, and nothing to take c0 and c1 from; accepted: --presliding BAG ..., or "
            "--fallback FILE"
        )
    announce_compilation("rx90_identify")
    result, checks, used = _identify(bags, robot, options)
    write_all(
        {
            output: friction_text(result, robot.fallback_name),
            report: report_page(result, checks, output.name, used, robot.fallback_name),
        }
    )
    print(f"{summary(result, checks)}\nfriction file: {output}\nreport: {report}")
    if all(check.passed for check in checks):
        return CONFIRMED
    print("rx90_identify: the validation does not confirm the result", file=sys.stderr)
    return NOT_CONFIRMED


def _identify(
    bags: Bags, robot: Robot, options: argparse.Namespace
) -> tuple[Identification, list[Validation], list[tuple[str, JointRecord]]]:
    """Return the result, its checks, and what each record was used for."""
    everything = [(use, path) for use, paths in vars(bags).items() for path in paths]
    total = len(everything) + 2 + len(bags.validation)
    with tqdm(total=total, bar_format="{desc:<40.40}{bar}| {n_fmt}/{total_fmt} [{elapsed}]", file=sys.stderr) as bar:

        def step(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        # All of them first: what is wrong with the last bag must not show after the whole fit.
        layouts = [robot.layout(path, fast=use != "sliding") for use, path in everything]
        records: dict[str, list[JointRecord]] = {use: [] for use in vars(bags)}
        for (use, path), layout in zip(everything, layouts, strict=True):
            step(path.name)
            records[use].append(read_record(path, layout, _RATES[use]))
        _check_unused(records)
        result = identify(
            records["sliding"], records["presliding"], robot.arm, robot.fallback, options.torque_delay, step
        )
        tolerances = Tolerances(options.torque_tolerance, options.worst_torque_tolerance, options.tip_tolerance)
        checks = []
        for record in records["validation"]:
            step(record.source.name)
            checks.append(validate(result, robot, record, tolerances))
    return result, checks, [(use, record) for use, some in records.items() for record in some]


def _check_unused(records: Mapping[str, Sequence[JointRecord]]) -> None:
    """Refuse a validation bag whose content, under whatever name, the identification rests on."""
    used = {record.sha256: record.source for record in (*records["sliding"], *records["presliding"])}
    for record in records["validation"]:
        if record.sha256 in used:
            other = "" if used[record.sha256] == record.source else f" as {used[record.sha256]}"
            raise IdentificationError(
                f"{record.source}: also used for the identification{other}; accepted: another bag for the validation"
            )


def main(args: Sequence[str] | None = None) -> int:
    """Run `rx90_identify` and return its exit status."""
    options = _parser().parse_args(args)
    try:
        with terminations_as_interrupts():
            return _run(options)
    except KeyboardInterrupt:
        print("\nrx90_identify: interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    except Rx90Error as error:
        print(f"rx90_identify: {error}", file=sys.stderr)
        return REFUSED


if __name__ == "__main__":
    sys.exit(main())
