"""The arm without friction: its rigid-body torques, and the joints that its friction elements act on.

The URDF of any robot is read into Pinocchio's model of the joints of interest, or refused in one line.
"""

from __future__ import annotations

import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, plain, quoted
from rx90_common.description.coupling import sum_name
from rx90_common.description.urdf import read_urdf
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import JointTorques
from rx90_emulator.loop.setup import Setup

_MAX_MASS = 1e5  # kg
_MAX_NUMBER = 1e12  # m and kg m^2: beyond any unit, and its square is a number
_NUMBERS = "link/inertial/origin", "link/inertial/inertia", "joint/origin", "joint/axis"
_KEYS = {"xyz", "rpy", "ixx", "ixy", "ixz", "iyy", "iyz", "izz"}
_TURNING = ("revolute", "continuous")
_STDERR = 2


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
        model = joint_model(urdf, joints, massless=massless, followed=followed) if followed else alone
        names = tuple(str(name) for name in alone.names)[1:]
        everything = tuple(str(name) for name in model.names)[1:]
        place = np.array([everything.index(name) for name in names])
        turns = _checked("coupling", coupling, np.eye(len(names)))
        if abs(np.linalg.det(turns)) < 1e-9:
            raise IdentificationError(f"coupling: {turns.tolist()}; accepted: an invertible matrix")
        rotor = turns.T @ np.diag(_checked("rotor_inertia", rotor_inertia, np.zeros(len(names)))) @ turns
        springs = np.zeros(len(everything))
        springs[place] = _checked("spring", spring, np.zeros(len(names)))
        # Joints that follow turn alone, and no element acts on them.
        all_turns = np.eye(len(everything))
        all_turns[np.ix_(place, place)] = turns
        rotors = np.zeros_like(all_turns)
        rotors[np.ix_(place, place)] = rotor
        together = [row for row in turns if np.count_nonzero(row) > 1]
        matrix = np.zeros((len(names) + len(together), len(everything)))
        matrix[:, place] = np.vstack([np.eye(len(names)), *together])
        elements = (*names, *(sum_name(names, row) for row in together))
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
        return tuple(name for joint, name in enumerate(self.names, 1) if joint in above or chains[joint] & moved)

    def torque(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Return the torques of the drives at the joints without friction, Nm, all arrays of shape (m, n)."""
        return rigid_torque(self.model, self.rotor, self.spring, position, velocity, acceleration) + self.offset

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
                raise IdentificationError(f"joint {quoted(name)} is none of this arm; accepted: {listed(self.names)}")
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
        return np.concatenate([body.toDynamicParameters() for body in list(self.model.inertias)[1:]])

    def ranges(self) -> Array:
        """Return the joints' ranges by the URDF, rad, shape (n,); 0 where it has none."""
        width = self.model.upperPositionLimit - self.model.lowerPositionLimit
        joints = list(self.model.joints)[1:]
        return np.array([width[joint.idx_q] if joint.nq == 1 else 0.0 for joint in joints])

    def speeds(self) -> Array:
        """Return the joints' greatest speeds by the URDF, rad/s, shape (n,); 0 where it has none."""
        return np.asarray(np.where(np.isfinite(self.model.velocityLimit), self.model.velocityLimit, 0.0))

    def inertial_scale(self) -> Array:
        """Return how large errors of the inertial parameters can be at most, shape (10 n,), SI units.

        The bound is the whole mass of the arm at the distance of its reach.
        """
        mass = sum(body.mass for body in self.model.inertias)
        reach = sum(float(np.linalg.norm(place.translation)) for place in self.model.jointPlacements) or 1.0
        powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        return np.tile(mass * reach**powers, len(self.names))


def joint_model(
    urdf: Path, joints: Sequence[str] | None, *, massless: bool = False, followed: Sequence[str] = ()
) -> Any:
    """Return Pinocchio's model of these joints; the others are held at zero.

    Args:
        urdf: the robot's description.
        joints: from base to tip; by default all movable joints.
        massless: whether joints that move no mass are accepted, because only kinematics are wanted.
        followed: further joints that are not held.
    """
    model, root = _read_urdf(urdf)
    there = [str(name) for name in model.names][1:]
    requested = there if joints is None else list(joints)
    in_order = [name for name in there if name in requested]
    bad = {}
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if joint.get("type") not in _TURNING:
            bad[joint.get("name")] = f"is {joint.get('type')}"
        elif mimic is not None:
            bad[joint.get("name")] = f"mimics {mimic.get('joint')}"
    wrong = ""
    if unknown := [name for name in requested if name not in there]:
        wrong = f"no movable joint {quoted(unknown[0])}; there are {listed(there) or 'none'}"
    elif requested != in_order:
        wrong = f"joints {listed(requested)}; accepted: from base to tip, {listed(in_order)}"
    elif not requested:
        wrong = "no movable joint; accepted: one or more"
    elif unfit := [name for name in requested if name in bad]:
        good = " ".join(name for name in there if name not in bad) or "(there are none)"
        wrong = (
            f"joint {quoted(unfit[0])} {plain(bad[unfit[0]])}; accepted: revolute and continuous joints with a drive "
            f"of their own, --joints {good}"
        )
    if wrong:
        raise IdentificationError(f"{urdf}: {wrong}")
    fixed = [model.getJointId(name) for name in there if name not in (*requested, *followed)]
    reduced = pin.buildReducedModel(model, fixed, pin.neutral(model)) if fixed else model
    data = reduced.createData()
    pin.computeSubtreeMasses(reduced, data)
    for name, mass in zip(reduced.names, data.mass, strict=True):
        if name in requested and not massless and not mass > 0.0:
            raise IdentificationError(
                f"{urdf}: joint {quoted(name)} moves a mass of {mass:g} kg; accepted: links with <inertial>"
            )
    return reduced


def movable_joints(urdf: Path) -> tuple[str, ...]:
    """Return the joints of a URDF with one coordinate, as logs have: revolute, continuous or prismatic, no mimics."""
    model, root = _read_urdf(urdf)
    mimics = {joint.get("name") for joint in root.findall("joint") if joint.find("mimic") is not None}
    pairs = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
    return tuple(str(name) for name, joint in pairs if joint.nv == 1 and str(name) not in mimics)


def all_joints(urdf: Path) -> tuple[str, ...]:
    """Return all movable joints of a URDF, mimics and joints of several coordinates included."""
    return tuple(
        joint.get("name", "") for joint in _read_urdf(urdf)[1].findall("joint") if joint.get("type") != "fixed"
    )


def _read_urdf(urdf: Path) -> tuple[Any, ET.Element]:
    """Return Pinocchio's model of the whole robot, and the root of the file."""
    lines: list[str] = []
    try:
        # Written anew: the XML parser of Pinocchio 2 accepts no document type, and the parser used here fetches
        # nothing.
        root = read_urdf(urdf, "utf-8")
        with _caught_stderr(lines):
            model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
        if any(line.startswith("Error:") for line in lines):  # an inertial that cannot be read is left out
            raise ValueError
        _check_numbers(urdf, root)
        return model, root
    except UnicodeDecodeError as error:
        raise IdentificationError(f"{plain(urdf)}: cannot be read ({error}); accepted: a URDF file") from error
    except (ValueError, RuntimeError, ET.ParseError) as error:
        message = next((line.removeprefix("Error:") for line in lines if line.startswith("Error:")), str(error))
        reason = " ".join(message.split()) or type(error).__name__
        raise IdentificationError(f"{urdf}: no URDF that Pinocchio can read ({reason})") from error


def _check_numbers(urdf: Path, root: ET.Element) -> None:
    """Refuse axes of length 0, and masses, places and moments that no arm has."""
    for joint in root.findall("joint"):
        axis = joint.find("axis") if joint.get("type") in _TURNING else None
        if axis is not None and not any(map(float, axis.get("xyz", "1").split())):
            raise ValueError(f"axis of joint [{joint.get('name')}] is 0 0 0")
    for link in root.findall("link"):
        mass = link.find("inertial/mass")
        weight = 0.0 if mass is None else float(mass.get("value", "0"))
        if not 0.0 <= weight <= _MAX_MASS:
            name = quoted(link.get("name"))
            raise IdentificationError(
                f"{plain(urdf)}: the mass of link {name} is {weight:g} kg; accepted: 0 to {_MAX_MASS:g} kg"
            )
    for path in _NUMBERS:
        for element in root.iterfind(path):
            for key, text in element.items():
                if key in _KEYS and not all(abs(float(word)) <= _MAX_NUMBER for word in text.split()):
                    raise IdentificationError(
                        f"{plain(urdf)}: <{element.tag} {key}={quoted(text)}>; accepted: numbers up to {_MAX_NUMBER:g}"
                    )


def _checked(name: str, given: ArrayLike | None, usual: Array) -> Array:
    value = usual if given is None else np.asarray(given, dtype=np.float64)
    if value.shape != usual.shape or not np.isfinite(value).all():
        raise IdentificationError(f"{name} has shape {value.shape}; accepted: finite numbers, shape {usual.shape}")
    return value


@contextmanager
def _caught_stderr(lines: list[str]) -> Iterator[None]:
    """Collect what is written to file descriptor 2, the only place where the parser below Pinocchio gives reasons."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as file:
        before = os.dup(_STDERR)
        os.dup2(file.fileno(), _STDERR)
        try:
            yield
        finally:
            os.dup2(before, _STDERR)
            os.close(before)
            file.seek(0)
            lines += file.read().decode("utf-8", "replace").splitlines()


@dataclass(frozen=True, eq=False)
class JointGroup:
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
        return np.asarray(np.abs(self.inputs).T @ np.array([one.tau_c.positive for one in sliding]))


def joint_groups(arm: RigidArm) -> list[JointGroup]:
    """Return the groups of an arm's joints, from base to tip."""
    matrix = arm.element_matrix
    shared = np.abs(matrix).T @ np.abs(matrix)
    _, group = connected_components(shared, directed=False)
    found = []
    for number in dict.fromkeys(group.tolist()):
        joints = np.flatnonzero(group == number)
        elements = np.flatnonzero(matrix[:, joints].any(axis=1))
        found.append(JointGroup(tuple(joints.tolist()), tuple(elements.tolist()), matrix[np.ix_(elements, joints)]))
    return found


def rigid_torque(
    model: Any, rotor: Array, spring: Array, position: Array, velocity: Array, acceleration: Array
) -> Array:
    """Return M(q) a + h(q, v) along a motion: the drives' torques at the joints in the absence of friction.

    Args:
        model: Pinocchio's model of n turning joints, from base to tip.
        rotor: share of the rotors in the mass matrix, couplings included, kg m^2, shape (n, n).
        spring: amplitudes k of springs with the torque -k sin(q) on the joints, Nm, shape (n,).
        position: rad, shape (m, n).
        velocity: rad/s, shape (m, n).
        acceleration: rad/s^2, shape (m, n).

    Returns:
        Inertial, Coriolis, centrifugal and gravity torques (recursive Newton-Euler: Featherstone 2008, table 5.1), and
        those of rotors and springs, Nm, shape (m, n).
    """
    data = model.createData()
    rows = zip(configurations(model, position), velocity, acceleration, strict=True)
    links = np.array([pin.rnea(model, data, *row) for row in rows]).reshape(position.shape)
    return links + rotor_and_spring_torque(rotor, spring, position, acceleration)


def rotor_and_spring_torque(rotor: Array, spring: Array, position: Array, acceleration: Array) -> Array:
    """Return the share of rotors and springs in `rigid_torque`, arguments as there, Nm, shape (m, n)."""
    return np.asarray(acceleration @ rotor.T + spring * np.sin(position))


def configurations(model: Any, position: Array) -> Array:
    """Return Pinocchio's configurations, shape (m, nq): joints without limits have a sine and a cosine in it."""
    if model.nq == model.nv:
        return position
    neutral = pin.neutral(model)
    return np.array([pin.integrate(model, neutral, row) for row in position])
