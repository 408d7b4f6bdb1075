"""What `rx90_identify` does, apart from its options: imported once these are understood, for it takes seconds."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.experiments.folder import Bags, read_index
from rx90_emulator.identification.identify import Identification, identify
from rx90_emulator.identification.output.friction_file import friction_text
from rx90_emulator.identification.output.output_files import check_targets, write_all
from rx90_emulator.identification.output.report import report_page
from rx90_emulator.identification.output.summary import summary
from rx90_emulator.identification.output.validation import Validation
from rx90_emulator.identification.output.validation_run import validate
from rx90_emulator.identification.records.reading import read_record
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.records.robot import Robot, robot_of
from rx90_emulator.identification.records.tolerances import Tolerances

_RATES = {"sliding": 250.0, "presliding": None, "validation": 1000.0}
"""Hz that records are averaged to: plateaus are averaged anyway, and the validation looks below 40 Hz."""
_BEYOND = 2.0  # times the range of a joint that no offset of its zero explains


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


def run(options: argparse.Namespace) -> bool:
    """Identify, write the files, print a summary, and return whether the result is confirmed, or nothing checks it.

    Raises:
        Rx90Error: for what cannot be done; nothing has been written then.
    """
    output, report = _targets(options)
    bags = _bags(options)
    robot = robot_of(options)
    if not bags.presliding and robot.fallback is None:
        raise IdentificationError(
            "no bag with micro-oscillations, and nothing to take c0 and c1 from; accepted: --presliding BAG ..., or "
            "--fallback FILE"
        )
    result, checks, used = _identify(bags, robot, options)
    write_all(
        {
            output: friction_text(result, robot.fallback_name),
            report: report_page(result, checks, output.name, used, robot.fallback_name),
        }
    )
    print(f"{summary(result, checks)}\nfriction file: {output}\nreport: {report}")
    return all(check.passed for check in checks)


def _identify(
    bags: Bags, robot: Robot, options: argparse.Namespace
) -> tuple[Identification, list[Validation], list[tuple[str, JointRecord]]]:
    """Return the result, its checks, and what each record was used for."""
    everything = [(use, path) for use, paths in vars(bags).items() for path in paths]
    total = len(everything) + 2 + len(bags.validation)
    with tqdm(
        total=total, bar_format="{desc:<40.40}{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]", file=sys.stderr
    ) as bar:

        def step(text: str) -> None:
            bar.set_description_str(text)
            bar.update()

        # All of them first: what is wrong with the last bag must not show after the whole fit.
        layouts = [robot.layout(path, fast=use != "sliding") for use, path in everything]
        records: dict[str, list[JointRecord]] = {use: [] for use in vars(bags)}
        for (use, path), layout in zip(everything, layouts, strict=True):
            step(path.name)
            records[use].append(read_record(path, layout, _RATES[use]))
            _check_range(records[use][-1], robot)
        _check_unused(records)
        result = identify(
            records["sliding"],
            records["presliding"],
            robot.arm,
            robot.fallback,
            options.torque_delay,
            step,
            robot.plant_period,
        )
        tolerances = Tolerances(options.torque_tolerance, options.worst_torque_tolerance, options.tip_tolerance)
        checks = []
        for record in records["validation"]:
            step(record.source.name)
            checks.append(validate(result, robot, record, tolerances))
    return result, checks, [(use, record) for use, some in records.items() for record in some]


def _check_range(record: JointRecord, robot: Robot) -> None:
    """Refuse angles that no joint of the URDF goes through: degrees, or a motor's."""
    for name, travel, width in zip(record.names, np.ptp(record.position, axis=0), robot.arm.ranges(), strict=True):
        if 0.0 < _BEYOND * width < travel:
            raise IdentificationError(
                f"{record.source}: {name} moves through {travel:.3g} rad, in its URDF through {width:.3g} rad at most; "
                "accepted: angles of the joints in rad, or of the motors with their --gear"
            )


def _check_unused(records: Mapping[str, Sequence[JointRecord]]) -> None:
    """Refuse a validation bag whose content, under whatever name, the identification rests on."""
    used = {record.sha256: record.source for record in (*records["sliding"], *records["presliding"])}
    for record in records["validation"]:
        if record.sha256 in used:
            other = "" if used[record.sha256] == record.source else f" as {used[record.sha256]}"
            raise IdentificationError(
                f"{record.source}: also used for the identification{other}; accepted: another bag for the validation"
            )
