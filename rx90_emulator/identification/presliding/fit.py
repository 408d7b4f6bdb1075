"""Identify the presliding regime, c0 and c1, from micro-oscillations (paper, section 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from rx90_common.base.arrays import Array
from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.part import LINEAR_SPEED
from rx90_emulator.identification.arm import JointGroup, RigidArm, joint_groups
from rx90_emulator.identification.estimates import (
    LARGEST_DEVIATION,
    PRESLIDING,
    SLIDING,
    ElementEstimate,
    ParameterEstimate,
    cluster_variances,
)
from rx90_emulator.identification.presliding.bristle_motion import INERTIA_SD, GroupModel, GroupMotion
from rx90_emulator.identification.presliding.micro_motion import (
    BLOCK,
    MicroMotion,
    band_spectrum,
    find_micro_motions,
    most_informative,
)
from rx90_emulator.identification.records import JointRecord, block_means

# passes, each with the noise found in the previous one; evaluations in each pass
_PASSES = 3
_MAX_EVALUATIONS = 30
# relative tolerance of the parameters, in a pass and in the last fit
_ROUGH = 1e-3
_FINE = 1e-6
_RELATIVE_STEP = 1e-4  # of difference quotients
_MIN_MOTION_CLUSTERS = 3  # motions, below which they are too few to be clusters
_MIN_RESIDUAL_LEVERAGE = 1e-3  # lower bound of 1 - leverage: a motion's own start deflection has none
_MIN_INFORMATION = 0.1  # by which the data must reduce the prior deviation of the inertia
_MIN_RELATIVE_SD = (0.002, 0.01)  # of c0 and c1: residuals do not show encoder steps, nor errors of 10 us in time
_NOISE_POWER_SD = 3.0  # standard deviations of the noise's power up to which there is no misfit
_NEARLY_SLIDING_LOAD = 0.75  # of an element's Coulomb torque: beyond it small errors of the motion deflect bristles far
_SLIDING_LOAD = 0.95  # of it: bristles slide
_MAX_MISFIT = 0.3  # of the friction torque
_MAX_INERTIA_SCORE = 2.0  # standard deviations of the inertia's errors if the prior is right
_MOVED_BY_REACTIONS = (
    "its joints were moved by the reactions of others alone; accepted: micro-oscillations of their own"
)


@dataclass(frozen=True, eq=False)
class PreslidingFit:
    """The presliding regime of all elements.

    Attributes:
        estimates: for each element of the arm, in its order; the parameters are those in PRESLIDING.
        loops: largest micro-motion of each joint that has any, by its name: position, rad from the mean, and friction
            torque, Nm, "measured" (drive less weight and measured acceleration) and "simulated" (bristles deflected
            along this motion); block means, shape (b,).
        motions: number of micro-motions that were used.
    """

    estimates: tuple[ElementEstimate, ...]
    loops: Mapping[str, tuple[Array, dict[str, Array]]] = field(default_factory=dict)
    motions: int = 0


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
        records: motion with reversals well within the bristles' range, 500 samples per second or more.
        arm: rigid-body model of the same joints.
        sliding: the sliding regime of the arm's elements, in its order; their c0 and c1 are not used.
        torque_delay: by how much a torque acted later than in the sample period that ends at its stamp, s.
        sliding_covariances: of each element's sliding regime, in the order of SLIDING, shape (7, 7); None if it is
            known exactly.
        plant_period: tick of the simulation that made the records, s, whose bristles use a velocity predicted by half a
            tick; None for a real robot.
    """
    groups = joint_groups(arm)
    joints = [group.joints for group in groups]
    motions = [motion for record in records for motion in find_micro_motions(record, arm, joints, torque_delay)]
    if not motions:
        where = ", ".join(str(record.source) for record in records) or "no bag"
        raise IdentificationError(
            f"{where}: no velocity reversals small enough for the presliding regime; accepted: oscillations of "
            "some 0.1 mrad at some 3 to 30 Hz, such as rx90_experiment makes"
        )
    estimates: dict[int, ElementEstimate] = {}
    loops: dict[str, tuple[Array, dict[str, Array]]] = {}
    used = 0
    for group in groups:
        of_group = [motion for motion in motions if motion.joints == group.joints]
        own = [motion for motion in of_group if motion.driven]
        if not own:
            reason = _MOVED_BY_REACTIONS if of_group else "no micro-oscillation of its joints in the bags"
            for e in group.elements:
                estimates[e] = ElementEstimate.unknown(arm.element_names[e], PRESLIDING, reason)
            continue
        elements = [sliding[e] for e in group.elements]
        chosen = most_informative(own, group.break_away(elements))
        fit = _GroupFit(chosen, group, elements, plant_period)
        if len(elements) > 1:
            # An element of several joints may nearly slide although the torque of each is far from break-away.
            loads = fit.loads.max(axis=1)
            far = [motion for motion, load in zip(chosen, loads, strict=True) if load < _NEARLY_SLIDING_LOAD]
            if 0 < len(far) < len(chosen):
                chosen = far
                fit = _GroupFit(far, group, elements, plant_period)
        used += len(chosen)
        spread = None
        if sliding_covariances is not None:
            spread = block_diag(*(sliding_covariances[e] for e in group.elements))
        estimates |= zip(group.elements, fit.estimates(arm, spread), strict=True)
        for place, joint in enumerate(group.joints):
            index = int(np.argmax([motion.position[:, place].std() for motion in chosen]))
            both = chosen[index].position, chosen[index].friction
            position, measured = (block_means(values, BLOCK)[:, place] for values in both)
            torques = {"measured": measured, "simulated": fit.model.friction(fit.x, index)[:, place]}
            loops[arm.names[joint]] = position - position.mean(), torques
    ordered = tuple(estimates[e] for e in range(len(arm.element_names)))
    return PreslidingFit(ordered, loops, used)


