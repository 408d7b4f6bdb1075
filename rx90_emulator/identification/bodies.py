"""Physically possible links, rotors and springs nearest to identified base parameters: the values in the files.

The mass distribution of a body is one symmetric matrix of order 4, its pseudo-inertia,

    P = [[S, h], [h^T, m]],   S = integral of r r^T = tr(I) / 2 - I,   h = m c,   I the inertia about the origin.

A body of positive density exists for m, h and I if and only if P is positive definite (Wensing, Kim and Slotine 2018).
So P = U U^T with U = U0 M, where U0 is the upper Cholesky factor of the description's P0 and M is upper triangular with
a positive diagonal: the logarithms of its diagonal and the entries above it are any ten numbers (log-Cholesky
parameters: Rucker and Wensing 2022, "Smooth parameterization of rigid-body inertia"), all 0 for the description. The
last of the diagonal alone changes the mass. A rotor or a spring is the description's times exp of one number.

With y the base parameters, K the mapping from standard parameters theta to base parameters, and R^T R the information
of the weighted rows on y, the sum

    |R (K theta - y)|^2 + |the numbers|^2

is minimised. The first term is what the bodies add to the weighted squares of the torque, with the friction as
identified, because the files contain that friction beside the bodies. The second determines what the data leave open:
a description is right within a factor of about e, its masses within 1.4. It is the <inertial> of the URDF, or the
geometry of the arm where it has none.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.description.robot import joint_of
from rx90_common.description.urdf import bodies as described_bodies
from rx90_common.description.urdf import placements
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.fitted import FittedArm
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.rows.excitation import ExcitationProblem

_MOMENTS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
"""Rows and columns of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, in Pinocchio's order."""
_MIN_EIGENVALUE = 1e-12  # of P scaled to ones on its diagonal: smaller ones are rounding


def inertial_parameters(pseudo: Array) -> Array:
    """Return m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, shape (..., 10), of pseudo-inertias, shape (..., 4, 4).

    They are about the origin of the frame, and linear in the pseudo-inertias.
    """
    spread = pseudo[..., :3, :3]
    trace = np.trace(spread, axis1=-2, axis2=-1)[..., None, None]
    inertia = (trace * np.eye(3) - spread)[..., _MOMENTS[0], _MOMENTS[1]]
    return np.concatenate([pseudo[..., 3, 3][..., None], pseudo[..., :3, 3], inertia], axis=-1)


def body_of(pseudo: Array) -> pin.Inertia:
    """Return the body with a positive definite P, shape (4, 4)."""
    return pin.Inertia.FromDynamicParameters(inertial_parameters(pseudo))


def is_body(pseudo: Array) -> bool:
    """Return whether a body of positive density has this P, shape (4, 4): finite and positive definite."""
    if not np.isfinite(pseudo).all() or not (np.diag(pseudo) > 0.0).all():
        return False
    scale = np.sqrt(np.diag(pseudo))
    return bool(np.linalg.eigvalsh(pseudo / np.outer(scale, scale))[0] > _MIN_EIGENVALUE)


@dataclass(frozen=True, eq=False)
class MovingBody:
    """One link of a URDF that moves with a joint.

    Attributes:
        link: its name.
        joint: number of the joint that it moves with, from 0.
        frame: its frame in the frame of that joint, homogeneous, shape (4, 4).
        pseudo: pseudo-inertia by the URDF in the joint's frame, shape (4, 4); zeros without <inertial>.
    """

    link: str
    joint: int
    frame: Array
    pseudo: Array


