"""Identify the presliding regime, c0 and c1, from micro-oscillations (paper, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_common.friction.curves import LINEAR_SPEED
from rx90_emulator.identification.model.estimates import (
    LARGEST_DEVIATION,
    PRESLIDING,
    SLIDING,
    ElementEstimate,
    ParameterEstimate,
)
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.presliding.bristle_motion import (
    ElementTrace,
    JointGroup,
    KindFamily,
    KindMotion,
    MovedGroup,
    joint_groups,
)
from rx90_emulator.identification.presliding.group_fit import INERTIA_SD, GroupResidual, symmetric
from rx90_emulator.identification.presliding.micro_motion import (
    BLOCK,
    MicroMotion,
    band_spectrum,
    block_means,
    find_micro_motions,
    most_informative,
)
from rx90_emulator.identification.records.record import JointRecord, check_joints

Clusters = NDArray[np.int64]

_START_SD = 0.3  # prior standard deviation of a start deflection, in parts of that of steady sliding
_NOISE_POWER_SD = 3.0  # standard deviations of the noise's power that are no misfit
_RELATIVE_STEP = 1e-4  # relative step of difference quotients
_MIN_MOTION_CLUSTERS = 3  # motions, below which they are too few to be clusters
_MIN_RESIDUAL_LEVERAGE = 1e-3  # lower bound of 1 - leverage: a motion's own start deflection has none
_MIN_INFORMATION = 0.1  # of the prior deviation of the inertia, that the data must take off it
_MIN_RELATIVE_SD = (0.002, 0.01)  # relative, of c0 and c1: encoder steps, and 10 us of timing, show in no residual


def group_covariance(
    residual: GroupResidual, x: Array, sliding: Sequence[FrictionElement], sliding_covariance: Array | None
) -> tuple[Array, Array]:
    """Return the covariance of the parameters at the solution, and the scores of the inertia's errors.

    Args:
        residual: of the fit, with c0 and c1 as logarithms and noise of standard deviation 1.
        x: solution, shape (p,).
        sliding: the elements' sliding regime.
        sliding_covariance: of the sliding regime, element by element in the order of SLIDING, shape (7 e, 7 e); None
            if it is known.

    Returns:
        Covariance, shape (p, p), and what `_inertia_scores` returns, one for each pair of joints.
    """
    values, jacobian = residual.residual(x), residual.jacobian(x)
    clusters = _clusters(residual)[: 1 if len(residual.motions) < _MIN_MOTION_CLUSTERS else 2]
    covariance = _cluster_robust(jacobian, values, clusters)
    if sliding_covariance is not None:
        slopes = np.linalg.lstsq(jacobian, -_by_sliding(residual, x, values, sliding), rcond=None)[0]
        covariance = covariance + slopes @ sliding_covariance @ slopes.T
    bristles = residual.layout.bristles
    floor = np.append(np.tile(_MIN_RELATIVE_SD, len(sliding)), np.zeros(x.size - bristles))
    covariance = covariance + np.diag(floor) ** 2
    return covariance, _inertia_scores(residual, x, jacobian, covariance)


def _clusters(residual: GroupResidual) -> tuple[Clusters, Clusters]:
    """Return the numbers of the spectral line of a motion, and of the motion, that each residual belongs to.

    Errors may be correlated over the line of a tone, 1 Hz widened by its fade. The prior of a start deflection goes
    with its motion, that of the inertia with the first motion.
    """
    by_line, by_motion, first = [], [], 0
    for index, motion in enumerate(residual.motions):
        line = motion.line.astype(np.int64)
        line -= line.min()
        by_line.append(np.repeat(first + line, len(residual.scale)))
        by_motion.append(np.full(by_line[-1].size, index))
        first += int(line.max()) + 1
    starts = np.repeat(np.arange(len(residual.motions)), len(residual.families))
    own = np.append(np.zeros(residual.layout.pairs, np.int64), starts)
    return np.concatenate([*by_line, first + np.arange(len(own))]), np.concatenate([*by_motion, own])


def _cluster_robust(jacobian: Array, residual: Array, groupings: Sequence[Clusters]) -> Array:
    """Return the covariance by the noise, widened where clusters of residuals show more than noise would.

    The noise is white in the band, and it is what lies between the spectral lines of the motions. Errors of the model
    lie on the lines and grow with the amplitude; cluster-robust (sandwich) estimates show them. These are the
    bias-reduced linearisation of Bell and McCaffrey (CR2; Survey Methodology 28, 2002), which is unbiased where there
    is only noise, also with few clusters of unequal leverage.

    Args:
        jacobian: shape (q, p).
        residual: shape (q,).
        groupings: number of the cluster of each residual, each shape (q,); the one that shows most counts.
    """
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    inverse_root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])) @ vectors.T
    noise = inverse_root @ inverse_root
    wide = np.ones(len(noise))
    for numbers in groupings:
        variance = np.zeros(len(noise))
        for number in range(int(numbers.max()) + 1):
            rows = numbers == number
            own = jacobian[rows] @ inverse_root
            leverage, turn = np.linalg.eigh(own.T @ own)
            adjusted = turn / np.sqrt(np.maximum(1.0 - leverage, _MIN_RESIDUAL_LEVERAGE)) @ turn.T
            variance += (inverse_root @ (adjusted @ (own.T @ residual[rows]))) ** 2
        wide = np.maximum(wide, np.sqrt(variance / np.diag(noise)))
    return np.asarray(noise * np.outer(wide, wide))


def _by_sliding(residual: GroupResidual, x: Array, here: Array, sliding: Sequence[FrictionElement]) -> Array:
    """Return the derivatives of the residuals by the sliding parameters, element by element, shape (q, 7 e).

    A bristle's start, in parts of its deflection in steady sliding, is left where it is.
    """
    columns = []
    for n, element in enumerate(sliding):
        for name in SLIDING:
            # The Coulomb torque goes down, which keeps it below the static one.
            step = getattr(element, name) * (-_RELATIVE_STEP if name.startswith("tau_c") else _RELATIVE_STEP)
            moved = replace(element, **{name: getattr(element, name) + step})
            motions = tuple(
                motion.with_trace(n, ElementTrace.of(moved, motion.traces[n].speed, motion.traces[n].step))
                for motion in residual.motions
            )
            changed = replace(residual, motions=motions)
            columns.append((changed.residual(x) - here) / step if step else np.zeros_like(here))
    return np.column_stack(columns)


def _inertia_scores(residual: GroupResidual, x: Array, jacobian: Array, covariance: Array) -> Array:
    """Return the errors of the mass matrix over the deviations that they would have if the prior held.

    The prior shrinks the errors towards zero: where it holds, their variance is the prior's less the posterior's. What
    the covariance has beyond noise may be errors of the model instead of the inertia, and is added.
    """
    own = slice(residual.layout.bristles, residual.layout.shared)
    posterior = np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))[own]
    beyond = np.maximum(np.diag(covariance)[own] - posterior, 0.0)
    least = (_MIN_INFORMATION * INERTIA_SD) ** 2
    return np.asarray(x[own] / np.sqrt(np.maximum(INERTIA_SD**2 - posterior, least) + beyond))


def _misfit(residual: GroupResidual, x: Array) -> Array:
    """Return the RMS of each joint's torque residuals beyond noise over that of its friction, shape (k,)."""
    left = residual.of_all(x)
    friction = [one.traces[0].spectrum(residual.friction(x, i)) for i, one in enumerate(residual.motions)]
    beyond = np.sum(left**2, axis=0) - len(left) - _NOISE_POWER_SD * np.sqrt(2.0 * len(left))
    power = np.sum((np.vstack(friction) / residual.scale) ** 2, axis=0)
    return np.asarray(np.sqrt(np.maximum(beyond, 0.0) / power))


