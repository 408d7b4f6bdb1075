"""From bags of excitation runs to an arm's dynamics, for Python users and the command alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.bodies import make_consistent, written_arm
from rx90_emulator.identification.estimates import model_parts
from rx90_emulator.identification.fitted import (
    TRIED,
    FittedArm,
    fit_arm,
    identified_elements,
    simplest_fit,
)
from rx90_emulator.identification.identify import check_given_once, read_records
from rx90_emulator.identification.options import (
    NO_TOLERANCES,
    RECORDED,
    SHIPPED_ROBOT,
    GivenTolerances,
    RobotOptions,
    ValidationTolerances,
)
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.result import ExcitationIdentification, base_parameters
from rx90_emulator.identification.robot import BagLayout, RecordedRobot
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, recording_notes
from rx90_emulator.identification.sanity import (
    Recorded,
    alarms,
    body_alarms,
    log_alarms,
    moved_bodies,
)
from rx90_emulator.identification.validation.prediction import (
    Validation,
    filtered_runs,
    recorded_equations,
    validation_bandwidths,
    written_torque,
)
from rx90_emulator.identification.validation.verdict import RunTorques, run_torques


def identify_excitation(
    bags: Sequence[Path | str],
    robot: RobotOptions = SHIPPED_ROBOT,
    validation: Sequence[Path | str] = (),
    tolerances: GivenTolerances = NO_TOLERANCES,
    *,
    model: Sequence[str] | None = None,
    rotors: bool = True,
    bandwidth: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> ExcitationIdentification:
    """Identify the dynamics of an arm from runs in which all joints move, without plateaus of constant velocity.

    Links, rotors, springs and offsets are unknown; only the kinematics of the robot's description are used.

    Args:
        bags: one or more excitation runs.
        robot: that the bags come from; by default this project's.
        validation: runs to predict, which the identification does not use.
        tolerances: limits for agreement with them, all or some by name; the others are those of RECORDED.
        model: parts that all elements have, without selection: "coulomb-viscous", which every model contains, and the
            names in `options.MODEL_PARTS`; by default parts are selected by prediction. Only a part that ends at a
            bound is dropped.
        rotors: whether the recorded torques contain those of the rotors; torques of sensors between gear and link do
            not.
        bandwidth: of the low-pass of the positions, Hz; that of the torque is a third of it. By default the widest in
            which the accelerations are clean. Errors are stated in the motion's band.
        progress: called with the name of each step before it.

    Returns:
        Base parameters and friction with standard deviations, how well they fit, and a verdict for each validation run.

    Raises:
        IdentificationError: for bags or options that contradict each other, and for insufficient data.
        BagError: for a bag that cannot be read.
        ConfigError: for a file of the robot that cannot be used.
    """
    by_use = {
        "excitation": [Path(bag) for bag in bags],
        "validation": [Path(bag) for bag in validation],
    }
    everything = [*by_use["excitation"], *by_use["validation"]]
    if not by_use["excitation"]:
        raise IdentificationError("no excitation run; accepted: bags of such runs, or their folder")
    check_given_once(by_use)
    parts = TRIED if model is None else model_parts(model)
    _check_rotors(robot, rotors=rotors)
    source = RecordedRobot.load(robot, everything, massless=True, follow=True)
    records = read_records(by_use, source, progress, currents=True)
    progress("filters and equations")
    bandwidths = Bandwidths.of(records["excitation"], bandwidth)
    problem = recorded_equations(records["excitation"], source, bandwidths, rotors=rotors)
    notes = (
        *recording_notes(records["excitation"], bandwidths),
        *log_warnings(problem, source.held),
    )
    given = replace(source.options, gear=_gears(source.layout(everything[0], fast=True), source))
    sanity = alarms(source.arm, Recorded.of(records["excitation"], source.arm), given, source.zero)
    progress("friction")
    fitted = fit_arm(problem, parts, fixed=model is not None)
    progress("consistent inertias")
    consistency = make_consistent(problem, fitted, source, robot)
    arm = written_arm(problem, consistency)
    bodies = moved_bodies(source.arm, arm)
    motion = Bandwidths.of_motion(records["excitation"])
    compared = motion._replace(
        position=bandwidths.position, torque=min(motion.torque, bandwidths.torque)
    )
    stated = problem.other(
        [run for record in records["excitation"] for run in filtered_runs(record, source, compared)]
    )
    result = ExcitationIdentification(
        robot=source,
        problem=problem,
        fitted=fitted,
        elements=identified_elements(fitted, source.fallback),
        base=base_parameters(problem, fitted, consistency),
        consistency=consistency,
        compared=compared,
        torques=run_torques(stated, fitted.predicted(stated)),
        bodies=bodies,
        alarms=(*log_alarms(records), *sanity, *body_alarms(bodies)),
        notes=notes,
        bags=tuple((use, record.bag) for use, some in records.items() for record in some),
    )
    if not records["validation"]:
        return result
    limits = replace(RECORDED, **tolerances)
    simplest = simplest_fit(problem)
    checks = []
    for record in records["validation"]:
        progress(record.source.name)
        checks.append(_validation(result, arm, simplest, record, limits))
    return replace(result, validations=tuple(checks))


def _validation(
    result: ExcitationIdentification,
    arm: RigidArm,
    simplest: FittedArm,
    record: JointRecord,
    tolerances: ValidationTolerances,
) -> Validation:
    """Return the verdict of a run that the identification did not use, all predictions on the same rows."""
    bandwidths = validation_bandwidths(record, result.compared)
    unseen = result.problem.other(filtered_runs(record, result.robot, bandwidths))

    def torques(predicted: Array) -> RunTorques:
        return run_torques(unseen, predicted)[0]

    files = torques(written_torque(unseen, arm, result.friction.elements))
    return Validation(
        torque=files,
        tolerances=tolerances,
        source=str(record.source),
        alarms=result.alarms,
        assumed_bristles=result.assumed_bristles,
        fitted=torques(result.fitted.predicted(unseen)),
        simplest=torques(simplest.predicted(unseen)),
    )


def log_warnings(problem: ExcitationProblem, held: Sequence[str] = ()) -> list[str]:
    """Return warnings of fewer instants than parameters, which leave no redundancy, and of joints fixed at 0."""
    instants = len(np.unique(problem.sample))
    parameters = problem.parameters
    warnings = []
    if len(problem) <= parameters:
        raise IdentificationError(
            f"{len(problem)} equations ({instants} instants below {problem.runs[0].bandwidths.torque:.3g} Hz) for "
            f"{parameters} parameters; accepted: more than these, from longer runs or a wider --bandwidth"
        )
    if instants < parameters:
        warnings.append(
            f"a short log, {instants} instants for {parameters} parameters: it does not determine single "
            "bodies, which stay near the description's, nor parts of friction beside Coulomb and viscous; deviations "
            "are rough"
        )
    if held:
        text = (
            f"held at 0, though the log has them, for their gears are not known: {', '.join(held)}"
        )
        warnings.append(text)
    return warnings


def _check_rotors(robot: RobotOptions, *, rotors: bool) -> None:
    """Refuse a model without rotors if the drives' torques accelerate them."""
    if not rotors and (robot.urdf is None or robot.rotor_inertia is not None):
        given = "without --urdf" if robot.urdf is None else "with --rotor-inertia"
        raise IdentificationError(
            f"--no-rotors {given}; accepted: with --urdf, for torques measured behind the gears"
        )


def _gears(layout: BagLayout, robot: RecordedRobot) -> Sequence[float] | None:
    """Return the gear of each motor, given or this project's; None where messages contain the joints' states."""
    if layout.turns is None or robot.options.gear is not None or robot.setup is None:
        return robot.options.gear
    return tuple(float(value) for value in robot.setup.drives.gear)
