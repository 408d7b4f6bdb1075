"""From bags of excitation runs to an arm's dynamics, for Python users and the command alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.bandwidths import choose_bandwidths
from rx90_emulator.identification.excitation.checks import check_signs, check_zeros
from rx90_emulator.identification.excitation.choice import stages
from rx90_emulator.identification.excitation.consistency import Consistency, make_consistent, written_arm
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.excitation.friction import (
    ALL_PARTS,
    WITHOUT_BRISTLES,
    identify_friction_parts,
    predicted_torque,
)
from rx90_emulator.identification.excitation.instruments import check_closed_loop
from rx90_emulator.identification.excitation.known_payload import (
    DriveGains,
    LoadParts,
    identify_gains,
    identify_load_parts,
)
from rx90_emulator.identification.excitation.law import Part
from rx90_emulator.identification.excitation.payload import Payload, payloads_of
from rx90_emulator.identification.excitation.problem import ExcitationProblem, described_inertials
from rx90_emulator.identification.excitation.recording import recording_notes, short_note, without_shocks
from rx90_emulator.identification.excitation.result import (
    ExcitationIdentification,
    base_parameters,
    simulated_elements,
)
from rx90_emulator.identification.excitation.torques import TorqueValidation, run_torques, trends
from rx90_emulator.identification.identify import check_given_once, read_records
from rx90_emulator.identification.options import ExcitationTolerances, RobotOptions, model_parts
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.robot import BagLayout, RecordedRobot
from rx90_emulator.identification.validation.prediction import recorded_equations, validation_bandwidths, written_torque

_NO_PAYLOADS: Mapping[str, Payload] = MappingProxyType({})
_DEFAULT_ROBOT = RobotOptions()
_DEFAULT_TOLERANCES = ExcitationTolerances()


def identify_excitation(
    bags: Sequence[Path | str],
    robot: RobotOptions = _DEFAULT_ROBOT,
    validation: Sequence[Path | str] = (),
    tolerances: ExcitationTolerances = _DEFAULT_TOLERANCES,
    *,
    bristles: bool = False,
    model: Sequence[str] | None = None,
    payloads: Mapping[str, Payload] = _NO_PAYLOADS,
    load_part: bool = False,
    rotors: bool = True,
    prior: float | None = None,
    bandwidth: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ExcitationIdentification:
    """Identify the dynamics of an arm from runs in which all joints move, without plateaus of constant velocity.

    Links, rotors, springs and offsets are unknown; of the robot's description the kinematics are taken.

    Args:
        bags: one or more excitation runs.
        robot: that they come from; by default this project's.
        validation: runs to predict, which are not used.
        tolerances: what counts as agreement with them.
        bristles: whether bristles along the motion are tried also where neither a Stribeck rise nor the rows of
            reversals ask for them; a trial takes some times as long as all other parts.
        model: parts that all elements have, without a choice: "coulomb-viscous", which all have, and the names in
            `options.MODEL_PARTS`; by default what predicts better is chosen. Only a part that ends at a bound goes.
        payloads: known bodies at the last link, by name or path of the bag; runs that are not named carry none. Runs
            with and without one tell the drive gains.
        load_part: whether they tell load parts of the friction in place of the gains, which then count as right.
        rotors: whether the recorded torques hold those of the rotors; those of sensors between gear and link do not.
        prior: relative standard deviation of the description's inertials, where they are to count; by default they do
            not, but for what no run tells.
        bandwidth: of the low-pass of the positions, Hz; the torque gets a third. By default the widest of a few that
            predicts as well as the best of them (`bandwidths.choose_bandwidths`).
        progress: called with the name of each step before it, `count_steps` times.

    Returns:
        Base parameters and friction with standard deviations, how well they fit, and a verdict for each validation run.

    Raises:
        IdentificationError: for bags or options that do not fit each other, and data that do not suffice.
        BagError: for a bag that cannot be read.
        ConfigError: for a file of the robot that cannot be used.
    """
    by_use = {"excitation": [Path(bag) for bag in bags], "validation": [Path(bag) for bag in validation]}
    everything = [*by_use["excitation"], *by_use["validation"]]
    if not by_use["excitation"]:
        raise IdentificationError("no excitation run; accepted: --excitation BAG ...")
    check_given_once(by_use)
    parts, fixed = _asked(bristles, model)
    carried = payloads_of(everything, payloads)
    if robot.torque_delay:
        raise IdentificationError(
            f"--torque-delay {robot.torque_delay:g} with --excitation; accepted: 0, torques count at their stamps"
        )
    _check_rotors(robot, rotors=rotors)
    source = RecordedRobot.load(robot, everything, massless=True, follow=True)
    records = read_records(by_use, source, progress, currents=True)
    progress("filters and equations")
    records, notes = _shocks_left_out(records, source)

    def equations(some: Sequence[JointRecord], bandwidths: Bandwidths) -> ExcitationProblem:
        return recorded_equations(some, source, bandwidths, carried, rotors=rotors)

    bandwidths, problem = choose_bandwidths(records["excitation"], equations, bandwidth)
    notes = (*notes, *recording_notes(records["excitation"], bandwidths), *short_note(problem), *_held_note(source))
    check_signs(problem, replace(source.options, gear=_gears(source.layout(everything[0], fast=True), source)))
    zeros = check_zeros(problem, source.zero)
    known = None if prior is None else described_inertials(problem.columns, problem.base, prior)
    gains: DriveGains | None = None
    loads: LoadParts | None = None
    if load_part:
        progress("load parts")
        loads = identify_load_parts(problem, parts, progress, fixed=fixed)
    elif np.any(problem.payload):
        progress("drive gains")
        gains = identify_gains(problem, parts, progress, fixed=fixed)
    changes = [one.applied for one in (gains, loads) if one is not None]
    for change in changes:
        problem = change(problem)
    progress("friction")
    friction = identify_friction_parts(problem, parts, known, progress, fixed=fixed)
    progress("instrumental variables")
    closed_loop, friction = check_closed_loop(problem, friction, known)
    said = [closed_loop.remark, *([] if loads is None else [loads.remark(problem.arm.element_names)])]
    friction = replace(friction, remarks=(*friction.remarks, *said))
    progress("consistent inertias")
    consistency = make_consistent(problem, friction, source, robot)
    elements = simulated_elements(friction.elements, source.fallback, loads)
    written = written_arm(problem, consistency)
    checks = []
    for record in records["validation"]:
        progress(record.source.name)
        other = equations([record], validation_bandwidths(record, bandwidths))
        for change in changes:
            other = change(other)
        by_files = written_torque(other, written, [one.element for one in elements])
        checks.append(_unseen(other, predicted_torque(friction, other), consistency, by_files, tolerances))
    torques = run_torques(problem, friction.predicted)
    return ExcitationIdentification(
        robot=source,
        options=robot,
        problem=problem,
        friction=friction,
        elements=elements,
        base=base_parameters(problem, friction, consistency, closed_loop),
        consistency=consistency,
        torques=torques,
        validations=tuple(checks),
        trends=trends(torques, friction.blocks.length),
        instruments=closed_loop,
        zeros=zeros,
        gains=gains,
        loads=loads,
        notes=notes,
        bags=tuple((use, record.bag) for use, some in records.items() for record in some),
    )


def _shocks_left_out(
    records: Mapping[str, Sequence[JointRecord]], robot: RecordedRobot
) -> tuple[dict[str, list[JointRecord]], tuple[str, ...]]:
    """Return the records of each use with the times of their shocks, and in words what was found."""
    found = {use: [without_shocks(one, robot.arm.element_matrix) for one in some] for use, some in records.items()}
    texts = tuple(text for pairs in found.values() for _, said in pairs for text in said)
    return {use: [record for record, _ in pairs] for use, pairs in found.items()}, texts


def _held_note(robot: RecordedRobot) -> tuple[str, ...]:
    """Return a warning where joints are held at 0 of which a log of motors has the motion."""
    if not robot.held:
        return ()
    return (f"warning: held at 0, though the log has them, for their gears are not known: {', '.join(robot.held)}",)


def count_steps(
    bags: int,
    validation: int,
    *,
    bristles: bool = False,
    model: Sequence[str] | None = None,
    payloads: bool = False,
) -> int:
    """Return how often `identify_excitation` calls `progress` for so many bags and validation runs."""
    choices = 1 + payloads  # of the friction's parts: known payloads take one for the drive gains or load parts
    return bags + 2 * validation + 3 + choices * (1 + stages(*_asked(bristles, model)))


def _asked(bristles: bool, model: Sequence[str] | None) -> tuple[tuple[Part, ...], bool]:
    """Return the parts of the friction to try or to give to all elements, and whether it is the latter."""
    if model is not None:
        if bristles:
            raise IdentificationError("--bristles with --model; accepted: --model with bristle among its parts")
        return tuple(Part.named(name) for name in model_parts(model)), True
    return ALL_PARTS if bristles else WITHOUT_BRISTLES, False


def _check_rotors(robot: RobotOptions, *, rotors: bool) -> None:
    """Refuse a model without rotors for an arm whose drives' torques move them."""
    if not rotors and (robot.urdf is None or robot.rotor_inertia is not None):
        given = "without --urdf" if robot.urdf is None else "with --rotor-inertia"
        raise IdentificationError(f"--no-rotors {given}; accepted: with --urdf, for torques measured behind the gears")


def _unseen(
    problem: ExcitationProblem,
    predicted: Array,
    consistency: Consistency,
    files: Array,
    limits: ExcitationTolerances,
) -> TorqueValidation:
    """Return the verdict of a run by three predictions of its r rows: identified, with consistent bodies, by files."""
    kinds = predicted, predicted + problem.regressor @ consistency.inertias.shift, files
    identified, consistent, written = (run_torques(problem, torque)[0] for torque in kinds)
    return TorqueValidation(identified, consistent, limits, written)


def _gears(layout: BagLayout, robot: RecordedRobot) -> list[float] | None:
    """Return the gear of each motor, given or this project's robot's; None where messages hold the joints' states."""
    if layout.turns is None:
        return None
    largest = np.argmax(np.abs(robot.arm.coupling), axis=1)[:, None]
    gears = (np.take_along_axis(values, largest, 1)[:, 0] for values in (layout.turns, robot.arm.coupling))
    return (next(gears) / next(gears)).tolist()  # type: ignore[no-any-return]
