"""The verdict on friction by an unused bag: the drives' torques, and the path of the tip.

Torques are predicted by the values in the files, for a given friction file and for a new one alike: rigid arm, and the
elements' bristles along the recorded motion. Recorded and predicted torques pass one low-pass and are compared at the
rows of excitation runs: where the joint moves, reversals included, and no element on it rests.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from rx90_common.bags.mapping import is_table
from rx90_common.base.arrays import Array, column_rms, interpolated, rms
from rx90_common.base.errors import IdentificationError
from rx90_common.description.kinematics import tip_position
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.options import (
    EMULATED,
    NO_TOLERANCES,
    RECORDED,
    GivenTolerances,
    ValidationTolerances,
)
from rx90_emulator.identification.records import JointRecord
from rx90_emulator.identification.robot import RecordedRobot
from rx90_emulator.identification.rows.excitation import ExcitationProblem
from rx90_emulator.identification.rows.filtering import (
    Bandwidths,
    FilteredRun,
    filter_record,
)
from rx90_emulator.identification.sanity import Recorded, alarms
from rx90_emulator.identification.sliding import SlidingFit
from rx90_emulator.identification.validation.verdict import (
    Criterion,
    RunTorques,
    largest,
    run_torques,
    torque_criteria,
)
from rx90_emulator.measured_runs.compare import read_setpoints, run_along, setpoint_rows

_MAX_WEIGHT_SD = 0.05  # standard deviation over RMS torque up to which a joint's error of the weights is corrected
_BRISTLE_STEP_S = 1e-3  # s, longest step of constant velocity
# of the positions, if a bag is slower than those of the identification
_MAX_BANDWIDTH_OVER_RATE = 0.3


class TipDistance(NamedTuple):
    """Distance of the simulated from the recorded tip, along the recorded set-points.

    Attributes:
        time: s, shape (k,).
        distance: m, shape (k,).
    """

    time: Array
    distance: Array

    @property
    def worst(self) -> float:
        """Return the largest distance, m."""
        return float(self.distance.max())

    @property
    def rms(self) -> float:
        """Return the RMS distance, m."""
        return rms(self.distance)


@dataclass(frozen=True, eq=False)
class Validation:
    """Recorded and predicted torques of one bag, and the distance between recorded and simulated tip.

    Attributes:
        torque: recorded and predicted torques of the joints.
        tolerances: limits for agreement.
        source: the bag.
        alarms: what looks wrong in the bag, a sentence each, if it is compared with a given friction.
        assumed_bristles: whether c0 and c1 of any element are assumed: then torques at reversals do not judge the rest.
        notes: gaps in the bag that were bridged or cut out, if it is compared with a given friction.
        fitted: torques by identified base parameters, beside those by the files with possible bodies; None where the
            bodies are the description's.
        simplest: of a rigid body with Coulomb and viscous friction, fitted to the same runs.
        tip: distance of the tips; None if the bag contains no set-points.
    """

    torque: RunTorques
    tolerances: ValidationTolerances
    source: str
    alarms: tuple[str, ...] = ()
    assumed_bristles: bool = False
    notes: tuple[str, ...] = ()
    fitted: RunTorques | None = None
    simplest: RunTorques | None = None
    tip: TipDistance | None = None

    @property
    def decisive(self) -> Criterion:
        """Return the criterion that is farthest beyond its limit, or next to it."""
        return max(self.criteria, key=lambda part: np.nan_to_num(part.value / part.limit, nan=-1.0))

    @property
    def criteria(self) -> tuple[Criterion, ...]:
        """Return the criteria of the verdict: torques of all joints and of each, and distance of the tips."""
        limits = self.tolerances
        torque = self.torque.away_from_reversals if self.assumed_bristles else self.torque
        where = ", away from reversals" if self.assumed_bristles else ""
        criteria: list[Criterion] = []
        if self.fitted is not None:
            where = f" by the files{where}"
            criteria += torque_criteria(self.fitted, limits)
        criteria += torque_criteria(torque, limits, where)
        if math.isfinite(limits.worst_torque):
            share = torque.worst_share
            criteria.append(
                largest("largest torque difference", torque.names, share, limits.worst_torque)
            )
        if self.tip is not None:
            criteria.append(Criterion("tip worst", self.tip.worst, limits.tip, unit="µm"))
        return tuple(criteria)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Return, in words, what assumed bristles miss at reversals, and what the simplest model does."""
        remarks = []
        if self.assumed_bristles:
            share = self.torque.at_reversals.total_share
            if math.isfinite(share):
                remarks.append(f"at reversals, where the assumed c0 and c1 act, {share:.2%}")
        if self.simplest is not None:
            remarks.append(f"Coulomb and viscous friction alone {self.simplest.total_share:.2%}")
        if self.tip is not None:
            remarks.append(f"tip RMS {self.tip.rms * 1e6:.2f} µm")
        return tuple(remarks)

    @property
    def passed(self) -> bool:
        """Return whether every compared quantity agrees."""
        return all(criterion.passed for criterion in self.criteria)