def _with_predicted_speeds(
    residual: GroupResidual,
    x: Array,
    motions: Sequence[MicroMotion],
    sliding: Sequence[FrictionElement],
    period: float,
) -> GroupResidual:
    """Return the residuals with the velocities at which a simulated plant evaluates its bristles.

    The plant predicts the middle of its tick with the friction of the tick before, which is off by half a tick
    squared times the rate of the friction over the mass: 1 % of the stiffness of a light joint.

    Args:
        residual: of the fit.
        x: parameters.
        motions: that the residuals are of.
        sliding: the elements' sliding regime.
        period: tick of the plant, s.
    """
    changed, errors = [], symmetric(residual.layout.inertia(x), len(motions[0].joints))
    for index, motion in enumerate(motions):
        joints = list(motion.joints)
        scale = np.sqrt(np.outer(motion.inertia[joints], motion.inertia[joints]))
        rate = np.gradient(residual.friction(x, index), BLOCK * motion.step, axis=0)
        coarse = 0.5 * period**2 * np.linalg.solve(motion.mass[:, joints] + errors * scale, rate.T).T
        place = (np.arange(len(motion.velocity)) + 0.5) / BLOCK - 0.5
        ahead = np.column_stack([np.interp(place, np.arange(len(coarse)), column) for column in coarse.T])
        speed = (motion.velocity + ahead) @ residual.motions[index].inputs.T
        one = residual.motions[index]
        for n, element in enumerate(sliding):
            one = one.with_trace(n, ElementTrace.of(element, speed[:, n], motion.step))
        changed.append(one)
    return replace(residual, motions=tuple(changed))


