"""The links, rotors and springs that can exist nearest to identified base parameters.

Pseudo-inertia matrices: the mass distribution of a body as one symmetric matrix of order 4.

    P = [[S, h], [h^T, m]],   S = integral of r r^T = tr(I) / 2 - I,   h = m c,   I the inertia about the origin.

A body of positive density exists for m, h and I if and only if P is positive definite (Wensing, Kim and Slotine 2018).
In another frame the same body has T P T^T, with T the homogeneous transform of its old frame to the new one.

With y the base parameters, K the mapping from all parameters theta to base parameters, and R^T R the information of the
weighted rows on y, the sum

    |R (K theta - y)|^2 + w |distance from the prior|^2

is minimised. The first term is what the shift adds to the weighted squares of the torque, as far as no friction makes
up for it; the second one decides what the data leave open. The prior is the <inertial> of the URDF, or the geometry of
the arm where it has none.

The unknowns are those of a log-Cholesky factor (Rucker and Wensing 2022, "Smooth parameterization of rigid-body
inertia"): with the prior's pseudo-inertia L0 L0^T a body has P = L0 M D M^T L0^T, M lower triangular with ones on its
diagonal, D diagonal and positive. Every P has a body of positive density. The distance from the prior is that of the
logarithms of D and of the entries of M; it does not depend on units, and hardly on how heavy a body the prior takes.
Near the prior it is the Bregman divergence of -log det (Lee, Wensing and Park 2020). Rotors and springs have a
logarithm each. SciPy's trust region finds the minimum.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import listed, quoted
from rx90_common.description.robot_files import RobotFiles
from rx90_common.description.rotations import rpy_rotation
from rx90_emulator.identification.excitation.friction import FrictionSelection, linear_columns
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot

_MOMENTS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
"""Rows and columns of Ixx, Ixy, Iyy, Ixz, Iyz, Izz, in Pinocchio's order."""
_MIN_EIGENVALUE = 1e-12  # of P scaled to ones on its diagonal: less is rounding


def inertial_parameters(pseudo: Array) -> Array:
    """Return m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, shape (..., 10), of pseudo-inertias, shape (..., 4, 4).

    They are about the origin of the frame, and linear in the pseudo-inertias.
    """
    inertia = _other(pseudo[..., :3, :3], 1.0)[..., _MOMENTS[0], _MOMENTS[1]]
    return np.concatenate([pseudo[..., 3, 3][..., None], pseudo[..., :3, 3], inertia], axis=-1)


def _other(matrix: Array, share: float) -> Array:
    """Return share tr(M) - M: S of an inertia for a share of 1/2, the inertia of S for 1."""
    trace = np.trace(matrix, axis1=-2, axis2=-1)
    return np.asarray(share * trace[..., None, None] * np.eye(3) - matrix)


def _about_center(mass: float, center: Array, inertia: Array) -> Array:
    """Return P, shape (4, 4), of a mass with its centre, shape (3,), and inertia about it, shape (3, 3)."""
    place = np.append(center, 1.0)
    pseudo = mass * np.outer(place, place)
    pseudo[:3, :3] += _other(inertia, 0.5)
    return pseudo


def central(pseudo: Array) -> tuple[float, Array, Array]:
    """Return mass, centre of mass (3,) and inertia about it (3, 3) of a positive definite P, shape (4, 4)."""
    mass = float(pseudo[3, 3])
    center = pseudo[:3, 3] / mass
    spread = pseudo[:3, :3] - mass * np.outer(center, center)
    return mass, center, _other(0.5 * (spread + spread.T), 1.0)


def is_body(pseudo: Array) -> bool:
    """Tell whether a body of positive density has this P, shape (4, 4), finite and positive definite."""
    if not np.isfinite(pseudo).all() or not (np.diag(pseudo) > 0.0).all():
        return False
    scale = np.sqrt(np.diag(pseudo))
    return bool(np.linalg.eigvalsh(pseudo / np.outer(scale, scale))[0] > _MIN_EIGENVALUE)


@dataclass(frozen=True, eq=False)
class MovingBody:
    """One link of a URDF that moves with a joint.

    Attributes:
        link: its name.
        joint: which of the joints it moves with, from 0.
        frame: its frame in the frame of that joint, homogeneous, shape (4, 4).
        pseudo: pseudo-inertia by the URDF in the joint's frame, shape (4, 4); zeros without <inertial>.
    """

    link: str
    joint: int
    frame: Array
    pseudo: Array