def _moving_links(urdf: str, joints: Sequence[str]) -> tuple[list[MovingBody], Array]:
    """Return the links that move, and the frame farthest from each joint that moves with it, m, shape (n, 3).

    Pinocchio, and so the regressor, treats links that are fixed to each other as one body; a URDF lists them one by
    one.
    Each joint's own link comes before those that are fixed to it. The farthest frame may be that of the next joint.
    """
    root = ET.fromstring(urdf)
    own = {place.name: place.child for place in placements(root)}
    described = {body.link: body for body in described_bodies(root)}
    model = pin.buildModelFromXML(ET.tostring(root, encoding="unicode"))
    fixed_joints = [k for k in range(1, model.njoints) if model.names[k] not in joints]
    model = pin.buildReducedModel(model, fixed_joints, pin.neutral(model))
    number = [joints.index(name) if name in joints else -1 for name in model.names]
    bodies = []
    places = list(zip(model.parents, model.jointPlacements, strict=True))
    for element in root.findall("link"):
        frame = model.frames[model.getFrameId(element.get("name", ""), pin.FrameType.BODY)]
        joint = joint_of(frame)
        places.append((joint, frame.placement))
        if joint:
            in_joint = frame.placement.homogeneous
            pseudo = np.zeros((4, 4))
            body = described.get(frame.name)
            if body is not None:
                origin = pin.SE3(pin.rpy.rpyToMatrix(*body.rpy), np.array(body.xyz))
                to_joint = in_joint @ origin.homogeneous
                xx, yy, zz, xy, xz, yz = body.inertia
                inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
                about_center = np.diag([0.0, 0.0, 0.0, body.mass])
                about_center[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
                pseudo = to_joint @ about_center @ to_joint.T
            bodies.append(MovingBody(frame.name, number[joint], in_joint, pseudo))
    ends = np.zeros((len(joints), 3))
    for joint, place in places:
        if joint and np.linalg.norm(place.translation) > np.linalg.norm(ends[number[joint]]):
            ends[number[joint]] = place.translation
    return sorted(bodies, key=lambda body: (body.joint, body.link != own[joints[body.joint]])), ends


_DENSITY = 1500.0  # kg/m^3: castings with motors and cavities
_SLENDERNESS = 6.0  # length over radius of a link without <inertial>
_MIN_RADIUS_SHARE = 0.05  # its least radius, as a share of the arm's reach
_END_RADIUS = 0.2  # radius of one that ends at its joint, as a share of the others' mean length
_DEFAULT_REACH = 0.5  # m, of an arm whose joints all have one origin
_MIN_EQUAL_LINKS = 3  # number of links with the same <inertial> that is no coincidence
_EQUAL = 1e-9


@dataclass(frozen=True, eq=False)
class InertialPrior:
    """Mass distributions and rotor inertias where the search starts, and which it keeps where the data are silent.

    Attributes:
        joints: names of the n joints.
        bodies: the links that share the parameters, at least one for each joint; their pseudo-inertias are positive
            definite.
        known: parameters of the bodies that do not change, summed for each joint, shape (n, 10).
        rotors: inertia of each rotor that has a column, seen at its joint, kg m^2, shape (k,); all 0 where the torque
            does not contain the rotors'.
        springs: amplitude of each spring that has a column, Nm, shape (s,); 0 if it is unknown.
        guessed: which bodies, and then which rotors, are missing in the description, shape (b + k,).
        replaced: in words, the values of the URDF that are not used, and their replacement.
        dropped: links whose <inertial> no body can have; the other links of their joint take over their mass.
    """

    joints: tuple[str, ...]
    bodies: tuple[MovingBody, ...]
    known: Array
    rotors: Array
    springs: Array
    guessed: Mask
    replaced: tuple[str, ...]
    dropped: tuple[str, ...]

    @classmethod
    def of_urdf(
        cls,
        urdf: Path | str,
        joints: Sequence[str],
        rotors: ArrayLike | None = (),
        springs: ArrayLike = (),
        known: Collection[str] = (),
    ) -> InertialPrior:
        """Return the prior of an arm.

        Args:
            urdf: file, or its text.
            joints: n names from base to tip.
            rotors: inertia of the rotors of the first k joints, seen at these, kg m^2, shape (k,); an unknown one is 0
                and starts at the mean moment of inertia of its joint's body. None for torques that do not contain the
                rotors'.
            springs: as the attribute.
            known: links whose <inertial> is known and does not change, such as a tool that was weighed.
        """
        names = tuple(joints)
        text = urdf.read_text(encoding="utf-8") if isinstance(urdf, Path) else urdf
        links, ends = _moving_links(text, names)
        fixed_parameters = np.zeros((len(names), 10))
        free = [body for body in links if body.link not in known]
        for body in links:
            if body.link in known:
                fixed_parameters[body.joint] += inertial_parameters(body.pseudo)
        own = [next(body for body in free if body.joint == joint) for joint in range(len(names))]
        # As exporters fill it in: all joints' own links have the same inertial.
        same = all(np.abs(one.pseudo - own[0].pseudo).max() <= _EQUAL for one in own)
        filled = len(own) >= _MIN_EQUAL_LINKS and bool(own[0].pseudo.any()) and same
        bodies: list[MovingBody] = []
        guessed = []
        words = []
        for joint, name in enumerate(names):
            of_joint = [body for body in free if body.joint == joint]
            real = [] if filled else [body for body in of_joint if is_body(body.pseudo)]
            guessed += [False] * len(real) or [True]
            bodies += real
            if not real:
                bodies.append(_by_geometry(of_joint[0], ends))
                why = "the same for all links" if filled else "missing or none that a body can have"
                words.append(
                    f"{of_joint[0].link} at {name}: <inertial> is {why}; begins as an ellipsoid of {_DENSITY:g} kg/m^3 "
                    f"along the link, {bodies[-1].pseudo[3, 3]:.3g} kg"
                )
        kept = {body.link for body in bodies}
        dropped = tuple(body.link for body in free if body.pseudo.any() and body.link not in kept)
        initial = np.zeros(len(names)) if rotors is None else np.array(rotors, dtype=np.float64)
        unknown = (initial == 0.0) & (rotors is not None)
        guesses = np.append(np.array(guessed, dtype=bool), unknown)
        for i in np.flatnonzero(unknown).tolist():
            total = np.sum(
                [inertial_parameters(body.pseudo) for body in bodies if body.joint == i], axis=0
            )
            initial[i] = total[[4, 6, 9]].mean()
            words.append(
                f"rotor of {names[i]}: begins at {initial[i]:.3g} kg m^2, the mean moment of its link"
            )
        return cls(
            names,
            tuple(bodies),
            fixed_parameters,
            initial,
            np.array(springs, dtype=np.float64),
            guesses,
            tuple(words),
            dropped,
        )


def _by_geometry(body: MovingBody, ends: Array) -> MovingBody:
    """Return a link as a solid ellipsoid from its joint to the farthest frame that moves with it."""
    end = ends[body.joint]
    length = float(np.linalg.norm(end))
    reach = float(np.linalg.norm(ends, axis=1).sum()) or _DEFAULT_REACH
    others = max(1, int(ends.any(axis=1).sum()))
    radius = (
        max(length / _SLENDERNESS, _MIN_RADIUS_SHARE * reach)
        if length
        else _END_RADIUS * reach / others
    )
    half = max(0.5 * length, radius)
    along = end / length if length > 0.0 else np.zeros(3)
    mass = _DENSITY * 4.0 / 3.0 * np.pi * half * radius**2
    spread = mass / 5.0 * (radius**2 * np.eye(3) + (half**2 - radius**2) * np.outer(along, along))
    place = np.append(0.5 * end, 1.0)
    pseudo = mass * np.outer(place, place)
    pseudo[:3, :3] += spread
    return replace(body, pseudo=pseudo)


GUESSED = 0.1
"""Weight of what the description does not have: right within a factor of about 20."""
MASS = 3.0
"""Weight of the logarithm of a described mass: it is weighed, while how it is distributed is often a guess."""
MOST_EVALUATIONS = 1000
"""For each weight of the description: a valley of few accurate rows takes hundreds."""
FAR = 2.0
"""Standard deviations, RMS, beyond which bodies are far from the base parameters."""
_TOOL = "tool"  # the link that a tool file adds: its inertial is known
_ABOVE = np.triu_indices(4, 1)


class BaseEstimate(NamedTuple):
    """Identified base parameters.

    Attributes:
        mapping: K, shape (p, P), from P standard parameters to the base parameters: ten for each joint's body in
            Pinocchio's order, the inertias of k rotors, the amplitudes of s springs, and others, such as offsets. The
            others, and springs without a prior, are unbounded.
        value: SI units, shape (p,).
        information: R, shape (m, p): R^T R is the information on them.
        determined: which parameters the data determine, shape (p,).
    """

    mapping: Array
    value: Array
    information: Array
    determined: Mask

    @classmethod
    def of(cls, problem: ExcitationProblem, fitted: FittedArm) -> BaseEstimate:
        """Return the base parameters of a fit, with the information of the weighted rows for the fitted friction.

        Errors of neighbouring rows are correlated: the information is scaled so that in the median its variances are
        those of the fit.
        """
        columns = fitted.fit.columns
        base = slice(len(fitted.fit.x), None)
        root = np.asarray(np.linalg.qr(columns[:, base], mode="r"))
        variance = fitted.deviation[base] ** 2
        white = np.diag(np.linalg.pinv(columns.T @ columns, hermitian=True))[base]
        known = fitted.determined[base]
        share = float(np.median((white / variance)[known])) if known.any() else 1.0
        root *= math.sqrt(min(1.0, share))
        return cls(problem.base.combination, fitted.fit.linear, root, known)


class ConsistentInertias(NamedTuple):
    """Possible bodies and rotors near the identified values.

    Attributes:
        prior: where the search started.
        pseudo: of each body, in the frame of its joint, shape (b, 4, 4).
        rotors: kg m^2, > 0 where the torque contains the rotors', else 0, shape (k,).
        parameters: the standard parameters, unchanged bodies included, shape (P,).
        base: their base parameters, shape (p,).
        shift: base parameters less the identified ones, shape (p,).
        distance: length of the shift in standard deviations, RMS: at most about 1 within the noise.
        shares: RMS residual over RMS torque, all joints together: with the base parameters, with these.
    """

    prior: InertialPrior
    pseudo: Array
    rotors: Array
    parameters: Array
    base: Array
    shift: Array
    distance: float
    shares: tuple[float, ...] = (math.nan, math.nan)

    @property
    def text(self) -> str:
        """Return in words how far the bodies are from the base parameters, and what that costs."""
        before, after = self.shares
        return (
            f"bodies in the files: {self.distance:.2g} standard deviations from the base parameters (RMS; up "
            f"to about 1 is noise); torque RMS in the low-pass of the fit {after:.1%} with them, {before:.1%} without"
        )

    @property
    def warning(self) -> str:
        """Return a warning if the bodies are far from the base parameters, else ""."""
        if self.distance <= FAR:
            return ""
        before, after = self.shares
        return (
            f"the bodies in the files are {self.distance:.3g} standard deviations from the base parameters "
            f"(RMS; up to {FAR:g} passes): torque RMS {after:.1%} in place of {before:.1%}. No bodies near the "
            "description have these: is a known tool, a payload, a zero or the sign of a torque another one, or do "
            "the torques hold no rotors (--no-rotors)?"
        )


class _Bodies:
    """Standard parameters as a function of numbers that are 0 for the description.

    The numbers are ten for each body, the logarithm of each rotor and spring over the description's, and values that
    have none.
    """

    def __init__(self, prior: InertialPrior, parameters: int) -> None:
        self._known = prior.known.ravel()
        self._joint = [body.joint for body in prior.bodies]
        turned = [np.flip(body.pseudo) for body in prior.bodies]
        self._factors = np.flip(np.linalg.cholesky(turned), (1, 2))
        described = np.concatenate([prior.rotors, prior.springs])
        self._behind = np.append(
            described, np.zeros(parameters - len(self._known) - len(described))
        )
        self._positive = self._behind > 0.0
        guessed = np.append(
            prior.guessed, np.zeros(len(self._behind) - len(prior.rotors), dtype=np.bool_)
        )
        share = np.where(guessed, GUESSED, 1.0)
        # ln P changes by twice a number on the diagonal, and by one below it in two entries.
        size = np.append(np.full(4, 2.0), np.full(6, math.sqrt(2.0)))
        bodies = np.outer(np.sqrt(share[: len(self._joint)]), size)
        bodies[~guessed[: len(self._joint)], 3] *= MASS
        self.prior_weight = np.append(bodies, np.sqrt(share[len(self._joint) :]) * self._positive)

    def pseudo(self, numbers: Array) -> Array:
        """Return the bodies, shape (b, 4, 4)."""
        factors = self._factors @ self._relative(numbers)
        return factors @ np.swapaxes(factors, 1, 2)

    def behind(self, numbers: Array) -> Array:
        """Return rotors, springs and others, shape (P - 10 n,)."""
        last = numbers[10 * len(self._joint) :]
        return np.where(
            self._positive, self._behind * np.exp(np.where(self._positive, last, 0.0)), last
        )

    def parameters(self, numbers: Array) -> Array:
        """Return all standard parameters, shape (P,)."""
        links = self._known.copy().reshape(-1, 10)
        np.add.at(links, self._joint, inertial_parameters(self.pseudo(numbers)))
        return np.append(links, self.behind(numbers))

    def slopes(self, numbers: Array) -> Array:
        """Return the derivatives of the standard parameters, shape (P, numbers)."""
        slopes = np.zeros((len(self._known) + len(self._behind), len(numbers)))
        relative = self._relative(numbers)
        for number, joint in enumerate(self._joint):
            change = np.zeros((10, 4, 4))
            change[range(4), range(4), range(4)] = np.diag(relative[number])
            change[range(4, 10), _ABOVE[0], _ABOVE[1]] = 1.0
            half = self._factors[number] @ change @ relative[number].T @ self._factors[number].T
            place = slice(10 * joint, 10 * joint + 10)
            slopes[place, 10 * number : 10 * number + 10] = inertial_parameters(
                half + np.swapaxes(half, 1, 2)
            ).T
        ends = np.where(self._positive, self.behind(numbers), 1.0)
        first = 10 * len(self._joint)
        slopes[len(self._known) :, first:] = np.diag(ends)
        return slopes

    def _relative(self, numbers: Array) -> Array:
        own = numbers[: 10 * len(self._joint)].reshape(-1, 10)
        relative = np.zeros((len(own), 4, 4))
        relative[:, range(4), range(4)] = np.exp(own[:, :4])
        relative[:, _ABOVE[0], _ABOVE[1]] = own[:, 4:]
        return relative


def consistent_inertias(
    estimate: BaseEstimate, prior: InertialPrior, weight: float = 1.0
) -> ConsistentInertias:
    """Return the consistent inertias nearest to the identified base parameters and to the prior.

    Args:
        estimate: of the base parameters.
        prior: of links and rotors.
        weight: of the prior's squares.
    """
    if not estimate.determined.any():
        raise IdentificationError(
            "no base parameter is determined; accepted: runs that determine some"
        )
    bodies = _Bodies(prior, estimate.mapping.shape[1])
    whitened = estimate.information @ estimate.mapping
    target = estimate.information @ estimate.value
    numbers = np.zeros(len(bodies.prior_weight))
    # Rotors and offsets that no row contains stay 0.
    moved = (bodies.prior_weight > 0.0) | (whitened @ bodies.slopes(numbers) != 0.0).any(axis=0)

    def whole(x: Array) -> Array:
        numbers[moved] = x
        return numbers

    def residual(x: Array, near: Array) -> Array:
        return np.append(whitened @ bodies.parameters(whole(x)) - target, near * x)

    def slopes(x: Array, near: Array) -> Array:
        return np.vstack([(whitened @ bodies.slopes(whole(x)))[:, moved], np.diag(near)])

    # Accurate data make a valley that is curved in the numbers: from a prior of a similar weight on, it is followed.
    squares = float(np.sum((whitened @ bodies.parameters(numbers) - target) ** 2))
    for decade in range(max(0, math.ceil(math.log10(max(squares, 1.0) / weight))), -1, -1):
        near = bodies.prior_weight[moved] * math.sqrt(weight * 10.0**decade)
        result = least_squares(
            residual,
            numbers[moved],
            slopes,
            method="lm",
            x_scale="jac",
            max_nfev=MOST_EVALUATIONS,
            args=(near,),
        )
        whole(result.x)
    parameters = bodies.parameters(numbers)
    base = estimate.mapping @ parameters
    shift = base - estimate.value
    distance = float(np.linalg.norm(estimate.information @ shift)) / math.sqrt(
        int(estimate.determined.sum())
    )
    return ConsistentInertias(
        prior=prior,
        pseudo=bodies.pseudo(numbers),
        rotors=bodies.behind(numbers)[: len(prior.rotors)],
        parameters=parameters,
        base=base,
        shift=shift,
        distance=distance,
    )


def make_consistent(
    problem: ExcitationProblem, fitted: FittedArm, robot: RecordedRobot, options: RobotOptions
) -> ConsistentInertias:
    """Return the consistent inertias nearest to the base parameters of a fit.

    Args:
        problem: the equations.
        fitted: the fit.
        robot: whose description gives the initial inertias, rotors and springs.
        options: that describe it.
    """
    arm = problem.arm
    n = len(arm.names)
    description: Path | str = Path(str(options.urdf))
    rotors: ArrayLike | None = (
        problem.columns.values()[10 * n : 11 * n] if problem.columns.rotors else None
    )
    known: tuple[str, ...] = ()
    if robot.setup is not None:
        description = robot.setup.robot.urdf
        rotors = robot.setup.drives.rotor_inertia
        known = () if robot.setup.files.tool is None else (_TOOL,)
    prior = InertialPrior.of_urdf(
        description, arm.names, rotors, arm.spring[problem.columns.springs], known
    )
    inertias = consistent_inertias(BaseEstimate.of(problem, fitted), prior)
    before = fitted.fit.residual
    after = before - problem.regressor @ inertias.shift
    shares = np.linalg.norm([before, after], axis=1) / np.linalg.norm(problem.torque)
    return inertias._replace(shares=tuple(shares.tolist()))


def written_arm(problem: ExcitationProblem, consistency: ConsistentInertias) -> RigidArm:
    """Return the arm that the files describe, with the offsets of its torques."""
    arm = problem.arm
    columns = problem.columns
    values = consistency.parameters
    n = len(arm.names)
    spring = arm.spring.copy()
    spring[columns.springs] = values[11 * n : 11 * n + len(columns.springs)]
    bodies = arm.with_bodies(values[: 10 * n], values[10 * n : 11 * n])
    return replace(bodies, spring=spring, offset=values[-n:])
