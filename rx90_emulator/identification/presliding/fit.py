"""Identify the presliding regime, c0 and c1, from micro-oscillations (paper, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from rx90_common.base.errors import IdentificationError
from rx90_common.friction import LuGreElement
from rx90_emulator.identification.model.estimates import PRESLIDING, ElementEstimate, ParameterEstimate
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.bristle_path import thinned
from rx90_emulator.identification.presliding.micro_motion import MicroMotion, find_micro_motions, most_telling
from rx90_emulator.identification.presliding.solver import GroupSolution, solve_group
from rx90_emulator.identification.records.record import JointRecord

Array = NDArray[np.float64]

_UNTOLD = 0.3  # standard deviation of ln c0 or ln c1 from which the data do not tell it
_NEAR_SLIDING = 0.75  # of an element's Coulomb torque: beyond it small errors of the motion bend bristles far
_ALL_SLIDING = 0.95  # of it: bristles slide
_MISFIT = 0.3  # of the friction torque
_WRONG_INERTIA = 2.0  # deviations that errors of the inertia would have if they were as small as is assumed


@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """One micro-motion of one joint, measured and simulated.

    Attributes:
        joint: its name.
        position: measured, rad from the mean, shape (m,).
        torque: friction torque: drive less weight and measured acceleration, Nm, shape (m,).
        simulated_torque: of the bristles bent along this motion, Nm, shape (m,).
    """

    joint: str
    position: Array
    torque: Array
    simulated_torque: Array


@dataclass(frozen=True, eq=False)
class PreslidingFit:
    """The presliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in PRESLIDING.
        loops: the largest micro-motion of each joint that has any.
        motions: how many micro-motions were used.
    """

    estimates: tuple[ElementEstimate, ...]
    loops: tuple[HysteresisLoop, ...]
    motions: int


def identify_presliding(
    records: Sequence[JointRecord],
    arm: RigidArm,
    sliding: Sequence[LuGreElement],
    torque_delay: float = 0.0,
    sliding_covariances: Sequence[Array] | None = None,
    plant_period: float | None = None,
) -> PreslidingFit:
    """Fit c0 and c1 of every element whose joints make micro-oscillations.

    Args:
        records: motion with reversals far within the bristles' reach, 500 samples per second or more.
        arm: rigid-body model of the same joints.
        sliding: the sliding regime of the arm's elements, in its order; their c0 and c1 are not looked at.
        torque_delay: how much later than its stamp a recorded torque acted, s.
        sliding_covariances: of each element's sliding regime, in the order of SLIDING, shape (7, 7); none if it is
            known exactly.
        plant_period: tick of the simulation that made the records, s, whose half a tick of prediction the bristles
            felt; None for a real robot.

    Raises:
        IdentificationError: for other joints than the arm's, a record that is too slow, and no reversal at all.
    """
    for record in records:
        if tuple(record.names) != tuple(arm.names):
            raise IdentificationError(
                f"{record.source}: joints {', '.join(record.names)}; accepted: {', '.join(arm.names)}"
            )
    groups = joint_groups(arm)
    motions = [motion for record in records for motion in find_micro_motions(record, arm, groups, torque_delay)]
    if not motions:
        where = ", ".join(str(record.source) for record in records) or "no bag"
        raise IdentificationError(
            f"{where}: no velocity reversals small enough for the presliding regime; accepted: oscillations of "
            "some 0.1 mrad at some 3 to 30 Hz, such as rx90_experiment makes"
        )
    unknown = "no micro-oscillation of its joints in the bags"
    estimates = [ElementEstimate.unknown(name, PRESLIDING, unknown) for name in arm.element_names]
    loops: list[HysteresisLoop] = []
    used = 0
    for group in groups:
        own = [motion for motion in motions if motion.joints == group]
        if not own:
            continue
        members = _members(arm, group)
        inputs = arm.element_matrix[members][:, list(group)]
        fitted = [sliding[e] for e in members]
        chosen = most_telling(own, np.abs(inputs).T @ np.array([e.tau_c_positive for e in fitted]))
        spread = None if sliding_covariances is None else block_diag(*(sliding_covariances[e] for e in members))
        if len(members) > 1:
            chosen = _gentle(chosen, inputs, fitted, plant_period)
        solution = solve_group(chosen, inputs, fitted, spread, plant_period)
        used += len(chosen)
        for place, e in enumerate(members):
            names = [arm.names[joint] for joint in group]
            estimates[e] = _estimate(arm.element_names[e], solution, place, (inputs[place], names), chosen)
        loops += _loops(arm, chosen, solution)
    return PreslidingFit(tuple(estimates), tuple(loops), used)


def joint_groups(arm: RigidArm) -> list[tuple[int, ...]]:
    """Return the joints in groups that share no friction element, from base to tip."""
    groups = [{j} for j in range(len(arm.names))]
    for row in arm.element_matrix:
        joined: set[int] = set(np.flatnonzero(row).tolist())
        touched = [group for group in groups if group & joined]
        groups = [group for group in groups if not group & joined] + [set().union(*touched)]
    return sorted(tuple(sorted(group)) for group in groups)


def _members(arm: RigidArm, group: Sequence[int]) -> list[int]:
    return np.flatnonzero(arm.element_matrix[:, list(group)].any(axis=1)).tolist()


def _gentle(
    motions: list[MicroMotion], inputs: Array, sliding: Sequence[LuGreElement], plant_period: float | None
) -> list[MicroMotion]:
    """Leave out the motions in which an element nearly slides, though its joints' torques are far from break-away."""
    loads = solve_group(motions, inputs, sliding, None, plant_period).loads.max(axis=1)
    return [motion for motion, load in zip(motions, loads, strict=True) if load < _NEAR_SLIDING] or motions


