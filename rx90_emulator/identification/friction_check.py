"""Hold a given friction file against bags, without an identification."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import quoted
from rx90_common.base.share import resolve_config
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.friction_set import refuse_parts
from rx90_emulator.identification.identify import check_range
from rx90_emulator.identification.model.options import RobotOptions, ValidationTolerances
from rx90_emulator.identification.model.robot import RecordedRobot
from rx90_emulator.identification.records.reading import read_record
from rx90_emulator.identification.result.validation import Validation, validate

_RATE = 1000.0  # Hz that records are averaged to: the comparison looks below 40 Hz
_DEFAULT_ROBOT = RobotOptions()
_DEFAULT_TOLERANCES = ValidationTolerances()


def check_friction(
    friction: FrictionFile | Path | str,
    bags: Sequence[Path | str],
    robot: RobotOptions = _DEFAULT_ROBOT,
    tolerances: ValidationTolerances = _DEFAULT_TOLERANCES,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Validation, ...]:
    """Compare the torques that a friction file predicts along recorded motions with the recorded ones.

    The rest of the arm is as `robot` describes it: links, rotors, coupling, spring.

    Args:
        friction: the file, by its content, its path or the name of a shipped one; its elements are the arm's.
        bags: one or more runs, none of them twice.
        robot: that the bags come from; by default this project's.
        tolerances: what counts as agreement.
        progress: called twice for each bag, before it is read and before it is compared.

    Returns:
        A comparison for each bag; `passed` is its verdict.

    Raises:
        IdentificationError: for bags, elements or options that do not fit each other.
        BagError: for a bag that cannot be read.
        ConfigError: for a file that cannot be used.
    """
    paths = [Path(bag) for bag in bags]
    if not paths:
        raise IdentificationError("no bag to hold the friction against; accepted: --validation BAG ...")
    places = [bag.resolve() for bag in paths]
    for bag, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise IdentificationError(f"{bag}: given twice for --validation; accepted: each bag once")
    file = friction if isinstance(friction, FrictionFile) else FrictionFile.read(resolve_config(str(friction)))
    source = RecordedRobot.load(robot)
    names = source.arm.element_names
    lugre = file.select(names)
    for name in file.elements:
        if name not in names:
            raise IdentificationError(
                f"{file.path or '--friction'}: element {quoted(name)} is none of this arm; accepted: {', '.join(names)}"
            )
    where = f"{file.path or '--friction'}: elements."
    refuse_parts(file.elements, "a validation by recorded torques", where, held=("bristles",))
    records = []
    for bag in paths:
        progress(bag.name)
        record = read_record(bag, source.layout(bag, fast=True), _RATE)
        check_range(record, source)
        records.append(record)
    checks = []
    for record in records:
        progress(record.source.name)
        checks.append(validate(source, lugre, None, record, tolerances))
    return tuple(checks)