_PASSES = 3  # of the fit, each with the noise that the one before shows
_MAX_EVALUATIONS = 30  # of the residuals in one pass, at most
_ROUGH, _FINE = 1e-3, 1e-6  # relative tolerance of the parameters, in a pass and in the last fit


@dataclass(frozen=True, eq=False)
class GroupSolution:
    """What the fit of a group of k joints with e elements found.

    Attributes:
        values: c0, Nm/rad, and c1, Nm s/rad, of the elements, shape (e, 2).
        covariance: of ln c0 and ln c1, element by element, shape (2 e, 2 e).
        inertia: errors of the joints' mass matrix, in parts of sqrt(M_jj M_ii), shape (k, k).
        inertia_score: the same over the standard deviations that they would have if the prior held, shape (k, k).
        torque: block means of the friction torque at the joints, Nm, of each micro-motion, shape (b, k).
        loads: amplitude of each bristle's torque over its Coulomb torque, of each micro-motion, shape (motions, e).
        misfit: RMS of each joint's torque residuals beyond noise over that of its friction torque, shape (k,).
    """

    values: Array
    covariance: Array
    inertia: Array
    inertia_score: Array
    torque: tuple[Array, ...]
    loads: Array
    misfit: Array


def fit_group(
    motions: Sequence[MicroMotion],
    inputs: Array,
    sliding: Sequence[FrictionElement],
    sliding_covariance: Array | None = None,
    plant_period: float | None = None,
) -> GroupSolution:
    """Fit the elements of a group of joints to all its micro-motions (Levenberg-Marquardt).

    Args:
        motions: of the group, one or more.
        inputs: joint velocities to input velocities of the group's elements, shape (e, k).
        sliding: the elements with their sliding regime; c0 and c1 are not used.
        sliding_covariance: of that regime, element by element in the order of SLIDING, shape (7 e, 7 e); None if it
            is known.
        plant_period: as in `identify_presliding`.
    """
    scale = 0.1 * np.abs(inputs).T @ np.array([one.tau_c_positive for one in sliding])  # a first guess of the noise
    seen = tuple(KindMotion.of(motion, inputs, sliding, whole=True) for motion in motions)
    families = (KindFamily(),) * len(sliding)
    residual = GroupResidual(families, seen, scale, start_sd=_START_SD, max_start=np.inf)
    layout = residual.layout
    guess = np.log(first_guess(motions, inputs, sliding)).ravel()
    x = np.concatenate([guess, np.zeros(layout.pairs + len(motions) * len(sliding))])
    for _ in range(_PASSES):
        x = residual.minimised(x, _MAX_EVALUATIONS, _ROUGH, _ROUGH**1.5).x
        spread = 1.4826 * np.median(np.abs(residual.of_all(x)), axis=0)
        residual = replace(residual, scale=residual.scale * np.maximum(1e-9, spread))
        if plant_period is not None:
            residual = _with_predicted_speeds(residual, x, motions, sliding, plant_period)
    x = residual.minimised(x, _MAX_EVALUATIONS, _FINE, _FINE**1.5).x
    covariance, scores = group_covariance(residual, x, sliding, sliding_covariance)
    loads = np.empty((len(motions), len(sliding)))
    for (index, n), _ in np.ndenumerate(loads):
        low, high = np.percentile(residual.torque(x, index, n)[:, 1], (1.0, 99.0))
        loads[index, n] = 0.5 * (high - low) / sliding[n].tau_c_positive
    return GroupSolution(
        values=residual.values(x),
        covariance=covariance[: layout.bristles, : layout.bristles],
        inertia=symmetric(layout.inertia(x), inputs.shape[1]),
        inertia_score=symmetric(scores, inputs.shape[1]),
        torque=tuple(residual.friction(x, index) for index in range(len(motions))),
        loads=loads,
        misfit=_misfit(residual, x),
    )


