"""From the base parameters of a fit to inertias that a robot's files can hold, and what these cost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.description.tool import TOOL_LINK
from rx90_emulator.identification.excitation.least_squares import LinearFit
from rx90_emulator.identification.excitation.physical.cost import TorqueCost, torque_cost
from rx90_emulator.identification.excitation.physical.fit import BaseEstimate, ConsistentInertias, consistent_inertias
from rx90_emulator.identification.excitation.physical.prior import InertialPrior
from rx90_emulator.identification.excitation.physical.pseudo_inertia import central
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.model.robot import RecordedRobot


@dataclass(frozen=True, eq=False)
class IdentifiedInertias:
    """Inertias that can exist, and what they cost along the runs.

    Attributes:
        bodies: the inertias.
        cost: in torque.
        names: of the base parameters.
    """

    bodies: ConsistentInertias
    cost: TorqueCost
    names: tuple[str, ...]

    @property
    def links(self) -> tuple[tuple[str, float, float, Array, Array], ...]:
        """Return of each link name, mass and the prior's mass, kg, centre of mass, m, and principal moments, kg m^2."""
        rows = []
        for body, pseudo in zip(self.bodies.prior.bodies, self.bodies.pseudo, strict=True):
            inverse = np.linalg.inv(body.frame)
            mass, center, inertia = central(inverse @ pseudo @ inverse.T)
            moments = np.array(np.linalg.eigvalsh(inertia), dtype=np.float64)
            rows.append((body.link, mass, float(body.pseudo[3, 3]), center, moments))
        return tuple(rows)

    @property
    def lines(self) -> tuple[str, ...]:
        """Return how far the base parameters had to move, what that costs, and what the description lacked."""
        bodies, cost = self.bodies, self.cost
        far, joint = int(np.abs(bodies.deviations).argmax()), int(cost.added.argmax())
        moved = (
            f"consistent inertias: base parameters moved by {bodies.distance:.2g} deviations (RMS), {self.names[far]} "
            f"by {bodies.deviations[far]:+.2g}; that changes the torque by {cost.added[joint]:.2g} Nm RMS at most "
            f"({bodies.prior.joints[joint]}: residual {cost.before[joint]:.3g} Nm, then {cost.after[joint]:.3g} Nm)"
        )
        dropped = [f"{link}: its <inertial> is none that a body can have; left out" for link in bodies.prior.dropped]
        return (moved, *bodies.prior.replaced, *dropped)


def identify_inertias(robot: RecordedRobot, problem: ExcitationProblem, fit: LinearFit) -> IdentifiedInertias:
    """Return the consistent inertias nearest to what was fitted; their prior is the robot's description.

    A tool from a tool file is known, and stays.

    Args:
        robot: that was recorded.
        problem: b base parameters.
        fit: whose first b parameters these are.

    Raises:
        IdentificationError: for a robot without a URDF.
    """
    if robot.urdf is None:
        raise IdentificationError("a robot without a URDF; accepted: one that was read from a URDF")
    base, arm, count = problem.base, problem.arm, len(problem.names)
    inverse = np.linalg.inv(arm.coupling)
    rotors = np.diag(inverse.T @ arm.rotor @ inverse)
    springs = [k for joint, k in enumerate(arm.spring.tolist()) if f"k_{joint + 1}" in base.standard]
    own = robot.setup
    text, known = (robot.urdf, ()) if own is None else (own.robot.urdf, (TOOL_LINK,))
    prior = InertialPrior.of_urdf(text, arm.names, rotors, springs, known)
    value, covariance = fit.value[:count], fit.covariance[:count, :count]
    bodies = consistent_inertias(BaseEstimate(base.names, base.combination, value, covariance), prior)
    cost = torque_cost(problem.regressor, problem.joint, fit.residual, bodies.shift, len(arm.names))
    return IdentifiedInertias(bodies, cost, base.names)