_URDF_MOMENTS = ("ixx", "ixy", "ixz", "ixy", "iyy", "iyz", "ixz", "iyz", "izz")


def _moving_links(urdf: str, joints: Sequence[str]) -> tuple[list[MovingBody], Array]:
    """Return the links that move, and the frame farthest from each joint that moves with it, m, shape (n, 3).

    Pinocchio, and so the regressor, takes all links that are fixed to each other for one body; a URDF has them apart.
    Each joint's own link stands before those that are fixed to it. The farthest frame may be that of the next joint.

    Raises:
        IdentificationError: for a joint that the URDF does not have.
    """
    root = ET.fromstring(urdf)
    above = {_end(joint, "child"): joint for joint in root.findall("joint")}
    own = {str(joint.get("name")): link for link, joint in above.items()}
    for name in joints:
        if name not in own:
            raise IdentificationError(f"no joint {quoted(name)} in the URDF; accepted: {listed(own)}")

    def place(link: str) -> tuple[int | None, Array]:
        """Return the joint that a link moves with, None if it does not move, and its frame in that of the joint."""
        frame = np.eye(4)
        while link in above:
            if above[link].get("name") in joints:
                return joints.index(str(above[link].get("name"))), frame
            frame, link = _origin(above[link]) @ frame, _end(above[link], "parent")
        return None, frame

    bodies = []
    for element in root.findall("link"):
        link, inertial = element.get("name", ""), element.find("inertial")
        joint, frame = place(link)
        if joint is not None:
            pseudo = np.zeros((4, 4))
            if inertial is not None:
                mass, inertia = inertial.find("mass"), inertial.find("inertia")
                weight = 0.0 if mass is None else float(mass.get("value", "0"))
                moments = [0.0 if inertia is None else float(inertia.get(key, "0")) for key in _URDF_MOMENTS]
                to_joint = frame @ _origin(inertial)
                pseudo = to_joint @ _about_center(weight, np.zeros(3), np.reshape(moments, (3, 3))) @ to_joint.T
            bodies.append(MovingBody(link, joint, frame, pseudo))
    ends = np.zeros((len(joints), 3))
    for link, joint_above in above.items():
        joint, frame = place(link)
        if joint_above.get("name") in joints:
            joint, frame = place(_end(joint_above, "parent"))
            frame = frame @ _origin(joint_above)
        if joint is not None and np.linalg.norm(frame[:3, 3]) > np.linalg.norm(ends[joint]):
            ends[joint] = frame[:3, 3]
    return sorted(bodies, key=lambda body: (body.joint, body.link != own[joints[body.joint]])), ends


