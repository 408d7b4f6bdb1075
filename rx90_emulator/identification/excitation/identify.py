"""From bags of excitation runs to an arm's dynamics, for Python users and the command alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from rx90_common.bags.mapping import is_table
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.excitation.checks import check_signs, check_zeros
from rx90_emulator.identification.excitation.choice import stages
from rx90_emulator.identification.excitation.filtering import Bandwidths, FilteredRun, filter_record
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
from rx90_emulator.identification.excitation.physical import make_consistent
from rx90_emulator.identification.excitation.problem import ExcitationProblem, described_inertials
from rx90_emulator.identification.excitation.result import (
    ExcitationIdentification,
    TorqueValidation,
    base_parameters,
    run_torques,
    simulated_elements,
    trends,
)
from rx90_emulator.identification.identify import check_given_once, read_records
from rx90_emulator.identification.options import ExcitationTolerances, RobotOptions, model_parts
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.robot import BagLayout, RecordedRobot, topic_names

_REFERENCE = "rx90_controller/reference"
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
    prior: float | None = None,
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
        prior: relative standard deviation of the description's inertials, where they are to count; by default they do
            not, but for what no run tells.
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
    source = RecordedRobot.load(robot, everything, massless=True)
    records = read_records(by_use, source, progress)
    progress("filters and equations")
    bandwidths = Bandwidths.of(records["excitation"])

    def equations(some: Sequence[JointRecord]) -> ExcitationProblem:
        runs = [run for record in some for run in _filtered(record, source, bandwidths)]
        return ExcitationProblem.of(source.arm, runs, [carried[run.source.path] for run in runs])

    problem = equations(records["excitation"])
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
    checks = []
    for record in records["validation"]:
        progress(record.source.name)
        other = equations([record])
        for change in changes:
            other = change(other)
        predicted = predicted_torque(friction, other)
        (identified,) = run_torques(other, predicted)
        (consistent,) = run_torques(other, predicted + other.regressor @ consistency.inertias.shift)
        checks.append(TorqueValidation(identified, consistent, tolerances))
    torques = run_torques(problem, friction.predicted)
    return ExcitationIdentification(
        robot=source,
        options=robot,
        problem=problem,
        friction=friction,
        elements=simulated_elements(friction.elements, source.fallback, loads),
        base=base_parameters(problem, friction, consistency, closed_loop),
        consistency=consistency,
        torques=torques,
        validations=tuple(checks),
        trends=trends(torques, friction.blocks.length),
        instruments=closed_loop,
        zeros=zeros,
        gains=gains,
        loads=loads,
        bags=tuple((use, record.bag) for use, some in records.items() for record in some),
    )


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


def _filtered(record: JointRecord, robot: RecordedRobot, bandwidths: Bandwidths) -> tuple[FilteredRun, ...]:
    """Return the runs of a record; of this project's plant with set-points, which real arms and tables do not have."""
    simulated = not is_table(record.source) and absolute(_REFERENCE) in topic_names(record.source)
    if robot.plant_period is None or not simulated:
        return filter_record(record, bandwidths)
    # A torque of this project's plant is that of the tick that ends at its stamp; a real arm's is not.
    return filter_record(record, bandwidths, _setpoints(record), 0.5 * robot.plant_period)


def _gears(layout: BagLayout, robot: RecordedRobot) -> list[float] | None:
    """Return the gear of each motor, given or this project's robot's; None where messages hold the joints' states."""
    if layout.turns is None:
        return None
    largest = np.argmax(np.abs(robot.arm.coupling), axis=1)[:, None]
    gears = (np.take_along_axis(values, largest, 1)[:, 0] for values in (layout.turns, robot.arm.coupling))
    return (next(gears) / next(gears)).tolist()  # type: ignore[no-any-return]


def _setpoints(record: JointRecord) -> Array | None:
    """Return a simulated bag's set-points at the record's times, shape (m, n); None where they do not cover it."""
    series = read_joint_states(record.source, _REFERENCE, record.names)
    if series.position is None or len(series.time) < 2:
        return None
    # Stamps of averaged motor states end between two set-points.
    step = float(np.median(np.diff(series.time)))
    if series.time[0] > record.time[0] + step or series.time[-1] < record.time[-1] - step:
        return None
    return np.column_stack([np.interp(record.time, series.time, column) for column in series.position.T])