def filtered_runs(
    records: Sequence[JointRecord], robot: RecordedRobot, bandwidths: Bandwidths
) -> list[FilteredRun]:
    """Return the filtered runs of records."""
    return [
        run
        for record in records
        for run in filter_record(record, bandwidths, _torque_lead(record, robot))
    ]


@lru_cache(8)  # the same records are filtered several times
def _torque_lead(record: JointRecord, robot: RecordedRobot) -> float:
    """Return by how much torques acted before their stamps, s.

    A torque of this project's plant belongs to the tick that ends at its stamp; a real arm's does not. The bag of the
    plant has the set-points of this project's controller, which real arms and tables do not have.
    """
    if robot.setup is None or is_table(record.source):
        return 0.0
    setpoints = read_setpoints(record.source, record.names, robot.zero)
    return 0.0 if setpoints is None else 0.5 * robot.setup.rates.period


def validation_bandwidths(record: JointRecord, chosen: Bandwidths | None) -> Bandwidths:
    """Return the bandwidths of an identification, limited by the bag's rate; without one, those of the bag."""
    if chosen is None:
        return Bandwidths.of_motion([record])
    return chosen.at_most(_MAX_BANDWIDTH_OVER_RATE / record.period)


def written_torque(
    problem: ExcitationProblem, arm: RigidArm, elements: Sequence[FrictionElement]
) -> Array:
    """Return the torque of a problem's rows by the values in the files, filtered like the recorded one, Nm, shape (r,).

    Args:
        problem: the rows, and the arm's kinematics.
        arm: the same arm with the links, rotors, springs and offsets of the files.
        elements: one for each of the arm's.
    """
    along = []
    for run in problem.runs:
        motion = (run.position, run.velocity, run.acceleration)
        along.append(drive_torque(arm, elements, motion, 1.0 / run.rate)[:, :, None])
    return problem.rows_of(along)[:, 0]


def drive_torque(
    arm: RigidArm,
    elements: Sequence[FrictionElement],
    motion: tuple[Array, Array, Array],
    step: float,
) -> Array:
    """Return the drive torque at the joints along a motion, friction included, Nm, shape (m, n).

    Args:
        arm: of n joints.
        elements: one for each of the arm's; bristles begin undeflected.
        motion: positions, rad, velocities, rad/s, and accelerations, rad/s^2, each of shape (m, n).
        step: between the samples, s.
    """
    friction = element_torque(elements, motion[1] @ arm.element_matrix.T, step)
    return arm.torque(*motion) + friction @ arm.element_matrix


def element_torque(elements: Sequence[FrictionElement], velocity: Array, step: float) -> Array:
    """Return the friction torque of elements at samples, from undeflected bristles on, Nm, shape (m, e).

    Args:
        elements: e elements; only friction law and bristles are used.
        velocity: of each at the samples, linear between them, rad/s, shape (m, e).
        step: between the samples, s.
    """
    # Finer than the samples: within one sample at a reversal the bristles are deflected only partly.
    fine = max(1, math.ceil(step / _BRISTLE_STEP_S))
    share = (np.arange(fine) + 0.5)[:, None] / fine
    between = velocity[:-1, None] + share * np.diff(velocity, axis=0)[:, None]
    steps = np.full(fine * len(between), step / fine)
    mean = prescribed_torque(elements, between.reshape(len(steps), -1), steps).reshape(
        between.shape
    )
    # The mean of the two steps around a sample belongs to its time.
    return np.concatenate([mean[:1, 0], 0.5 * (mean[:-1, -1] + mean[1:, 0]), mean[-1:, -1]])


