"""The arm without friction: its rigid-body torques, and the joints that its friction elements act on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, quoted
from rx90_common.description.coupling import sum_name
from rx90_common.description.joint_model import joint_model
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import JointTorques
from rx90_common.rigid_torque import configurations, rigid_torque
from rx90_emulator.loop.setup import Setup


@dataclass(frozen=True, eq=False)
class RigidArm:
    """Rigid-body torques of a serial arm, by Pinocchio, and where friction acts on it.

    Attributes:
        names: n joints, from base to tip.
        element_names: friction elements; the joints first.
        element_matrix: E, joint velocities to input velocities of the elements, shape (n_el, n); its transpose
            turns the elements' torques into joint torques.
        model: Pinocchio's model of these joints alone.
        rotor: the rotors' share of the mass matrix, shape (n, n), kg m^2.
        spring: amplitude k of a gravity-compensation spring on each joint, torque -k sin(q), Nm, shape (n,).
        coupling: motor turns per joint turn without the gears, shape (n, n).
        offset: constant torque of each joint, Nm, shape (n,) or the same for all.

    Joints on which no element acts follow the recorded motion; their own torque is not used.
    """

    names: tuple[str, ...]
    element_names: tuple[str, ...]
    element_matrix: Array
    model: Any
    rotor: Array
    spring: Array
    coupling: Array
    offset: Array | float = 0.0

    @classmethod
    def from_setup(cls, setup: Setup) -> RigidArm:
        """Return the arm of a setup: robot with tool, rotors, coupling, spring, elements."""
        robot = setup.robot
        drives = setup.drives
        names = robot.joint_names
        turning = drives.turning
        rotor = drives.rotor_matrix
        elements = turning.element_names(names)
        matrix = turning.element_matrix
        return cls(names, elements, matrix, robot.model, rotor, drives.spring_torque, turning.turns)

    @classmethod
    def from_urdf(
        cls,
        urdf: Path | str,
        joints: Sequence[str] | None = None,
        coupling: ArrayLike | None = None,
        rotor_inertia: ArrayLike | None = None,
        spring: ArrayLike | None = None,
        *,
        massless: bool = False,
        followed: Sequence[str] = (),
    ) -> RigidArm:
        """Read the arm of any robot.

        Args:
            urdf: the robot's description.
            joints: n revolute joints from base to tip; the others are held at zero. By default all movable joints.
            coupling: motor turns per joint turn without the gears, shape (n, n): motor velocity = gear *
                (coupling @ joint velocity). A motor that turns with several joints has a friction element of
                its own. By default each motor turns with its joint.
            rotor_inertia: of each motor, seen through its gear, kg m^2, shape (n,); by default none.
            spring: as the attribute; by default none.
            massless: whether links without <inertial> are accepted, because only kinematics are wanted.
            followed: further joints that are not held at zero, because their motion is known.

        Raises:
            IdentificationError: for a URDF that cannot be used, an unknown joint or a wrong shape.
        """
        urdf = Path(urdf)
        alone = joint_model(urdf, joints, massless=massless)
        model = (
            joint_model(urdf, joints, massless=massless, followed=followed) if followed else alone
        )
        names = tuple(str(name) for name in alone.names)[1:]
        everything = tuple(str(name) for name in model.names)[1:]
        place = np.array([everything.index(name) for name in names])
        turns = _checked("coupling", coupling, np.eye(len(names)))
        if abs(np.linalg.det(turns)) < 1e-9:
            raise IdentificationError(f"coupling: {turns.tolist()}; accepted: an invertible matrix")
        # Joints that follow turn alone, and no element acts on them.
        chosen = np.eye(len(everything))[place]
        motors = turns @ chosen
        all_turns = np.eye(len(everything))
        all_turns[place] = motors
        inertia = _checked("rotor_inertia", rotor_inertia, np.zeros(len(names)))
        rotors = motors.T @ np.diag(inertia) @ motors
        springs = _checked("spring", spring, np.zeros(len(names))) @ chosen
        together = [row for row in motors if np.count_nonzero(row) > 1]
        matrix = np.vstack([chosen, *together])
        elements = (*names, *(sum_name(everything, row) for row in together))
        return cls(everything, elements, matrix, model, rotors, springs, all_turns)

    @property
    def identified(self) -> Mask:
        """Return the joints on which an element acts; the others follow the recorded motion, shape (n,)."""
        return np.asarray((self.element_matrix != 0.0).any(axis=0))

    def related(self) -> tuple[str, ...]:
        """Return the joints that carry one of the identified, or are carried by one: their motion counts for it."""
        chains = [set(chain.tolist()) for chain in self.model.supports]
        moved = {joint + 1 for joint in np.flatnonzero(self.identified).tolist()}
        above = set().union(*(chains[joint] for joint in moved))
        return tuple(
            name
            for joint, name in enumerate(self.names, 1)
            if joint in above or chains[joint] & moved
        )

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the torques of the drives at the joints without friction, Nm, all arrays of shape (m, n)."""
        return (
            rigid_torque(self.model, self.rotor, self.spring, position, velocity, acceleration)
            + self.offset
        )

    def with_bodies(self, links: Array, rotors: Array) -> RigidArm:
        """Return the arm with other links, shape (10 n,) in `inertial`'s order, and rotors, kg m^2, shape (n,)."""
        model = self.model.copy()
        for k, link in enumerate(links.reshape(-1, 10), 1):
            model.inertias[k] = pin.Inertia.FromDynamicParameters(link)
        return replace(self, model=model, rotor=self.coupling.T @ np.diag(rotors) @ self.coupling)

    def with_joints(self, joints: Mapping[str, JointTorques]) -> RigidArm:
        """Return the arm with the offsets of a friction file's `joints`, and the rotors and springs that it states.

        Raises:
            IdentificationError: for a joint that is none of the arm's.
        """
        for name in joints:
            if name not in self.names:
                raise IdentificationError(
                    f"joint {quoted(name)} is none of this arm; accepted: {listed(self.names)}"
                )
        torques = [joints.get(name, JointTorques()) for name in self.names]
        spring = np.array([joint.spring for joint in torques])
        rotors = np.diag([joint.rotor_inertia for joint in torques])
        return replace(
            self,
            rotor=self.coupling.T @ rotors @ self.coupling if rotors.any() else self.rotor,
            spring=spring if spring.any() else self.spring,
            offset=np.array([joint.offset for joint in torques]),
        )

    def regressor(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the derivative of the torque by the links' inertial parameters, shape (m, n, 10 n).

        The parameters of a link are mass, first moment and inertia about the joint's origin, in Pinocchio's
        order (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz).
        """
        data = self.model.createData()
        rows = zip(configurations(self.model, position), velocity, acceleration, strict=True)
        columns = np.empty((*position.shape, 10 * len(self.names)))
        for number, row in enumerate(rows):
            columns[number] = pin.computeJointTorqueRegressor(self.model, data, *row)
        return columns

    @property
    def inertial(self) -> Array:
        """Return the links' inertial parameters in the regressor's order, SI units, shape (10 n,)."""
        return np.concatenate(
            [body.toDynamicParameters() for body in list(self.model.inertias)[1:]]
        )

    def ranges(self) -> Array:
        """Return the joints' ranges by the URDF, rad, shape (n,); 0 where it has none."""
        width = self.model.upperPositionLimit - self.model.lowerPositionLimit
        joints = list(self.model.joints)[1:]
        return np.array([width[joint.idx_q] if joint.nq == 1 else 0.0 for joint in joints])

    def speeds(self) -> Array:
        """Return the joints' greatest speeds by the URDF, rad/s, shape (n,); 0 where it has none."""
        return np.where(np.isfinite(self.model.velocityLimit), self.model.velocityLimit, 0.0)

    def inertial_scale(self) -> Array:
        """Return how large errors of the inertial parameters can be at most, shape (10 n,), SI units.

        The bound is the whole mass of the arm at the distance of its reach.
        """
        mass = sum(body.mass for body in self.model.inertias)
        reach = (
            sum(float(np.linalg.norm(place.translation)) for place in self.model.jointPlacements)
            or 1.0
        )
        powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        return np.tile(mass * reach**powers, len(self.names))


def _checked(name: str, given: ArrayLike | None, usual: Array) -> Array:
    value = usual if given is None else np.asarray(given, dtype=np.float64)
    if value.shape != usual.shape or not np.isfinite(value).all():
        raise IdentificationError(
            f"{name} has shape {value.shape}; accepted: finite numbers, shape {usual.shape}"
        )
    return value


class JointGroup(NamedTuple):
    """Joints that share friction elements with each other and with no other joint.

    Attributes:
        joints: indices of the group's k joints.
        elements: indices of their e elements.
        inputs: velocities of these joints to input velocities of the elements, shape (e, k).
    """

    joints: tuple[int, ...]
    elements: tuple[int, ...]
    inputs: Array

    def break_away(self, sliding: Sequence[FrictionElement]) -> Array:
        """Return the friction torque at which each joint slides, Nm, shape (k,), by its elements' sliding regime."""
        return np.asarray(
            np.abs(self.inputs).T @ np.array([element.tau_c.positive for element in sliding])
        )


def joint_groups(arm: RigidArm) -> list[JointGroup]:
    """Return the groups of an arm's joints, from base to tip."""
    from scipy.sparse.csgraph import connected_components  # takes a while

    matrix = arm.element_matrix
    shared = np.abs(matrix).T @ np.abs(matrix)
    _, group = connected_components(shared, directed=False)
    groups = []
    for number in dict.fromkeys(group.tolist()):
        joints = np.flatnonzero(group == number)
        elements = np.flatnonzero(matrix[:, joints].any(axis=1))
        inputs = matrix[np.ix_(elements, joints)]
        groups.append(JointGroup(tuple(joints.tolist()), tuple(elements.tolist()), inputs))
    return groups