class _GroupFit:
    """The fit of LuGre's bristles of the e elements of a group of k joints to M micro-motions of it.

    Its model has c0 and c1 as logarithms, and noise of standard deviation 1.
    """

    def __init__(
        self,
        motions: Sequence[MicroMotion],
        group: JointGroup,
        sliding: Sequence[FrictionElement],
        plant_period: float | None,
    ) -> None:
        self._motions = motions
        self._group = group
        self._sliding = sliding
        scale = 0.1 * group.break_away(sliding)  # first guess of the noise
        model = GroupModel(tuple(GroupMotion.of(motion, group.inputs, sliding) for motion in motions), scale)
        self._pairs = tuple(np.triu_indices(len(group.joints)))
        x = np.log(_first_guess(motions, group.inputs, sliding)).ravel()
        x = np.concatenate([x, np.zeros(len(self._pairs[0]) + len(motions) * len(sliding))])
        for _ in range(_PASSES):
            x = model.minimised(x, _MAX_EVALUATIONS, _ROUGH, _ROUGH**1.5).x
            spread = 1.4826 * np.median(np.abs(model.of_all(x)), axis=0)
            model = replace(model, scale=model.scale * np.maximum(1e-9, spread))
            if plant_period is not None:
                model = self._with_predicted_speeds(model, x, plant_period)
        self.model = model
        self.x = model.minimised(x, _MAX_EVALUATIONS, _FINE, _FINE**1.5).x
        self.values = model.values(self.x)

    def _symmetric(self, pairs: Array) -> Array:
        """Return values of each pair of k joints, shape (k (k + 1) / 2,), as a symmetric matrix, shape (k, k)."""
        matrix = np.zeros((len(self._group.joints),) * 2)
        matrix[self._pairs] = matrix[self._pairs[::-1]] = pairs
        return matrix

    def _with_predicted_speeds(self, model: GroupModel, x: Array, period: float) -> GroupModel:
        """Return the model with the velocities at which a simulated plant evaluates its bristles.

        The plant predicts the middle of its tick with the friction of the tick before, which is off by half a tick
        squared times the rate of the friction over the mass: 1 % of the stiffness of a light joint.
        """
        changed = []
        errors = self._symmetric(x[model.inertial])
        for index, motion in enumerate(self._motions):
            mass = motion.mass[:, list(motion.joints)] + errors * motion.inertia_scale
            rate = np.gradient(model.friction(x, index), BLOCK * motion.step, axis=0)
            coarse = 0.5 * period**2 * np.linalg.solve(mass, rate.T).T
            place = (np.arange(len(motion.velocity)) + 0.5) / BLOCK - 0.5
            ahead = np.column_stack([np.interp(place, np.arange(len(coarse)), column) for column in coarse.T])
            one = model.motions[index]
            speed = (motion.velocity + ahead) @ one.inputs.T
            for n, element in enumerate(self._sliding):
                one = one.changed(n, element, speed[:, n])
            changed.append(one)
        return replace(model, motions=tuple(changed))

    @property
    def loads(self) -> Array:
        """Return the amplitude of each bristle's torque over its Coulomb torque, shape (M, e)."""
        found = np.empty((len(self._motions), len(self._sliding)))
        for (index, n), _ in np.ndenumerate(found):
            low, high = np.percentile(self.model.torque(self.x, index, n)[:, 1], (1.0, 99.0))
            found[index, n] = 0.5 * (high - low) / self._sliding[n].tau_c.positive
        return found

    def estimates(self, arm: RigidArm, sliding: Array | None) -> list[ElementEstimate]:
        """Return the elements' estimates, by the covariance of the sliding regime, shape (7 e, 7 e), if it has any."""
        values = self.model.residual(self.x)
        jacobian = self.model.jacobian(self.x)
        covariance = _cluster_robust(jacobian, values, self._clusters())
        if sliding is not None:
            slopes = np.linalg.lstsq(jacobian, -self._by_sliding(values), rcond=None)[0]
            covariance = covariance + slopes @ sliding @ slopes.T
        floor = np.zeros(self.x.size)
        floor[: self.model.inertial.start] = np.tile(_MIN_RELATIVE_SD, len(self._sliding))
        covariance += np.diag(floor) ** 2
        doubts = self._doubts(arm, jacobian, covariance)
        found = []
        sources = tuple(dict.fromkeys(motion.record.bag for motion in self._motions))
        for place, (e, doubt) in enumerate(zip(self._group.elements, doubts, strict=True)):
            block = covariance[2 * place : 2 * place + 2, 2 * place : 2 * place + 2]
            parameters = {}
            relative = np.sqrt(np.maximum(np.diag(block), 0.0))
            for name, value, sd in zip(PRESLIDING, self.values[place].tolist(), relative.tolist(), strict=True):
                reason = doubt
                if not reason and not sd < LARGEST_DEVIATION:
                    reason = f"relative standard deviation {sd:.2g} at a value of {value:.3g}"
                known = ParameterEstimate(value, value * sd)
                parameters[name] = ParameterEstimate.unknown(reason) if reason else known
            found.append(ElementEstimate.of(arm.element_names[e], parameters, block, sources))
        return found

    def _doubts(self, arm: RigidArm, jacobian: Array, covariance: Array) -> list[str]:
        """Return why the model does not hold for each element; empty if it does."""
        # The prior shrinks the errors of the inertia towards zero: if it is right, their variance is the prior's less
        # the posterior's. The part of the covariance beyond noise may be due to errors of the model, and is added.
        own = self.model.inertial
        posterior = np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True))[own]
        beyond = np.maximum(np.diag(covariance)[own] - posterior, 0.0)
        least = (_MIN_INFORMATION * INERTIA_SD) ** 2
        score = self.x[own] / np.sqrt(np.maximum(INERTIA_SD**2 - posterior, least) + beyond)
        # A wrong inertia of one joint also biases the elements that it shares with its neighbours.
        scores = np.abs(self._symmetric(score)).max(axis=1)
        inertia = self._symmetric(self.x[own])
        names = [arm.names[joint] for joint in self._group.joints]
        worst = int(np.argmax(scores))
        error = 100.0 * float(np.abs(inertia[worst]).max())
        # The torque residuals beyond noise over the friction, RMS, of each joint.
        residual = self.model.of_all(self.x)
        power = np.sum(residual**2, axis=0) - len(residual) - _NOISE_POWER_SD * np.sqrt(2.0 * len(residual))
        friction = np.vstack(
            [
                motion.traces[0].spectrum(self.model.friction(self.x, index))
                for index, motion in enumerate(self.model.motions)
            ]
        )
        misfit = np.sqrt(np.maximum(power, 0.0) / np.sum((friction / self.model.scale) ** 2, axis=0))
        doubts = []
        for place, load in enumerate(self.loads.min(axis=0).tolist()):
            missed = [joint for joint in np.flatnonzero(self._group.inputs[place]) if misfit[joint] > _MAX_MISFIT]
            doubt = ""
            if load > _SLIDING_LOAD:
                doubt = f"its bristles slide in every micro-oscillation: {load:.2g} of the Coulomb torque or more"
            elif scores[worst] > _MAX_INERTIA_SCORE:
                doubt = (
                    f"the inertia at {names[worst]} would be {error:.0f} % off the description's: a payload, a rotor "
                    "or the torque's delay may be missing"
                )
            elif missed:
                doubt = (
                    f"the model misses {100.0 * misfit[missed[0]]:.0f} % of the friction torque of "
                    f"{names[missed[0]]}: another delay of the torque, another inertia, or no bristles"
                )
            doubts.append(doubt)
        return doubts

    def _clusters(self) -> list[NDArray[np.int64]]:
        """Return the numbers of the spectral line of a motion, and of the motion, that each residual belongs to.

        Errors may be correlated over the line of a tone, 1 Hz widened by its fade. The prior of a start deflection
        belongs to its motion, that of the inertia to the first motion.
        """
        motions = self.model.motions
        width = len(self.model.scale)
        index = np.repeat(np.arange(len(motions)), [width * len(motion.line) for motion in motions])
        line = np.concatenate([np.repeat(motion.line, width) for motion in motions])
        number = np.unique(np.column_stack([index, line]), axis=0, return_inverse=True)[1].ravel()
        own = np.append(np.zeros(len(self._pairs[0])), np.repeat(np.arange(len(motions)), len(self._sliding)))
        found = [np.r_[number, number.max() + 1 + np.arange(len(own))], np.r_[index, own.astype(np.int64)]]
        return found[: 1 if len(motions) < _MIN_MOTION_CLUSTERS else 2]

    def _by_sliding(self, here: Array) -> Array:
        """Return the derivatives of the residuals by the sliding parameters, element by element, shape (q, 7 e).

        A bristle's start, in units of its deflection in steady sliding, is not changed.
        """
        columns = []
        for n, element in enumerate(self._sliding):
            for name in SLIDING:
                # The Coulomb torque is decreased, so that it stays below the static one.
                values = element.parameters
                step = values[name] * (-_RELATIVE_STEP if name.startswith("tau_c") else _RELATIVE_STEP)
                moved = element.with_parameters({name: values[name] + step})
                changed = replace(self.model, motions=tuple(one.changed(n, moved) for one in self.model.motions))
                columns.append((changed.residual(self.x) - here) / step if step else np.zeros_like(here))
        return np.column_stack(columns)