def validate(
    robot: RecordedRobot,
    elements: tuple[FrictionElement, ...],
    record: JointRecord,
    tolerances: GivenTolerances = NO_TOLERANCES,
    *,
    assumed_bristles: bool,
    sliding: SlidingFit | None = None,
    bandwidths: Bandwidths | None = None,
) -> Validation:
    """Compare friction with a bag; the tip only for this project's robot, if set-points are in the bag.

    Args:
        robot: that the bag comes from.
        elements: of its friction.
        record: read from the bag.
        tolerances: limits for agreement by name; the others are those for a bag with set-points of this project's
            controller, or those for all others.
        assumed_bristles: whether c0 and c1 of any element are assumed.
        sliding: fit that the elements come from; None for given elements.
        bandwidths: of the runs that the elements were identified from; by default those of the bag.
    """
    chosen = validation_bandwidths(record, bandwidths)
    problem = ExcitationProblem.of(robot.arm, filtered_runs([record], robot, chosen))
    predicted = written_torque(problem, robot.arm, elements)
    if sliding is not None:
        predicted = predicted + _error_of_weights(robot.arm, sliding, problem)
    tip = _tip_distance(robot, elements, record)
    limits = replace(RECORDED if tip is None else EMULATED, **tolerances)
    doubts = record.alarms
    if sliding is None:  # sweeps have been checked already
        doubts += alarms(robot.arm, Recorded.of([record], robot.arm), robot.options, robot.zero)
    (torque,) = run_torques(problem, predicted)
    return Validation(torque, limits, str(record.source), doubts, assumed_bristles, tip=tip)


def _error_of_weights(arm: RigidArm, sliding: SlidingFit, problem: ExcitationProblem) -> Array:
    """Return the torque of the arm's inertial errors at the rows, Nm, shape (r,); 0 for joints where it is uncertain.

    Sweeps of some joints, or at one pose, leave the weights of other joints and at other poses undetermined. Their
    error in the fit is then hundreds of Nm with a standard deviation as large, and the weights of the description are
    better.
    Sweeps at constant velocity determine hardly anything of the inertias.
    """
    position = np.concatenate([run.position[run.rows] for run in problem.runs])
    nothing = np.zeros_like(position)
    regressor = arm.regressor(position, nothing, nothing)
    values, directions = np.linalg.eigh(sliding.inertial_covariance)
    parts = regressor @ (directions * np.sqrt(np.maximum(values, 0.0)))
    deviation = np.sqrt(np.mean(np.sum(parts**2, axis=2), axis=0))
    known = deviation <= _MAX_WEIGHT_SD * column_rms(problem.recorded)
    return np.where(known, regressor @ sliding.inertial, 0.0)[problem.sample, problem.joint]


def _tip_distance(
    robot: RecordedRobot, elements: tuple[FrictionElement, ...], record: JointRecord
) -> TipDistance | None:
    """Return the distance of the recorded tip from the closed loop's, run along the recorded set-points.

    None if that cannot be simulated; set-points with gaps are refused.
    """
    setup = robot.setup
    if setup is None:
        return None
    setpoints = read_setpoints(record.source, record.names, robot.zero, robot.mapping)
    if setpoints is None:
        return None
    reference, position, velocity = setpoints
    period_ns = setup.rates.period_ns * setup.rates.ratio
    gaps = np.flatnonzero(np.diff(reference.stamp_ns) != period_ns)
    if len(gaps):
        raise IdentificationError(
            f"{record.source}: the set-points of {reference.topic} have a gap at {reference.time[gaps[0]]:.3f} s; "
            f"accepted: one every {period_ns / 1e6:g} ms"
        )
    first = int(np.searchsorted(record.time, reference.time[0] - 1e-9))
    start = np.clip(record.position[first], setup.robot.lower, setup.robot.upper)
    identified = replace(setup, friction=FrictionSet(setup.friction.names, elements))
    run = run_along(identified, setpoint_rows(position, velocity, setup), start)
    recorded = interpolated(reference.time, record.time, record.position)
    chain = setup.robot.chain
    simulated = run.slow.joint_states[:, 0]
    distance = np.linalg.norm(
        tip_position(chain, simulated) - tip_position(chain, recorded), axis=1
    )
    inside = (reference.time >= record.time[0]) & (reference.time <= record.time[-1])
    return TipDistance(reference.time[inside], distance[inside])