def first_guess(motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[FrictionElement]) -> Array:
    """Return c0 and c1 by linear regression of the torque on deflection and velocity, shape (e, 2).

    A bristle's stiffness falls with its deflection, so this c0 is low; it is where the fit begins.

    Args:
        motions: of the group.
        inputs: joint velocities to input velocities of the elements, shape (e, k).
        sliding: the elements.
    """
    elements, k = inputs.shape
    matrix, torque = [], []
    for motion in motions:
        deflection = np.cumsum(motion.velocity, axis=0) * motion.step @ inputs.T
        speed = motion.velocity @ inputs.T
        rest = band_spectrum(block_means(motion.drive - motion.acceleration @ motion.mass.T), motion.step)[0]
        columns = band_spectrum(block_means(np.hstack([deflection, speed])), motion.step)[0]
        for i in range(k):
            matrix.append(columns * np.tile(inputs[:, i], 2))
            torque.append(rest[:, i])
    solution = np.linalg.lstsq(np.vstack(matrix), np.concatenate(torque), rcond=1e-6)[0]
    viscous = np.array([e.c2 * LINEAR_SPEED ** (e.alpha - 1.0) for e in sliding])
    weakest = np.array([e.tau_c_positive for e in sliding]) / 2e-3
    c0 = np.maximum(1.2 * solution[:elements], weakest)
    return np.column_stack([c0, np.maximum(solution[elements:] - viscous, 2e-4 * c0)])


_NEARLY_SLIDING_LOAD = 0.75  # of an element's Coulomb torque: beyond it small errors of the motion deflect bristles far
_SLIDING_LOAD = 0.95  # of it: bristles slide
_MAX_MISFIT = 0.3  # of the friction torque
_MAX_INERTIA_SCORE = 2.0  # standard deviations of the inertia's errors if the prior held
_MOVED_BY_REACTIONS = (
    "its joints were moved by the reactions of others alone; accepted: micro-oscillations of their own"
)


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
    check_joints(records, arm.names)
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
                    estimates[e] = ElementEstimate.unknown(arm.element_names[e], PRESLIDING, _MOVED_BY_REACTIONS)
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
    chosen = most_informative(motions, group.break_away(sliding))
    if len(sliding) == 1:
        return chosen
    loads = fit_group(chosen, group.inputs, sliding, None, plant_period).loads.max(axis=1)
    return [motion for motion, load in zip(chosen, loads, strict=True) if load < _NEARLY_SLIDING_LOAD] or chosen


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
    if load > _SLIDING_LOAD:
        return f"its bristles slide in every micro-oscillation: {load:.2g} of the Coulomb torque or more"
    # A wrong inertia of one joint also biases the elements that it shares with its neighbours.
    scores = np.abs(solution.inertia_score).max(axis=1)
    worst = int(np.argmax(scores))
    if scores[worst] > _MAX_INERTIA_SCORE:
        error = 100.0 * float(np.abs(solution.inertia[worst]).max())
        return (
            f"the inertia at {names[worst]} would be {error:.0f} % off the description's: a payload, a rotor or the "
            "torque's delay may be missing"
        )
    for joint in np.flatnonzero(inputs).tolist():
        if solution.misfit[joint] > _MAX_MISFIT:
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
