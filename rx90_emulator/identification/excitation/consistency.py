"""From base parameters to inertias that bodies can have, near to those of the arm's description."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.identification.excitation.bodies import InertialPrior
from rx90_emulator.identification.excitation.friction.estimates import FrictionSelection
from rx90_emulator.identification.excitation.physical.cost import TorqueCost, torque_cost
from rx90_emulator.identification.excitation.physical.fit import BaseEstimate, ConsistentInertias, consistent_inertias
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.model.options import RobotOptions
from rx90_emulator.identification.model.robot import RecordedRobot

_TOOL = "tool"  # the link that a tool file adds: what it weighs is known


@dataclass(frozen=True, eq=False)
class Consistency:
    """Inertias that bodies can have, and what they cost.

    Attributes:
        inertias: nearest to the identified base parameters.
        cost: in torque, along the runs.
    """

    inertias: ConsistentInertias
    cost: TorqueCost


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
    count, arm = len(problem.names), problem.arm
    known: tuple[str, ...] = ()
    springs = arm.spring[list(problem.columns.springs)]
    if robot.setup is None:
        description: Path | str = Path(str(options.urdf))
        rotors = np.zeros(len(arm.names)) if options.rotor_inertia is None else np.array(options.rotor_inertia)
    else:
        description, rotors = robot.setup.robot.urdf, robot.setup.drives.rotor_inertia
        files = robot.setup.files or RobotFiles()
        known = () if files.tool is None else (_TOOL,)
    prior = InertialPrior.of_urdf(description, arm.names, rotors, springs, known)
    fit = friction.fit
    estimate = BaseEstimate(problem.names, problem.base.combination, fit.value[:count], fit.covariance[:count, :count])
    inertias = consistent_inertias(estimate, prior)
    residual = problem.torque - friction.predicted
    return Consistency(
        inertias, torque_cost(problem.regressor, problem.joint, residual, inertias.shift, len(arm.names))
    )