def _cluster_robust(jacobian: Array, residual: Array, groupings: Sequence[NDArray[np.int64]]) -> Array:
    """Return the covariance due to noise, widened where clusters of residuals exceed the noise.

    The noise is white in the band, and is estimated between the spectral lines of the motions. Errors of the model lie
    on the lines and grow with the amplitude; cluster-robust (sandwich) estimates contain them, with CR2 also for few
    clusters of unequal leverage. Of several groupings the one with the largest variance is used.
    """
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    inverse_root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1])) @ vectors.T
    noise = inverse_root @ inverse_root
    inflation = np.ones(len(noise))
    for numbers in groupings:
        variance = cluster_variances(jacobian, residual, numbers, inverse_root, 0.5, _MIN_RESIDUAL_LEVERAGE)
        inflation = np.maximum(inflation, np.sqrt(variance / np.diag(noise)))
    return np.asarray(noise * np.outer(inflation, inflation))


def _first_guess(motions: Sequence[MicroMotion], inputs: Array, sliding: Sequence[FrictionElement]) -> Array:
    """Return c0 and c1 by linear regression of the torque on deflection and velocity, shape (e, 2).

    A bristle's stiffness falls with its deflection, so this c0 is low; it is the start value of the fit.
    """
    matrix = []
    torque = []
    for motion in motions:
        deflection = np.cumsum(motion.velocity, axis=0) * motion.step @ inputs.T
        rest = band_spectrum(block_means(motion.friction, BLOCK), motion.step)[0]
        columns = band_spectrum(block_means(np.hstack([deflection, motion.velocity @ inputs.T]), BLOCK), motion.step)[0]
        for own, column in zip(inputs.T, rest.T, strict=True):
            matrix.append(columns * np.tile(own, 2))
            torque.append(column)
    stiffness, damping = np.split(np.linalg.lstsq(np.vstack(matrix), np.concatenate(torque), rcond=1e-6)[0], 2)
    viscous = np.array([e.c2 * LINEAR_SPEED ** (e.alpha - 1.0) for e in sliding])
    c0 = np.maximum(1.2 * stiffness, np.array([e.tau_c.positive for e in sliding]) / 2e-3)
    return np.column_stack([c0, np.maximum(damping - viscous, 2e-4 * c0)])
