"""The bodies that the files hold: what they cost beside the base parameters, and what a reader is told of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from rx90_common.base.arrays import Array
from rx90_common.base.quoting import listed
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.excitation.friction import FrictionSelection, linear_columns
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.excitation.physical import BaseEstimate, ConsistentInertias, consistent_inertias
from rx90_emulator.identification.excitation.prior import InertialPrior
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.options import RobotOptions
from rx90_emulator.identification.robot import RecordedRobot

FAR = 2.0
"""Standard deviations, RMS, from which on bodies are far from the base parameters."""
_TOOL = "tool"  # the link that a tool file adds: its inertial is known


@dataclass(frozen=True, eq=False)
class Consistency:
    """Inertias that bodies can have, and what they cost: RMS along the runs at each of n joints, Nm, shape (n,).

    Attributes:
        inertias: nearest to the identified base parameters.
        shares: RMS residual over RMS torque, all joints together: with the base parameters, with the inertias.
        added: torque that the shift of the base parameters adds; 0 for a joint without rows, here and below.
        before: residuals with the base parameters as identified.
        after: residuals with the shifted ones.
    """

    inertias: ConsistentInertias
    shares: tuple[float, float]
    added: Array
    before: Array
    after: Array

    @property
    def text(self) -> str:
        """Return in words how far the bodies are from the base parameters, and what that costs."""
        before, after = self.shares
        return (
            f"bodies in the files: {self.inertias.distance:.2g} standard deviations from the base parameters (RMS; up "
            f"to about 1 is noise); torque RMS of the fitted runs {after:.1%} with them, {before:.1%} without"
        )

    @property
    def open_text(self) -> str:
        """Return in words at which joints the runs tell no mass, and where it stays; "" if there are none."""
        prior, words = self.inertias.prior, []
        real = {body.joint for body, guess in zip(prior.bodies, prior.guessed, strict=False) if not guess}
        for described, near in ((True, "the description's"), (False, "plausible ones, ellipsoids along the links")):
            joints = [name for k, name in enumerate(prior.joints) if self.inertias.open[k] and (k in real) == described]
            words += [f"what {listed(joints)} move{'s' * (len(joints) == 1)} stays near {near}"] if joints else []
        return f"masses that the runs do not tell: {'; '.join(words)}" if words else ""

    @property
    def warning(self) -> str:
        """Return a warning if the bodies are far from the base parameters, else ""."""
        if self.inertias.distance <= FAR:
            return ""
        before, after = self.shares
        return (
            f"the bodies in the files are {self.inertias.distance:.3g} standard deviations from the base parameters "
            f"(RMS; up to {FAR:g} passes): torque RMS {after:.1%} in place of {before:.1%}. No bodies near the "
            "description have these: is a known tool, a payload, a zero or the sign of a torque another one, or do "
            "the torques hold no rotors (--no-rotors)?"
        )


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
    rotors: ArrayLike | None = problem.columns.values()[10 * n : 11 * n] if problem.columns.rotors else None
    known: tuple[str, ...] = ()
    if robot.setup is not None:
        description, rotors = robot.setup.robot.urdf, robot.setup.drives.rotor_inertia
        known = () if (robot.setup.files or RobotFiles()).tool is None else (_TOOL,)
    prior = InertialPrior.of_urdf(description, arm.names, rotors, arm.spring[problem.columns.springs], known)
    information = base_information(problem, linear_columns(friction, problem)[1], fit)
    estimate = BaseEstimate(problem.base.combination, fit.value[:count], information, fit.determined[:count])
    inertias = consistent_inertias(estimate, prior)
    residual, change = problem.torque - friction.predicted, problem.regressor @ inertias.shift
    rows = np.maximum(np.bincount(problem.joint, minlength=len(arm.names)), 1)
    squares = [np.bincount(problem.joint, one**2, len(arm.names)) for one in (change, residual, residual - change)]
    size = float(np.linalg.norm(problem.torque))
    shares = float(np.linalg.norm(residual)) / size, float(np.linalg.norm(residual - change)) / size
    added, before, after = (np.sqrt(one / rows) for one in squares)
    return Consistency(inertias, shares, added, before, after)


def base_information(problem: ExcitationProblem, friction: Array, fit: LinearFit) -> Array:
    """Return a root of the information of the weighted rows on the b base parameters, friction as it is, shape (b, b).

    Neighbouring rows share their errors: it is scaled to variances that are those of the covariance, in the median.

    Args:
        problem: r rows.
        friction: columns of the friction, shape (r, f).
        fit: of base parameters and friction.
    """
    count = len(problem.names)
    weight = np.sqrt(fit.weights) / fit.sigma[problem.joint]
    root = np.asarray(np.linalg.qr(np.hstack([problem.regressor, friction]) * weight[:, None], mode="r"))
    variance = np.diag(fit.covariance)[:count]
    white = np.sum(np.linalg.pinv(root)[:count] ** 2, axis=1)
    share = np.median((white / variance)[np.isfinite(variance)])
    return np.asarray(root[:count, :count] * math.sqrt(min(1.0, float(share))))


def written_arm(problem: ExcitationProblem, consistency: Consistency) -> RigidArm:
    """Return the arm that the files hold, with the offsets of its torques."""
    arm, columns, values = problem.arm, problem.columns, consistency.inertias.parameters
    n, spring = len(arm.names), arm.spring.copy()
    spring[columns.springs] = values[11 * n : 11 * n + len(columns.springs)]
    bodies = arm.with_bodies(values[: 10 * n], values[10 * n : 11 * n])
    return replace(bodies, spring=spring, offset=values[-n:])