def _end(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _origin(parent: ET.Element) -> Array:
    """Return the homogeneous transform of an <origin>, shape (4, 4)."""
    origin = parent.find("origin")
    given = {} if origin is None else origin.attrib
    xyz, rpy = ([float(word) for word in given.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rpy_rotation(rpy), xyz
    return transform


_DENSITY = 1500.0  # kg/m^3: castings with motors in them, and with room left
_SLENDERNESS = 6.0  # length over radius of a link without <inertial>
_MIN_RADIUS_SHARE = 0.05  # its least radius, as a share of the arm's reach
_END_RADIUS = 0.2  # radius of one that ends at its joint, as a share of the others' mean length
_DEFAULT_REACH = 0.5  # m, of an arm whose joints all have one origin
_MIN_EQUAL_LINKS = 3  # so many links with the same <inertial> are no chance
_EQUAL = 1e-9


@dataclass(frozen=True, eq=False)
class InertialPrior:
    """Mass distributions and rotors to begin with, and to stay near to where the data say nothing.

    Attributes:
        joints: names of the n joints.
        bodies: the links that share the parameters, at least one for each joint; their pseudo-inertias are positive
            definite.
        known: parameters of the bodies that stay, summed for each joint, shape (n, 10).
        rotors: inertia of each rotor that has a column, seen at its joint, kg m^2, > 0, shape (k,).
        springs: amplitude of each spring that has a column, Nm, shape (s,); 0 for one of which nothing is known.
        guessed: which bodies, and then rotors, the description does not have, shape (b + k,).
        replaced: in words, what is not taken from the URDF, and what stands in its place.
        dropped: links whose <inertial> no body can have; the other links of their joint take their share.
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
        rotors: ArrayLike = (),
        springs: ArrayLike = (),
        known: Collection[str] = (),
    ) -> InertialPrior:
        """Return the prior of an arm.

        Args:
            urdf: file, or its text.
            joints: n names from base to tip.
            rotors: inertia of the rotors of the first k joints, seen at these, kg m^2, shape (k,); 0 for one of which
                nothing is known: it begins at the mean moment of inertia of its joint's body.
            springs: as the attribute.
            known: links whose <inertial> is known and stays, such as a tool that was weighed.

        Raises:
            IdentificationError: for a joint that is not there, and rotors or springs that are negative or too many.
        """
        names, text = tuple(joints), urdf.read_text(encoding="utf-8") if isinstance(urdf, Path) else urdf
        links, ends = _moving_links(text, names)
        stay, free = np.zeros((len(names), 10)), [body for body in links if body.link not in known]
        for body in links:
            if body.link in known:
                stay[body.joint] += inertial_parameters(body.pseudo)
        own = [next(body for body in free if body.joint == joint) for joint in range(len(names))]
        # As exporters fill it in: all joints' own links the same.
        same = all(np.abs(one.pseudo - own[0].pseudo).max() <= _EQUAL for one in own)
        filled = len(own) >= _MIN_EQUAL_LINKS and bool(own[0].pseudo.any()) and same
        bodies: list[MovingBody] = []
        guessed, words = [], []
        for joint, name in enumerate(names):
            mine = [body for body in free if body.joint == joint]
            real = [] if filled else [body for body in mine if is_body(body.pseudo)]
            guessed += [False] * len(real) or [True]
            bodies += real
            if not real:
                bodies.append(_by_geometry(mine[0], ends))
                given = any(one.pseudo.any() for one in mine)
                why = "the same for all links" if filled else "none that a body can have" if given else "missing"
                words.append(
                    f"{mine[0].link} at {name}: <inertial> is {why}; begins as an ellipsoid of {_DENSITY:g} kg/m^3 "
                    f"along the link, {bodies[-1].pseudo[3, 3]:.3g} kg"
                )
        kept = {body.link for body in bodies}
        dropped = tuple(body.link for body in free if body.pseudo.any() and body.link not in kept)
        begun, amplitudes = (np.array(values, dtype=np.float64).reshape(-1) for values in (rotors, springs))
        for what, values in (("rotor inertias", begun), ("springs", amplitudes)):
            if len(values) > len(names) or not np.isfinite(values).all() or (values < 0.0).any():
                accepted = f"finite numbers >= 0, at most {len(names)}"
                raise IdentificationError(f"{what} {values.tolist()}; accepted: {accepted}")
        guesses = np.append(np.array(guessed, dtype=bool), begun == 0.0)
        for i in np.flatnonzero(begun == 0.0).tolist():
            total = np.sum([inertial_parameters(body.pseudo) for body in bodies if body.joint == i], axis=0)
            begun[i] = total[[4, 6, 9]].mean()
            words.append(f"rotor of {names[i]}: begins at {begun[i]:.3g} kg m^2, the mean moment of its link")
        return cls(names, tuple(bodies), stay, begun, amplitudes, guesses, tuple(words), dropped)


def _by_geometry(body: MovingBody, ends: Array) -> MovingBody:
    """Return a link as a solid ellipsoid from its joint to the farthest frame that moves with it."""
    end = ends[body.joint]
    length = float(np.linalg.norm(end))
    reach = float(np.linalg.norm(ends, axis=1).sum()) or _DEFAULT_REACH
    others = max(1, int(ends.any(axis=1).sum()))
    radius = max(length / _SLENDERNESS, _MIN_RADIUS_SHARE * reach) if length else _END_RADIUS * reach / others
    half = max(0.5 * length, radius)
    along = end / length if length > 0.0 else np.zeros(3)
    mass = _DENSITY * 4.0 / 3.0 * np.pi * half * radius**2
    spread = mass / 5.0 * (radius**2 * np.eye(3) + (half**2 - radius**2) * np.outer(along, along))
    return replace(body, pseudo=_about_center(mass, 0.5 * end, _other(spread, 1.0)))


_PRIOR_WEIGHT = 1.0  # of logarithms with a deviation of 1: a description is right but for factors of some e
_GUESS_WEIGHT = 0.1  # of what the description does not have: right but for factors of some 20
_MAX_EVALUATIONS = 500  # for each weight of the prior
_MAX_NULL_ENTRY = 1e-6  # of a parameter in the mapping's null space, to be determined by itself
_MIN_SINGULAR_VALUE = 1e-9  # of the mapping, relative: less is rounding
_TOOL = "tool"  # the link that a tool file adds: its inertial is known
_ROWS, _COLUMNS = np.tril_indices(4)
_DIAGONAL = _ROWS == _COLUMNS


@dataclass(frozen=True, eq=False)
class BaseEstimate:
    """Identified base parameters.

    Attributes:
        mapping: K, shape (p, P), from P standard parameters to the base parameters: ten of each joint's body in
            Pinocchio's order, the inertias of k rotors, the amplitudes of s springs, and others, such as offsets. Those
            others, and springs without a prior, may be anything.
        value: SI units, shape (p,).
        covariance: shape (p, p); infinite on the diagonal where the data do not determine a parameter: its value then
            counts for nothing.
        information: R, shape (m, p): R^T R is the inverse of the covariance that independent noise would give.
    """

    mapping: Array
    value: Array
    covariance: Array
    information: Array

    @property
    def determined(self) -> Mask:
        """Return which parameters the data determine, shape (p,)."""
        return np.isfinite(np.diag(self.covariance))

    def distance(self, shift: Array) -> float:
        """Return the Mahalanobis distance of a shift, shape (p,), over the root of the number of its parameters."""
        known = np.flatnonzero(self.determined)
        deviation = np.sqrt(np.diag(self.covariance)[known])
        correlation = self.covariance[np.ix_(known, known)] / np.outer(deviation, deviation)
        size = shift[known] / deviation
        square = float(size @ np.linalg.pinv(correlation, rcond=_MIN_SINGULAR_VALUE, hermitian=True) @ size)
        return math.sqrt(max(square, 0.0) / len(known))


@dataclass(frozen=True, eq=False)
class ConsistentInertias:
    """Bodies and rotors that can exist, near to what was identified.

    Attributes:
        prior: where they began.
        pseudo: of each body, in the frame of its joint, shape (b, 4, 4).
        rotors: kg m^2, > 0, shape (k,).
        parameters: the standard parameters, bodies that stay included, shape (P,).
        base: their base parameters, shape (p,).
        shift: base parameters less the identified ones, shape (p,); 0 for what the data do not determine.
        distance: Mahalanobis distance of the shift over the root of their number: at most about 1 within the noise.
        alone: which standard parameters the data determine by themselves, not only as part of a sum, shape (P,).
    """

    prior: InertialPrior
    pseudo: Array
    rotors: Array
    parameters: Array
    base: Array
    shift: Array
    distance: float
    alone: Mask


@dataclass(frozen=True, eq=False)
class Consistency:
    """Inertias that bodies can have, and what they cost: RMS along the runs at each of n joints, Nm, shape (n,).

    Attributes:
        inertias: nearest to the identified base parameters.
        added: torque that the shift of the base parameters adds; 0 for a joint without rows, here and below.
        before: residuals with the base parameters as identified.
        after: residuals with the shifted ones.
    """

    inertias: ConsistentInertias
    added: Array
    before: Array
    after: Array


def make_consistent(
    problem: ExcitationProblem, friction: FrictionSelection, robot: RecordedRobot, options: RobotOptions
) -> Consistency:
    """Return the consistent inertias nearest to the base parameters of a fit.

    Args:
        problem: the equations.
        friction: the fit.
        robot: whose description says where inertias, rotors and springs begin.
        options: that describe it.

    Raises:
        IdentificationError: if there are none.
    """
    count, arm, fit = len(problem.names), problem.arm, friction.fit
    description: Path | str = Path(str(options.urdf))
    n = len(arm.names)
    rotors: ArrayLike = problem.columns.values()[10 * n : 11 * n]
    known: tuple[str, ...] = ()
    if robot.setup is not None:
        description, rotors = robot.setup.robot.urdf, robot.setup.drives.rotor_inertia
        known = () if (robot.setup.files or RobotFiles()).tool is None else (_TOOL,)
    prior = InertialPrior.of_urdf(description, arm.names, rotors, arm.spring[problem.columns.springs], known)
    information = base_information(problem, linear_columns(friction, problem)[1], fit)
    covariance = fit.covariance[:count, :count]
    estimate = BaseEstimate(problem.base.combination, fit.value[:count], covariance, information)
    inertias = consistent_inertias(estimate, prior)
    residual, added = problem.torque - friction.predicted, problem.regressor @ inertias.shift
    rows = np.maximum(np.bincount(problem.joint, minlength=len(arm.names)), 1)
    squares = [np.bincount(problem.joint, one**2, len(arm.names)) for one in (added, residual, residual - added)]
    return Consistency(inertias, *(np.sqrt(one / rows) for one in squares))


def base_information(problem: ExcitationProblem, friction: Array, fit: LinearFit) -> Array:
    """Return a root of the information of the weighted rows on the b base parameters, friction free, shape (b, b).

    Neighbouring rows share their errors: it is scaled to variances that are those of the covariance, in the median.

    Args:
        problem: r rows.
        friction: columns of the friction, shape (r, f).
        fit: of base parameters and friction.
    """
    count = len(problem.names)
    weight = np.sqrt(fit.weights) / fit.sigma[problem.joint]
    columns = np.hstack([friction, problem.regressor]) * weight[:, None]
    root = np.asarray(np.linalg.qr(columns, mode="r"))[-count:, -count:]
    variance = np.diag(fit.covariance)[:count]
    white = np.diag(np.linalg.pinv(root.T @ root, hermitian=True))
    share = np.median((white / variance)[np.isfinite(variance)])
    return np.asarray(root * math.sqrt(min(1.0, float(share))))


def consistent_inertias(
    estimate: BaseEstimate, prior: InertialPrior, weight: float = _PRIOR_WEIGHT
) -> ConsistentInertias:
    """Return the consistent inertias nearest to the identified base parameters and to the prior.

    Args:
        estimate: of the base parameters.
        prior: of links and rotors.
        weight: w, of the prior.

    Raises:
        IdentificationError: if nothing is determined, and if the search ends at no minimum.
    """
    known, mapping = estimate.determined, estimate.mapping
    if not known.any():
        raise IdentificationError(
            f"none of {len(known)} base parameters is determined; accepted: runs that determine some"
        )
    unknowns = _Unknowns(prior, mapping.shape[1])
    whitened = estimate.information[:, known] @ mapping[known]
    target = estimate.information[:, known] @ estimate.value[known]
    u = np.zeros(len(unknowns.distance))
    # Sharp data lead a search from afar astray: it begins with a weight with which the prior alone would do.
    squares = float(np.sum((whitened @ unknowns.parameters(u) - target) ** 2))
    for decade in range(max(0, math.ceil(math.log10(max(squares, 1.0) / weight))), -1, -1):
        near = np.diag(math.sqrt(weight * 10.0**decade) * unknowns.distance)
        u = np.asarray(least_squares(
            lambda u, near=near: np.concatenate([whitened @ unknowns.parameters(u) - target, near @ u]),  # type: ignore[misc]
            u,
            lambda u, near=near: np.vstack([whitened @ unknowns.slopes(u), near]),  # type: ignore[misc]
            max_nfev=_MAX_EVALUATIONS,
        ).x)  # fmt: skip
    # Where no body comes near, the search may end before the minimum, which lies at infinity.
    if not np.isfinite(u).all():
        raise IdentificationError(
            "no consistent inertias near the base parameters found; accepted: base parameters of this arm, and a "
            "description with inertials of their order of magnitude"
        )
    parameters = unknowns.parameters(u)
    base = mapping @ parameters
    shift = np.where(known, base - estimate.value, 0.0)
    # Those that the null space of the mapping has not are determined by themselves.
    _, sizes, rows = np.linalg.svd(mapping[known] / np.maximum(np.linalg.norm(mapping[known], axis=0), 1e-300))
    null = rows[int((sizes > _MIN_SINGULAR_VALUE * sizes[0]).sum()) :]
    alone = np.asarray(np.linalg.norm(null, axis=0) < _MAX_NULL_ENTRY)
    first, distance = 10 * len(prior.joints), estimate.distance(shift)
    rotors = parameters[first : first + len(prior.rotors)]
    return ConsistentInertias(prior, unknowns.pseudo(u), rotors, parameters, base, shift, distance, alone)


class _Unknowns:
    """Parameters as functions of unknowns u, all 0 at the prior.

    Ten for each body: the entries of M below the diagonal and half the logarithms of D; one for each rotor and each
    spring with a prior, half the logarithm of its ratio to it; then one for each other parameter, its value.
    `distance`, shape (N,), is what the unknowns are multiplied by in the distance from the prior.
    """

    def __init__(self, prior: InertialPrior, count: int) -> None:
        self._joint = [body.joint for body in prior.bodies]
        self._scale = np.linalg.cholesky(np.array([body.pseudo for body in prior.bodies]))
        self._bodies, first = 10 * len(prior.bodies), 10 * len(prior.joints)
        begun = np.concatenate([prior.rotors, prior.springs, np.zeros(count)])[: count - first]
        self._positive, self._other = first + np.flatnonzero(begun), first + np.flatnonzero(begun == 0.0)
        self._begun = begun[begun != 0.0]
        self._known = np.append(prior.known.ravel(), np.zeros(len(begun)))
        self._bounded = self._bodies + len(self._positive)
        entries = np.tile(np.where(_DIAGONAL, 2.0, math.sqrt(2.0)), len(prior.bodies))
        self.distance = np.concatenate([entries, np.full(len(self._begun), 2.0), np.zeros(len(self._other))])
        guessed = np.repeat(prior.guessed, [10] * len(prior.bodies) + [1] * len(prior.rotors))
        self.distance[: len(guessed)] *= np.where(guessed, math.sqrt(_GUESS_WEIGHT), 1.0)

    def _factors(self, u: Array) -> tuple[Array, Array]:
        """Return L0 M and the roots of D of each body, shapes (b, 4, 4) and (b, 4)."""
        entries = u[: self._bodies].reshape(-1, 10)
        unit = np.zeros((len(entries), 4, 4))
        unit[:, _ROWS, _COLUMNS] = np.where(_DIAGONAL, 1.0, entries)
        return self._scale @ unit, np.exp(entries[:, _DIAGONAL])

    def pseudo(self, u: Array) -> Array:
        """Return the pseudo-inertias of the bodies, shape (b, 4, 4)."""
        factors, roots = self._factors(u)
        scaled = factors * roots[:, None, :]
        return np.asarray(scaled @ np.swapaxes(scaled, 1, 2))

    def parameters(self, u: Array) -> Array:
        """Return all standard parameters, shape (P,)."""
        result = self._known.copy()
        for joint, values in zip(self._joint, inertial_parameters(self.pseudo(u)), strict=True):
            result[10 * joint : 10 * joint + 10] += values
        result[self._positive] = self._begun * np.exp(2.0 * u[self._bodies : self._bounded])
        result[self._other] = u[self._bounded :]
        return result

    def slopes(self, u: Array) -> Array:
        """Return the derivatives of the parameters, shape (P, N)."""
        result = np.zeros((len(self._known), len(u)))
        for b, (factor, roots) in enumerate(zip(*self._factors(u), strict=True)):
            # dP = L0 dM D (L0 M)^T and its transpose; a logarithm changes both factors as M's own column would.
            left = np.where(_DIAGONAL[:, None], factor.T[_COLUMNS], self._scale[b].T[_ROWS])
            half = left[:, :, None] * (factor * roots**2).T[_COLUMNS][:, None, :]
            rows = slice(10 * self._joint[b], 10 * self._joint[b] + 10)
            result[rows, 10 * b : 10 * b + 10] = inertial_parameters(half + np.swapaxes(half, 1, 2)).T
        positive = np.arange(self._bodies, self._bounded)
        result[self._positive, positive] = 2.0 * self._begun * np.exp(2.0 * u[positive])
        result[self._other, np.arange(self._bounded, len(u))] = 1.0
        return result
