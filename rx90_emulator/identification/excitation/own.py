"""What an identification of one's own is built on: regressor, equations of recorded runs, torques by given files.

columns = rx.regressor(rx.RigidArm.from_urdf("arm.urdf"), position, velocity, acceleration)
problem = rx.excitation_problem(["run.csv"], rx.RobotOptions(urdf="arm.urdf"))
torque = rx.predict_torque("friction.yaml", time, position, robot=rx.RobotOptions(urdf="arm.urdf"))
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.filtering import Bandwidths
from rx90_emulator.identification.excitation.problem import BaseGroups, ExcitationProblem, StandardColumns
from rx90_emulator.identification.identify import check_given_once, read_records, with_friction
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.validation.prediction import drive_torque, recorded_equations

_DEFAULT_ROBOT = RobotOptions()


@dataclass(frozen=True, eq=False)
class Regressor:
    """The torque of an arm without friction per unit of each base parameter along a motion.

    Attributes:
        values: Nm per unit of the parameter, shape (m, n, b): torque = values @ parameters.
        base: the b base parameters; `base.names`, `base.groups` and `base.combination` say what they are made of.
        described: their values by the arm's description, SI units, shape (b,); of offsets 0.
    """

    values: Array
    base: BaseGroups
    described: Array


def regressor(arm: RigidArm, position: ArrayLike, velocity: ArrayLike, acceleration: ArrayLike) -> Regressor:
    """Return the columns that the rigid-body torque is linear in: links, rotors, springs and offsets, grouped.

    Base parameters are the combinations of inertial parameters that the torque depends on (Gautier 1991).

    Args:
        arm: of n joints; `RigidArm.from_urdf(file)` or `RigidArm.from_setup(setup)`.
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n).
        acceleration: rad/s^2, shape (m, n).

    Raises:
        IdentificationError: for arrays of another shape.
    """
    motion = tuple(np.asarray(values, dtype=np.float64) for values in (position, velocity, acceleration))
    for name, values in zip(("position", "velocity", "acceleration"), motion, strict=True):
        if values.ndim != 2 or values.shape != (len(motion[0]), len(arm.names)):
            raise IdentificationError(f"{name} has shape {values.shape}; accepted: (m, {len(arm.names)}), all the same")
    columns = StandardColumns(arm)
    base = BaseGroups.of(columns)
    values = columns.torque(*motion)[:, :, list(base.leading)]
    return Regressor(values, base, base.combination @ columns.values())


def excitation_problem(
    bags: Sequence[Path | str], robot: RobotOptions = _DEFAULT_ROBOT, bandwidths: Bandwidths | None = None
) -> ExcitationProblem:
    """Return the equations of recorded runs, as `identify_excitation` begins with: filtered torque, regressor, rows.

    Shocks are not left out here, and the bandwidths of the spectra are not checked against prediction.
    `identify_friction_parts(problem, parts=())` fits the simplest friction to them, other parts by name more.

    Args:
        bags: bags or tables.
        robot: that they come from; by default this project's.
        bandwidths: of the filters; by default those that the runs' spectra ask for. Those of `identify_excitation` are
            `result.problem.runs[0].bandwidths`.

    Raises:
        IdentificationError: for runs that do not fit or in which no joint moves.
        BagError: for a bag that cannot be read.
    """
    paths = {"excitation": [Path(bag) for bag in bags], "validation": []}
    if not bags:
        raise IdentificationError("no excitation run; accepted: one or more")
    check_given_once(paths)
    source = RecordedRobot.load(robot, paths["excitation"], massless=True, follow=True)
    records = read_records(paths, source, lambda _: None, currents=True)["excitation"]
    return recorded_equations(records, source, bandwidths or Bandwidths.of(records))


def predict_torque(
    friction: FrictionFile | Path | str,
    time: ArrayLike,
    position: ArrayLike,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    *,
    robot: RobotOptions = _DEFAULT_ROBOT,
) -> Array:
    """Return the torque that the drives give at the joints along a motion, by a friction file and an arm's description.

    As in `check_friction`, offsets in the file's `joints` are added, and rotors and springs there take the place of the
    robot's.

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
        IdentificationError: for times that are not even, arrays of another shape, and a file of another arm.
        ConfigError: for a file that cannot be used.
    """
    arm, at, angle = RecordedRobot.load(robot).arm, np.asarray(time, dtype=np.float64), np.asarray(position, np.float64)
    if at.ndim != 1 or len(at) < 3 or not np.allclose(np.diff(at), at[1] - at[0], rtol=1e-3) or at[1] <= at[0]:
        raise IdentificationError(f"time has shape {at.shape}; accepted: three or more even, increasing times")
    speed = np.gradient(angle, at, axis=0) if velocity is None else np.asarray(velocity, dtype=np.float64)
    change = np.gradient(speed, at, axis=0) if acceleration is None else np.asarray(acceleration, dtype=np.float64)
    for name, values in (("position", angle), ("velocity", speed), ("acceleration", change)):
        if values.shape != (len(at), len(arm.names)):
            raise IdentificationError(f"{name} has shape {values.shape}; accepted: ({len(at)}, {len(arm.names)})")
    _, elements, held = with_friction(arm, friction, "a prediction of torques")
    return drive_torque(held, elements, (angle, speed, change), float(at[1] - at[0]))
