"""Identify the presliding regime, c0 and c1, from micro-oscillations (paper, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.model.estimates import (
    LARGEST_DEVIATION,
    PRESLIDING,
    ElementEstimate,
    ParameterEstimate,
)
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.band import block_means
from rx90_emulator.identification.presliding.group_model import JointGroup, joint_groups
from rx90_emulator.identification.presliding.kind_model import KindMotion, largest_motions
from rx90_emulator.identification.presliding.kinds import MOST_MOTIONS, MOST_OF_BAG
from rx90_emulator.identification.presliding.micro_motion import MicroMotion, find_micro_motions, most_informative
from rx90_emulator.identification.presliding.solver import GroupSolution, fit_group
from rx90_emulator.identification.records.record import BagSource, JointRecord

_NEAR_SLIDING = 0.75  # of an element's Coulomb torque: beyond it small errors of the motion deflect bristles far
_ALL_SLIDING = 0.95  # of it: bristles slide
_MISFIT = 0.3  # of the friction torque
_WRONG_INERTIA = 2.0  # standard deviations of the inertia's errors if the prior held
_REACTIONS = "its joints were moved by the reactions of others alone; accepted: micro-oscillations of their own"


@dataclass(frozen=True, eq=False)
class HysteresisLoop:
    """One micro-motion of one joint, measured and simulated.

    Attributes:
        joint: its name.
        position: measured, rad from the mean, shape (m,).
        torque: friction torque, drive less weight and measured acceleration, Nm, shape (m,).
        simulated_torque: of the bristles deflected along this motion, Nm, shape (m,).
    """

    joint: str
    position: Array
    torque: Array
    simulated_torque: Array


@dataclass(frozen=True, eq=False)
class MovedGroup:
    """The largest micro-motions of joints that share their friction elements with no other joint.

    Attributes:
        elements: indices of its e elements.
        motions: the largest first; MOST_MOTIONS at most of a single element, else MOST_OF_BAG of each bag.
        c0: of LuGre's bristles, Nm/rad, shape (e,).
        sources: their bags.
    """

    elements: tuple[int, ...]
    motions: tuple[KindMotion, ...]
    c0: Array
    sources: tuple[BagSource, ...]

    @classmethod
    def of(
        cls, group: JointGroup, motions: Sequence[MicroMotion], sliding: Sequence[FrictionElement], c0: Array
    ) -> MovedGroup:
        """Return them of all micro-motions of a group.

        Args:
            group: the joints.
            motions: of them, one or more.
            sliding: the elements' sliding regime.
            c0: as the attribute.
        """
        break_away = np.abs(group.inputs).T @ np.array([one.tau_c_positive for one in sliding])
        if len(group.elements) == 1:
            largest = largest_motions(motions, break_away, MOST_MOTIONS)
        else:  # one direction of motion moves some elements only, and each is recorded in a bag of its own
            bags: dict[str, list[MicroMotion]] = {}
            for motion in motions:
                bags.setdefault(motion.record.sha256, []).append(motion)
            largest = [motion for bag in bags.values() for motion in largest_motions(bag, break_away, MOST_OF_BAG)]
        compared = tuple(KindMotion.of(motion, group.inputs, sliding) for motion in largest)
        return cls(group.elements, compared, c0, tuple(dict.fromkeys(motion.record.bag for motion in largest)))


@dataclass(frozen=True, eq=False)
class PreslidingFit:
    """The presliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in PRESLIDING.
        loops: the largest micro-motion of each joint that has any.
        motions: how many micro-motions were used.
        groups: what the joints did that made any micro-motion.
    """

    estimates: tuple[ElementEstimate, ...]
    loops: tuple[HysteresisLoop, ...]
    motions: int
    groups: tuple[MovedGroup, ...] = ()


def identify_presliding(
    records: Sequence[JointRecord],
    arm: RigidArm,
    sliding: Sequence[FrictionElement],
    torque_delay: float = 0.0,
    sliding_covariances: Sequence[Array] | None = None,
    plant_period: float | None = None,
) -> PreslidingFit:
    """Fit c0 and c1 of every element whose joints make micro-oscillations.

    Args:
        records: motion with reversals far within the bristles' reach, 500 samples per second or more.
        arm: rigid-body model of the same joints.
        sliding: the sliding regime of the arm's elements, in its order; their c0 and c1 are not used.
        torque_delay: by how much a torque acted later than in the sample period that ends at its stamp, s.
        sliding_covariances: of each element's sliding regime, in the order of SLIDING, shape (7, 7); None if it is
            known exactly.
        plant_period: tick of the simulation that made the records, s, whose bristles see a velocity predicted by half
            a tick; None for a real robot.

    Raises:
        IdentificationError: for other joints than the arm's, a record that is too slow, and no reversal at all.
    """
    for record in records:
        if tuple(record.names) != tuple(arm.names):
            raise IdentificationError(
                f"{record.source}: joints {', '.join(record.names)}; accepted: {', '.join(arm.names)}"
            )
    groups = joint_groups(arm)
    joints = [group.joints for group in groups]
    motions = [motion for record in records for motion in find_micro_motions(record, arm, joints, torque_delay)]
    if not motions:
        where = ", ".join(str(record.source) for record in records) or "no bag"
        raise IdentificationError(
            f"{where}: no velocity reversals small enough for the presliding regime; accepted: oscillations of "
            "some 0.1 mrad at some 3 to 30 Hz, such as rx90_experiment makes"
        )
    unknown = "no micro-oscillation of its joints in the bags"
    estimates = [ElementEstimate.unknown(name, PRESLIDING, unknown) for name in arm.element_names]
    loops: list[HysteresisLoop] = []
    moved: list[MovedGroup] = []
    used = 0
    for group in groups:
        seen = [motion for motion in motions if motion.joints == group.joints]
        own = [motion for motion in seen if motion.driven]
        if not own:
            if seen:
                for e in group.elements:
                    estimates[e] = ElementEstimate.unknown(arm.element_names[e], PRESLIDING, _REACTIONS)
            continue
        elements = [sliding[e] for e in group.elements]
        chosen = _chosen(own, group, elements, plant_period)
        spread = None
        if sliding_covariances is not None:
            spread = block_diag(*(sliding_covariances[e] for e in group.elements))
        solution = fit_group(chosen, group.inputs, elements, spread, plant_period)
        used += len(chosen)
        for place, e in enumerate(group.elements):
            estimates[e] = _estimate(arm, group, place, solution, chosen)
        loops += _loops(arm, chosen, solution)
        moved.append(MovedGroup.of(group, own, elements, solution.values[:, 0]))
    return PreslidingFit(tuple(estimates), tuple(loops), used, tuple(moved))


def _chosen(
    motions: Sequence[MicroMotion], group: JointGroup, sliding: Sequence[FrictionElement], plant_period: float | None
) -> list[MicroMotion]:
    """Return the motions to fit: those in which no element nearly slides, if there are any.

    An element of several joints may nearly slide although the torque of each joint is far from break-away.
    """
    break_away = np.abs(group.inputs).T @ np.array([e.tau_c_positive for e in sliding])
    chosen = most_informative(motions, break_away)
    if len(sliding) == 1:
        return chosen
    loads = fit_group(chosen, group.inputs, sliding, None, plant_period).loads.max(axis=1)
    return [motion for motion, load in zip(chosen, loads, strict=True) if load < _NEAR_SLIDING] or chosen


def _estimate(
    arm: RigidArm, group: JointGroup, place: int, solution: GroupSolution, motions: Sequence[MicroMotion]
) -> ElementEstimate:
    """Return the estimates of the element at a place in its group."""
    block = solution.covariance[2 * place : 2 * place + 2, 2 * place : 2 * place + 2]
    relative = np.sqrt(np.maximum(np.diag(block), 0.0))
    doubt = _doubt(solution, place, group.inputs[place], [arm.names[joint] for joint in group.joints])
    parameters = {}
    for name, value, deviation in zip(PRESLIDING, solution.values[place], relative, strict=True):
        reason = doubt
        if not reason and not deviation < LARGEST_DEVIATION:
            reason = f"relative standard deviation {deviation:.2g} at a value of {value:.3g}"
        estimate = ParameterEstimate(float(value), float(value * deviation))
        parameters[name] = ParameterEstimate.unknown(reason) if reason else estimate
    sources = tuple(dict.fromkeys(motion.record.bag for motion in motions))
    return ElementEstimate.of(arm.element_names[group.elements[place]], parameters, block, sources)


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
    # A wrong inertia of one joint also biases the elements that it shares with its neighbours.
    scores = np.abs(solution.inertia_score).max(axis=1)
    worst = int(np.argmax(scores))
    if scores[worst] > _WRONG_INERTIA:
        error = 100.0 * float(np.abs(solution.inertia[worst]).max())
        return (
            f"the inertia at {names[worst]} would be {error:.0f} % off the description's: a payload, a rotor or the "
            "torque's delay may be missing"
        )
    for joint in np.flatnonzero(inputs).tolist():
        if solution.misfit[joint] > _MISFIT:
            return (
                f"the model misses {100.0 * solution.misfit[joint]:.0f} % of the friction torque of {names[joint]}: "
                "another delay of the torque, another inertia, or no bristles"
            )
    return ""


def _loops(arm: RigidArm, motions: Sequence[MicroMotion], solution: GroupSolution) -> list[HysteresisLoop]:
    loops = []
    for place, joint in enumerate(motions[0].joints):
        largest = int(np.argmax([motion.position[:, place].std() for motion in motions]))
        motion = motions[largest]
        accelerated = motion.acceleration @ motion.mass.T
        position = block_means(motion.position[:, place])
        measured = block_means(motion.drive - accelerated)[:, place]
        simulated = solution.torque[largest][:, place]
        loops.append(HysteresisLoop(arm.names[joint], position - position.mean(), measured, simulated))
    return loops
