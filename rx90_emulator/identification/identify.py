"""From bags to identified friction, for Python users and the command alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.experiments.folder import IdentificationBags, read_emulated, read_index
from rx90_emulator.identification.model.options import RobotOptions, ValidationTolerances
from rx90_emulator.identification.model.robot import RecordedRobot
from rx90_emulator.identification.records.reading import read_record
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.result.identification import FrictionIdentification, identify_records
from rx90_emulator.identification.result.validation import validate

_RATES = {"sliding": 250.0, "presliding": None, "validation": 1000.0}
"""Hz that records are averaged to: plateaus are averaged anyway, and the validation looks below 40 Hz."""
_BEYOND = 2.0  # times the range of a joint: travel that no offset of its zero explains
_DEFAULT_ROBOT = RobotOptions()
_DEFAULT_TOLERANCES = ValidationTolerances()


def identify_friction(
    bags: IdentificationBags | Path | str,
    robot: RobotOptions = _DEFAULT_ROBOT,
    tolerances: ValidationTolerances = _DEFAULT_TOLERANCES,
    progress: Callable[[str], None] = lambda _: None,
    *,
    bristle_kinds: bool = False,
) -> FrictionIdentification:
    """Identify the friction of a robot from recorded bags (section 4 of Waiboer, Aarts and Jonker).

    Args:
        bags: by use, or a folder that `rx90_experiment` wrote.
        robot: that the bags come from; by default this project's.
        tolerances: what counts as agreement with the validation bags.
        progress: called with the name of each step before it: each bag, the two fits, each kind of bristles of each
            joint, each validation.
        bristle_kinds: whether the kind of each joint's bristles is chosen by cross-validation over its
            micro-oscillations, seconds for each joint; without, they are LuGre's.

    Returns:
        Estimates with standard deviations, both fits, and a validation for each validation bag.

    Raises:
        IdentificationError: for bags or options that do not fit each other, and data that do not suffice.
        BagError: for a bag that cannot be read.
        ConfigError: for a file of the robot that cannot be used.
    """
    chosen = bags if isinstance(bags, IdentificationBags) else read_index(Path(bags))
    _check_bags(chosen, bristle_kinds=bristle_kinds)
    source = RecordedRobot.load(robot)
    truth = read_emulated([*chosen.sliding, *chosen.presliding])
    if not chosen.presliding and source.fallback is None:
        raise IdentificationError(
            "no bag with micro-oscillations, and nothing to take c0 and c1 from; accepted: --presliding BAG ..., or "
            "--fallback FILE"
        )
    records = _read(chosen, source, progress)
    result = identify_records(records["sliding"], records["presliding"], source, progress, bristle_kinds=bristle_kinds)
    checks = []
    for record in records["validation"]:
        progress(record.source.name)
        checks.append(validate(source, result.lugre, result.sliding, record, tolerances))
    used = tuple((use, record.bag) for use, some in records.items() for record in some)
    return replace(result, bags=used, validations=tuple(checks), truth=truth)


def _check_bags(bags: IdentificationBags, *, bristle_kinds: bool) -> None:
    if not bags.sliding:
        raise IdentificationError("no bag with sweeps at constant velocity; accepted: a folder, or --sliding BAG ...")
    if bristle_kinds and not bags.presliding:
        raise IdentificationError("--bristle-kinds without micro-oscillations; accepted: with --presliding BAG ...")
    for use, paths in vars(bags).items():
        places = [bag.resolve() for bag in paths]
        for bag in paths:
            if places.count(bag.resolve()) > 1:
                raise IdentificationError(f"{bag}: given twice for --{use}; accepted: each bag once")


def _read(
    bags: IdentificationBags, robot: RecordedRobot, progress: Callable[[str], None]
) -> dict[str, list[JointRecord]]:
    """Return the records by use; all bags are read before anything is fitted, so that a bad one is refused soon."""
    everything = [(use, path) for use, paths in vars(bags).items() for path in paths]
    layouts = [robot.layout(path, fast=use != "sliding") for use, path in everything]
    records: dict[str, list[JointRecord]] = {use: [] for use in vars(bags)}
    for (use, path), layout in zip(everything, layouts, strict=True):
        progress(path.name)
        record = read_record(path, layout, _RATES[use])
        check_range(record, robot)
        records[use].append(record)
    _check_unused(records)
    return records


def check_range(record: JointRecord, robot: RecordedRobot) -> None:
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