def _estimate(
    name: str,
    solution: GroupSolution,
    place: int,
    joints: tuple[Array, Sequence[str]],
    motions: Sequence[MicroMotion],
) -> ElementEstimate:
    block = solution.covariance[2 * place : 2 * place + 2, 2 * place : 2 * place + 2]
    relative = np.sqrt(np.maximum(np.diag(block), 0.0))
    doubt = _doubt(solution, place, *joints)
    parameters = {}
    for key, value, deviation in zip(PRESLIDING, solution.values[place], relative, strict=True):
        if doubt:
            parameters[key] = ParameterEstimate.unknown(doubt)
        elif not deviation < _UNTOLD:
            parameters[key] = ParameterEstimate.unknown(
                f"relative standard deviation {deviation:.2g} at a value of {value:.3g}"
            )
        else:
            parameters[key] = ParameterEstimate(float(value), float(value * deviation))
    return ElementEstimate.of(name, parameters, block, tuple(dict.fromkeys(motion.record.bag for motion in motions)))


def _doubt(solution: GroupSolution, place: int, inputs: Array, names: Sequence[str]) -> str:
    """Return why the model does not hold for an element; empty if it does.

    Args:
        solution: of its group.
        place: of the element in the group.
        inputs: of the element, from the group's k joints, shape (k,).
        names: of these joints.
    """
    load = float(solution.loads[:, place].min())
    if load > _ALL_SLIDING:
        return f"its bristles slide in every micro-oscillation: {load:.2g} of the Coulomb torque or more"
    # A wrong inertia of one joint spoils what its neighbours' elements are told apart by.
    strain = np.abs(solution.strain).max(axis=1)
    worst = int(np.argmax(strain))
    if strain[worst] > _WRONG_INERTIA:
        error = 100.0 * float(np.abs(solution.inertia[worst]).max())
        return (
            f"the inertia at {names[worst]} would be {error:.0f} % off the description's: a payload, a rotor or the "
            "torque's delay may be missing"
        )
    for joint in np.flatnonzero(inputs).tolist():
        if solution.misfit[joint] > _MISFIT:
            return (
                f"the torque of {names[joint]} is missed by {100.0 * solution.misfit[joint]:.0f} % of its friction: "
                "another delay of the torque, another inertia, or no bristles"
            )
    return ""


def _loops(arm: RigidArm, motions: Sequence[MicroMotion], solution: GroupSolution) -> list[HysteresisLoop]:
    loops = []
    for place, joint in enumerate(motions[0].joints):
        largest = int(np.argmax([motion.position[:, place].std() for motion in motions]))
        motion = motions[largest]
        accelerated = motion.acceleration @ motion.mass.T
        position = thinned(motion.position[:, place])
        measured = thinned(motion.drive - accelerated)[:, place]
        simulated = solution.torque[largest][:, place]
        loops.append(HysteresisLoop(arm.names[joint], position - position.mean(), measured, simulated))
    return loops
