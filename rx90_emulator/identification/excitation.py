"""From bags of excitation runs to an arm's dynamics, for Python users and the command alike.

Beside `identify_excitation`, the building blocks of an own identification: regressor, equations, torques by files.

columns = rx.regressor(rx.RigidArm.from_urdf("arm.urdf"), position, velocity, acceleration)
problem = rx.excitation_problem(["run.csv"], rx.RobotOptions(urdf="arm.urdf"))
torque = rx.predict_torque("friction.yaml", time, position, robot=rx.RobotOptions(urdf="arm.urdf"))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.base.share import resolve_config
from rx90_common.friction.friction_file import FrictionFile
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
from rx90_emulator.identification.identify import check_given_once, read_records, with_friction
from rx90_emulator.identification.options import (
    NO_TOLERANCES,
    RECORDED,
    SHIPPED_ROBOT,
    GivenTolerances,
    Progress,
    RobotOptions,
    ValidationTolerances,
)
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.result import ExcitationIdentification, base_parameters
from rx90_emulator.identification.robot import BagLayout, RecordedRobot
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import Bandwidths, recording_notes
from rx90_emulator.identification.rows.rigid import BaseGroups, StandardColumns
from rx90_emulator.identification.sanity import (
    Recorded,
    alarms,
    body_alarms,
    log_alarms,
    moved_bodies,
)
from rx90_emulator.identification.validation.prediction import (
    Validation,
    drive_torque,
    filtered_runs,
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
    progress: Progress = lambda _: None,
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
    if not bags:
        raise IdentificationError("no excitation run; accepted: bags of such runs, or their folder")
    parts = TRIED if model is None else model_parts(model)
    # Torques of the drives accelerate the rotors.
    if not rotors and (robot.urdf is None or robot.rotor_inertia is not None):
        given = "without --urdf" if robot.urdf is None else "with --rotor-inertia"
        raise IdentificationError(
            f"--no-rotors {given}; accepted: with --urdf, for torques measured behind the gears"
        )
    source, records = _recorded(robot, bags, validation, progress, currents=True)
    used = records["excitation"]
    progress("filters and equations")
    bandwidths = Bandwidths.of(used, bandwidth)
    runs = filtered_runs(used, source, bandwidths)
    problem = ExcitationProblem.of(source.arm, runs, rotors=rotors)
    notes = (
        *recording_notes(used, bandwidths),
        *log_warnings(problem, source.held),
    )
    stated_gears = replace(
        source.options, gear=_gears(source.layout(Path(bags[0]), fast=True), source)
    )
    sanity = alarms(source.arm, Recorded.of(used, source.arm), stated_gears, source.zero)
    progress("friction")
    fitted = fit_arm(problem, parts, fixed=model is not None)
    progress("consistent inertias")
    consistency = make_consistent(problem, fitted, source, robot)
    arm = written_arm(problem, consistency)
    bodies = moved_bodies(source.arm, arm)
    motion = Bandwidths.of_motion(used)
    compared = Bandwidths(bandwidths.position, min(motion.torque, bandwidths.torque))
    stated = problem.other(filtered_runs(used, source, compared))
    result = ExcitationIdentification(
        robot=source,
        problem=problem,
        fitted=fitted,
        elements=identified_elements(fitted, source.fallback, tuple(record.bag for record in used)),
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


def _recorded(
    robot: RobotOptions,
    bags: Sequence[Path | str],
    validation: Sequence[Path | str] = (),
    progress: Progress = lambda _: None,
    *,
    currents: bool = False,
) -> tuple[RecordedRobot, dict[str, list[JointRecord]]]:
    """Return the robot of excitation runs and of those for the validation, and their records by use."""
    by_use = {
        "excitation": [Path(bag) for bag in bags],
        "validation": [Path(bag) for bag in validation],
    }
    check_given_once(by_use)
    logs = [*by_use["excitation"], *by_use["validation"]]
    source = RecordedRobot.load(robot, logs, massless=True, follow=True)
    return source, read_records(by_use, source, progress, currents=currents)


def _validation(
    result: ExcitationIdentification,
    arm: RigidArm,
    simplest: FittedArm,
    record: JointRecord,
    tolerances: ValidationTolerances,
) -> Validation:
    """Return the verdict of a run that the identification did not use, all predictions on the same rows."""
    bandwidths = validation_bandwidths(record, result.compared)
    unseen = result.problem.other(filtered_runs([record], result.robot, bandwidths))

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


def _gears(layout: BagLayout, robot: RecordedRobot) -> Sequence[float] | None:
    """Return the gear of each motor, given or this project's; None where messages contain the joints' states."""
    if layout.turns is None or robot.options.gear is not None or robot.setup is None:
        return robot.options.gear
    return tuple(float(value) for value in robot.setup.drives.gear)


class Regressor(NamedTuple):
    """The torque of an arm without friction per unit of each base parameter along a motion.

    Attributes:
        values: Nm per unit of the parameter, shape (m, n, b): torque = values @ parameters.
        base: the b base parameters; `base.names`, `base.groups` and `base.combination` describe their composition.
        described: their values by the arm's description, SI units, shape (b,); 0 for offsets.
    """

    values: Array
    base: BaseGroups
    described: Array


def regressor(
    arm: RigidArm, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> Regressor:
    """Return the columns that the rigid-body torque is linear in, for base parameters of the whole arm.

    Base parameters are the combinations of inertial parameters that the torque depends on (Gautier 1991).

    Args:
        arm: of n joints; `RigidArm.from_urdf(file)` or `RigidArm.from_setup(setup)`.
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n).
        acceleration: rad/s^2, shape (m, n).

    Raises:
        IdentificationError: for arrays of another shape.
    """
    motion = _motion(arm, position, velocity, acceleration)
    columns = StandardColumns(arm)
    base = BaseGroups.of(columns)
    values = columns.torque(*motion)[:, :, list(base.leading)]
    return Regressor(values, base, base.combination @ columns.values())


def _motion(
    arm: RigidArm, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike
) -> tuple[Array, Array, Array]:
    """Return a motion as arrays, after a check of their shapes."""
    q = np.asarray(position, np.float64)
    v = np.asarray(velocity, np.float64)
    a = np.asarray(acceleration, np.float64)
    for name, values in (("position", q), ("velocity", v), ("acceleration", a)):
        if values.ndim != 2 or values.shape != (len(q), len(arm.names)):
            raise IdentificationError(
                f"{name} has shape {values.shape}; accepted: (m, {len(arm.names)}), all the same"
            )
    return q, v, a


def excitation_problem(
    bags: Sequence[Path | str],
    robot: RobotOptions = SHIPPED_ROBOT,
    bandwidths: Bandwidths | None = None,
) -> ExcitationProblem:
    """Return the equations of recorded runs, the first step of `identify_excitation`: filtered torque, regressor, rows.

    Args:
        bags: bags or tables.
        robot: that the bags come from; by default this project's.
        bandwidths: of the filters; by default the widest with clean accelerations. Those of `identify_excitation` are
            `result.problem.runs[0].bandwidths`.

    Raises:
        IdentificationError: for runs that do not belong to the robot or in which no joint moves.
        BagError: for a bag that cannot be read.
    """
    if not bags:
        raise IdentificationError("no excitation run; accepted: one or more")
    source, by_use = _recorded(robot, bags)
    records = by_use["excitation"]
    runs = filtered_runs(records, source, bandwidths or Bandwidths.of(records))
    return ExcitationProblem.of(source.arm, runs)


def predict_torque(
    friction: FrictionFile | Path | str,
    time: ArrayLike,
    position: ArrayLike,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    *,
    robot: RobotOptions = SHIPPED_ROBOT,
) -> Array:
    """Return the drive torque at the joints along a motion, by a friction file and an arm's description.

    As in `check_friction`, offsets in the file's `joints` are added, and rotors and springs in it replace the robot's.

    Args:
        friction: the file, by its content, its path or the name of a shipped one; its elements are the arm's, and
            bristles begin undeflected.
        time: s, even, shape (m,).
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n); by default differences of the positions.
        acceleration: rad/s^2, shape (m, n); by default differences of the velocities.
        robot: links, rotors, coupling and spring; by default this project's robot.

    Returns:
        Nm, shape (m, n).

    Raises:
        IdentificationError: for uneven times, arrays of another shape, and a file of another arm.
        ConfigError: for a file that cannot be used.
    """
    at = np.asarray(time, dtype=np.float64)
    even = at.ndim == 1 and len(at) > 2 and np.allclose(np.diff(at), at[1] - at[0], rtol=1e-3)
    if not even or at[1] <= at[0]:
        raise IdentificationError(
            f"time has shape {at.shape}; accepted: three or more even, increasing times"
        )
    angle = np.asarray(position, dtype=np.float64)
    if angle.shape[:1] != at.shape:
        raise IdentificationError(f"position has shape {angle.shape}; accepted: {len(at)} rows")
    speed = np.gradient(angle, at, axis=0) if velocity is None else velocity
    change = np.gradient(speed, at, axis=0) if acceleration is None else acceleration
    arm = RecordedRobot.load(robot).arm
    motion = _motion(arm, angle, speed, change)
    file = friction
    where = "friction"
    if not isinstance(file, FrictionFile):
        where = str(resolve_config(str(file)))
        file = FrictionFile.read(Path(where))
    elements, held = with_friction(arm, file, where, "a prediction of torques")
    return drive_torque(held, elements, motion, float(at[1] - at[0]))
