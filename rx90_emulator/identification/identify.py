"""From bags to identified friction, or to a verdict on a given one, for Python users and the command alike.

Records -> sliding regime -> presliding regime -> result -> validation.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.share import resolve_config
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile, refuse_parts
from rx90_common.friction.signs import SIGNS
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.estimates import (
    PRESLIDING,
    Estimates,
    IdentifiedElement,
    ParameterEstimate,
    least_coulomb,
    unknown_estimates,
    with_passive_fading,
)
from rx90_emulator.identification.experiments.plan import (
    IdentificationBags,
    read_index,
)
from rx90_emulator.identification.fitted import PRESLIDING_DISTANCE, RELAXATION
from rx90_emulator.identification.options import (
    NO_TOLERANCES,
    SHIPPED_ROBOT,
    GivenTolerances,
    Progress,
    RobotOptions,
)
from rx90_emulator.identification.presliding import PreslidingFit, identify_presliding
from rx90_emulator.identification.records import JointRecord, read_record
from rx90_emulator.identification.result import FrictionIdentification
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.rows.filtering import Bandwidths, recording_notes
from rx90_emulator.identification.sanity import log_alarms
from rx90_emulator.identification.sliding import identify_sliding
from rx90_emulator.identification.validation.prediction import (
    Validation,
    validate,
    validation_bandwidths,
)

_RATES = {"sliding": 250.0, "presliding": None, "excitation": 1000.0, "validation": 1000.0}
"""Rate, Hz, that records are averaged to, by use: plateaus are averaged anyway, a validation compares below 40 Hz, and
the motion of an arm has no content near 1 kHz."""
_MAX_TRAVEL_SHARE = 2.0  # of a joint's range: no offset of the zero explains more travel
_MAX_SPEED_SHARE = 20.0  # of a joint's limit: descriptions state 1 rad/s where an arm does 5
_LEAST_TRAVEL = 5e-3  # rad, of the joint that moves most
# of a validation's travel: two runs of a noiseless engine may begin with the same samples
_MAX_SHARED = 0.02


def identify_friction(
    bags: IdentificationBags | Path | str,
    robot: RobotOptions = SHIPPED_ROBOT,
    tolerances: GivenTolerances = NO_TOLERANCES,
    progress: Progress = lambda _: None,
) -> FrictionIdentification:
    """Identify the friction of a robot from recorded bags (section 4 of Aarts, Jonker and Waiboer).

    Args:
        bags: by use, or a folder that `rx90 experiment` wrote.
        robot: that the bags come from; by default this project's.
        tolerances: what counts as agreement with the validation bags; by default, value by value, as in
            `check_friction`.
        progress: called with the name of each step before it: each bag, the two fits, each validation.

    Returns:
        Estimates with standard deviations, both fits, and a validation for each validation bag.

    Raises:
        IdentificationError: for bags or options that contradict each other, and for insufficient data.
        BagError: for a bag that cannot be read.
        ConfigError: for a file of the robot that cannot be used.
    """
    chosen = bags if isinstance(bags, IdentificationBags) else read_index(Path(bags))
    by_use = {use: getattr(chosen, use) for use in ("sliding", "presliding", "validation")}
    if not chosen.sliding:
        raise IdentificationError(
            "no bag with sweeps at constant velocity; accepted: such bags, or a folder that rx90 experiment wrote"
        )
    check_given_once(by_use)
    source = RecordedRobot.load(robot, [path for paths in by_use.values() for path in paths])
    records = read_records(by_use, source, progress)
    result = identify_records(records["sliding"], records["presliding"], source, progress)
    checks = []
    assumed = result.assumed_bristles
    elements = result.friction.elements
    for record in records["validation"]:
        progress(record.source.name)
        check = validate(
            source, elements, record, tolerances, assumed_bristles=assumed, sliding=result.sliding
        )
        checks.append(check)
    used = tuple((use, record.bag) for use, some in records.items() for record in some)
    alarms = (*log_alarms(records), *result.alarms)
    return replace(result, bags=used, validations=tuple(checks), alarms=alarms)


def check_friction(
    friction: Path | str,
    bags: Sequence[Path | str],
    robot: RobotOptions = SHIPPED_ROBOT,
    tolerances: GivenTolerances = NO_TOLERANCES,
    progress: Progress = lambda _: None,
) -> tuple[Validation, ...]:
    """Compare the torques that a friction file predicts along recorded motions with the recorded ones.

    The rest of the arm (links, rotors, coupling, spring) is as `robot` describes it. Offsets in the file's `joints` are
    added; rotors and springs in it replace those of `robot`.

    Args:
        friction: the file's path, or the name of a shipped one; its elements are the arm's.
        bags: one or more runs, none of them twice.
        robot: that the bags come from; by default this project's.
        tolerances: what counts as agreement, by name. By default 10 % of the torque of all joints together and 30 % of
            each joint's, for a bag with set-points of this project's controller 5 %.
        progress: called twice for each bag, before it is read and before it is compared.

    Returns:
        A comparison for each bag; `passed` is its verdict.

    Raises:
        IdentificationError: for bags, elements or options that contradict each other.
        BagError: for a bag that cannot be read.
        ConfigError: for a file that cannot be used.
    """
    by_use = {"validation": [Path(bag) for bag in bags]}
    if not bags:
        raise IdentificationError("no bag to hold the friction against; accepted: bags of the arm")
    check_given_once(by_use)
    source = RecordedRobot.load(robot, by_use["validation"], follow=True)
    where = str(resolve_config(str(friction)))
    file = FrictionFile.read(Path(where))
    elements, arm = with_friction(source.arm, file, where, "a validation by recorded torques")
    source = replace(source, arm=arm)
    currents = (file.identification or {}).get("unit") == "A"
    records = read_records(by_use, source, progress, currents=currents)["validation"]
    if currents and any(record.unit == "Nm" for record in records):
        raise IdentificationError(
            f"{where}: its torques are in A; accepted: bags with efforts in A"
        )
    bandwidths = _bandwidths(file, where)
    assumed = _bristles_assumed(file)
    checks = []
    for record in records:
        progress(record.source.name)
        check = validate(
            source, elements, record, tolerances, assumed_bristles=assumed, bandwidths=bandwidths
        )
        notes = recording_notes([record], validation_bandwidths(record, bandwidths))
        checks.append(replace(check, notes=notes))
    return tuple(checks)


def _bristles_assumed(file: FrictionFile) -> bool:
    """Return whether the file says of c0 or c1 of an element that they were not identified."""
    parameters = (file.identification or {}).get("parameters")
    elements = parameters.values() if isinstance(parameters, Mapping) else []
    return any(
        element.get(name, {}).get("identifiable") is False
        for element in elements
        if isinstance(element, Mapping)
        for name in PRESLIDING
    )


def with_friction(
    arm: RigidArm, file: FrictionFile, where: str, use: str
) -> tuple[tuple[FrictionElement, ...], RigidArm]:
    """Return a friction file's elements in the arm's order, and the arm with what the file states of its joints.

    Args:
        arm: without friction.
        file: its elements are the arm's.
        where: name of the file, for a refusal.
        use: purpose, in words, for a refusal: it supports no parts of the friction but bristles.
    """
    names = arm.element_names
    elements = file.select(names, where)
    for name in file.elements.entries:
        if name not in names:
            reason = f"element {quoted(name)} is none of this arm; accepted: {', '.join(names)}"
            raise IdentificationError(f"{where}: {reason}")
    parts = file.elements.entries
    refuse_parts(parts, use, f"{where}: elements.", held=("bristles",))
    try:
        return elements, arm.with_joints(file.joints.entries)
    except IdentificationError as error:
        raise IdentificationError(f"{where}: {error}") from error


def _bandwidths(file: FrictionFile, where: str) -> Bandwidths | None:
    """Return the bandwidths of the runs that a friction file was identified from; None if it does not state them."""
    found = (file.identification or {}).get("bandwidths")
    if found is None:
        return None
    values = (
        [found.get(name) for name in ("position", "torque")] if isinstance(found, Mapping) else []
    )
    numbers = [
        float(one) for one in values if isinstance(one, float | int) and 0.0 < one < math.inf
    ]
    if len(numbers) != 2:
        raise IdentificationError(
            f"{where}: identification.bandwidths is {plain(str(found))}; accepted: position and torque above 0 Hz"
        )
    return Bandwidths(*numbers)


def check_given_once(bags: Mapping[str, Sequence[Path]]) -> None:
    """Refuse a bag that is given twice for the same use."""
    for use, paths in bags.items():
        for bag in paths:
            if sum(other.resolve() == bag.resolve() for other in paths) > 1:
                raise IdentificationError(
                    f"{bag}: given twice for --{use}; accepted: each bag once"
                )


def read_records(
    bags: Mapping[str, Sequence[Path]],
    robot: RecordedRobot,
    progress: Progress,
    *,
    currents: bool = False,
) -> dict[str, list[JointRecord]]:
    """Return the records of bags by use; all are read before anything is fitted, so that a bad one is refused early.

    Args:
        bags: by use, such as sliding or validation; no bag twice for the same use.
        robot: that the bags come from.
        progress: called with the name of each bag before it is read.
        currents: whether efforts in A without torque constants are taken as they are, in all bags or in none.
    """
    layouts = [
        (use, path, robot.layout(path, fast=use != "sliding"))
        for use, paths in bags.items()
        for path in paths
    ]
    records: dict[str, list[JointRecord]] = {use: [] for use in bags}
    for use, path, layout in layouts:
        progress(path.name)
        record = read_record(path, layout, _RATES[use], currents=currents).of_joints(
            robot.arm.names
        )
        _check_motion(record, robot.arm, still=use not in ("excitation", "validation"))
        records[use].append(record)
    units = {record.unit: record.source for some in records.values() for record in some}
    if len(units) > 1:
        raise IdentificationError(
            f"{units['A']}: its efforts are in A, those of {units['Nm']} in Nm; accepted: one unit"
        )
    used = [record for use, some in records.items() if use != "validation" for record in some]
    for record in records["validation"]:
        _check_unseen(record, used)
    return records


def _check_motion(record: JointRecord, arm: RigidArm, *, still: bool) -> None:
    """Refuse motions beyond the description, which are in another unit, and runs in which no joint moves."""
    where = record.source
    if not still and np.ptp(record.position, axis=0).max() < _LEAST_TRAVEL:
        raise IdentificationError(
            f"{where}: no joint moves; accepted: runs in which the joints move"
        )
    speeds = np.quantile(np.abs(record.velocity), 0.99, axis=0)
    travels = np.ptp(record.position, axis=0)
    limits = zip(record.names, travels, arm.ranges(), speeds, arm.speeds(), strict=True)
    for name, travel, width, speed, fastest in limits:
        if 0.0 < _MAX_TRAVEL_SHARE * width < travel:
            raise IdentificationError(
                f"{where}: {name} moves through {travel:.3g} rad, in its URDF through {width:.3g} rad at most, which "
                "looks like deg or angles of the motor; accepted: angles of the joints in rad, or of the motors with "
                "their --gear"
            )
        if 0.0 < _MAX_SPEED_SHARE * fastest < speed:
            raise IdentificationError(
                f"{where}: {name} moves at {speed:.3g} rad/s, by its URDF at {fastest:.3g} rad/s at most, which looks "
                "like a time in another unit; accepted: s, rad and rad/s"
            )


def _check_unseen(record: JointRecord, used: Sequence[JointRecord]) -> None:
    """Refuse a validation bag that shares a part with a bag of the identification, whatever their names and stamps."""
    for other in used:
        shared = 1.0 if record.sha256 == other.sha256 else 0.0
        if not shared and record.content is not None and other.content is not None:
            shared = record.content.shared(other.content)
        if shared > _MAX_SHARED:
            name = "" if other.source == record.source else f" as {other.source}"
            part = "" if shared > 0.999 else f"{shared:.0%} of its motion "
            raise IdentificationError(
                f"{record.source}: {part}also used for the identification{name}; accepted: another bag for the "
                "validation"
            )


def identify_records(
    sliding: Sequence[JointRecord],
    presliding: Sequence[JointRecord],
    robot: RecordedRobot,
    progress: Progress = lambda _: None,
) -> FrictionIdentification:
    """Identify the friction of all elements of an arm from records.

    Args:
        sliding: sweeps at constant velocity.
        presliding: micro-oscillations; without any, c0 and c1 are not identifiable.
        robot: rigid-body model and fallback values.
        progress: called with the name of each step before it.

    Returns:
        The result, without bags and validations.
    """
    arm = robot.arm
    fallback = robot.fallback or (None,) * len(arm.element_names)
    progress("sliding regime")
    slides = identify_sliding(sliding, arm, zero=robot.zero)
    named = dict(zip(arm.element_names, slides.estimates, strict=True))
    least = least_coulomb(named, robot.fallback)
    progress("presliding regime")
    if presliding:
        # The sliding regime of an element does not depend on its c0 and c1.
        bristles = {"c0": ParameterEstimate(1e4, 0.0), "c1": ParameterEstimate(0.0, 0.0)}
        pairs = zip(slides.estimates, fallback, strict=True)
        known = [_element(estimate, bristles, other, least) for estimate, other in pairs]
        cycles = identify_presliding(presliding, arm, known)
    else:
        reason = "no bag with micro-oscillations was given"
        count = len(arm.element_names)
        cycles = PreslidingFit((unknown_estimates(PRESLIDING, reason),) * count, ((),) * count)
    swept = tuple(record.bag for record in sliding)
    elements = []
    for first, second, bags, other in zip(
        slides.estimates, cycles.estimates, cycles.sources, fallback, strict=True
    ):
        element = _element(first, second, other, least)
        if other is None:
            element = with_passive_fading(element, None)
        sources = dict.fromkeys(first, swept) | dict.fromkeys(second, bags)
        elements.append(IdentifiedElement(element, {**first, **second}, sources))
    return FrictionIdentification(
        robot=robot,
        elements=tuple(elements),
        sliding=slides,
        presliding=cycles,
        alarms=slides.alarms,
    )


# Without effect while tau_s = tau_c, or where there is no viscous friction.
_NEUTRAL = {"omega_s": 0.1, "delta": 1.0, "c2": 0.0, "alpha": 1.0}


def _element(
    sliding: Estimates,
    presliding: Estimates,
    fallback: FrictionElement | None,
    least: float,
) -> FrictionElement:
    """Return the element; what is not identifiable comes from the fallback, or is assumed.

    Without a fallback tau_s is tau_c, bristles break away after PRESLIDING_DISTANCE, and an unknown Coulomb torque is
    the `least` of the other elements, as after excitation runs.
    """
    estimates = {**sliding, **presliding}
    values = dict(_NEUTRAL)
    if fallback is not None:
        values |= fallback.parameters
        values["alpha"] = 1.0
    values |= {
        name: estimate.value for name, estimate in estimates.items() if estimate.identifiable
    }
    for sign in SIGNS:
        coulomb = values.setdefault(f"tau_c_{sign}", least)
        values[f"tau_s_{sign}"] = max(values.get(f"tau_s_{sign}", 0.0), coulomb)
    mean = 0.5 * (values["tau_c_positive"] + values["tau_c_negative"])
    values.setdefault("c0", mean / PRESLIDING_DISTANCE)
    values.setdefault("c1", RELAXATION * values["c0"])
    return FrictionElement.of(values)
