"""Simulate the motion of a measured arm in the closed loop without ROS, and compare torques and positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, CubicHermiteSpline, make_interp_spline

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.reading import read_joint_states
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array, Mask, column_rms
from rx90_common.base.errors import IdentificationError, TrajectoryError, check_type
from rx90_common.base.quoting import counted
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.topics import MOTOR_STATES
from rx90_controller.trajectory.spline import interpolate
from rx90_emulator.identification.options import MeasuredLayout, MeasuredTolerances, Progress
from rx90_emulator.identification.records import BagSource, JointRecord, read_record
from rx90_emulator.identification.robot import (
    JOINT_STATES,
    BagLayout,
    arm_layout,
    recorded_topic,
    topic_names,
    with_signals,
)
from rx90_emulator.identification.rows.excitation import element_states
from rx90_emulator.identification.rows.filtering import (
    Bandwidths,
    FilteredRun,
    filter_record,
    low_pass,
    low_pass_taps,
)
from rx90_emulator.identification.validation.verdict import Criterion, TorquePrediction, largest
from rx90_emulator.loop.closed_loop import simulate_commands
from rx90_emulator.loop.recorded_setup import check_robot
from rx90_emulator.loop.result import RunResult
from rx90_emulator.loop.setup import Setup

REFERENCE = "rx90_controller/reference"
_HOLD_S = 0.5  # s at rest before a motion, in which the integrators take over the arm's weight
_MIN_LEAD_S = 0.5  # s, least time for reaching the velocity at the beginning of a record
_REST_SPEED = 1e-6  # rad/s, of a set-point
_RANGE_SLACK = 1e-5  # of a range: times are whole nanoseconds
_MAX_GAP_PERIODS = 3.5  # longest gap between set-points that is interpolated, in periods


def _bag_layout(bag: Path, setup: Setup, options: MeasuredLayout) -> BagLayout:
    """Return the layout of a bag of the setup's robot."""
    check_robot(bag, setup.robot.model.name)
    options, mapping = with_signals(options, [bag])
    topic = options.topic or recorded_topic(bag, (MOTOR_STATES, JOINT_STATES), mapping)
    return arm_layout(topic, setup.robot.joint_names, options, lambda: setup.drives, mapping)


@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """A measured run and the simulated one along the same set-points, both through the same low-pass.

    Attributes:
        names: of the joints.
        robot: name of the simulated robot.
        source: the measured bag.
        torque: measured and simulated drive torque at the joints, compared where a joint does not rest, for there it
            depends on the earlier motion.
        position: measured, rad, shape (k, n).
        simulated_position: rad, shape (k, n).
        lag: delay of the simulated against the measured motion, s; the series are shifted by it.
        bandwidths: of the set-points, and of torques and positions here.
        setpoints: source of the set-points, in words.
        remarks: further notes, a sentence each.
        tolerances: limits for agreement.
    """

    names: tuple[str, ...]
    robot: str
    source: BagSource
    torque: TorquePrediction
    position: Array
    simulated_position: Array
    lag: float
    bandwidths: Bandwidths
    setpoints: str
    remarks: tuple[str, ...]
    tolerances: MeasuredTolerances

    @property
    def position_difference(self) -> Array:
        """Return the simulated less the measured positions, rad, shape (k, n)."""
        return self.simulated_position - self.position

    @property
    def position_rms(self) -> Array:
        """Return the RMS position difference, rad, shape (n,)."""
        return column_rms(self.position_difference)

    @property
    def position_worst(self) -> Array:
        """Return the largest position difference, rad, shape (n,)."""
        return np.asarray(np.abs(self.position_difference).max(axis=0))

    @property
    def criteria(self) -> tuple[Criterion, Criterion, Criterion]:
        """Return the criteria of the verdict: torques of all joints and of each, and positions."""
        limits = self.tolerances
        return (
            Criterion("torque RMS of all joints", self.torque.total_share, limits.total_torque),
            largest("largest", self.names, self.torque.rms_share, limits.torque),
            largest("position", self.names, self.position_worst, limits.position, "mrad", 3),
        )

    @property
    def passed(self) -> bool:
        """Return whether torques, of each joint that moves and of all together, and positions agree."""
        return all(criterion.passed for criterion in self.criteria)


_MAX_BANDWIDTH_SHARE = 0.3  # largest bandwidth of the set-points over the rate of the position loop
_MAX_LAG_S = 0.1  # s, largest lag or lead of the simulated motion
# rad, several times the presliding travel of a joint; a joint that moves less is at rest
_MIN_TRAVEL = 2e-3
_LAG_ROUNDS = 4  # iterations of the search for the lag
_DEFAULT_LAYOUT = MeasuredLayout()
_DEFAULT_TOLERANCES = MeasuredTolerances()


def compare_measured(
    bag: Path | str,
    setup: Setup,
    layout: MeasuredLayout = _DEFAULT_LAYOUT,
    tolerances: MeasuredTolerances = _DEFAULT_TOLERANCES,
    *,
    bandwidth: float | None = None,
    progress: Progress = lambda _: None,
) -> MeasuredComparison:
    """Run the closed loop along the motion of a measured arm and compare torques and positions with the measured ones.

    Set-points are those of this project's controller if the bag contains them, else the measured path, smoothed without
    delay, with its velocities and accelerations. Both runs pass the same zero-phase low-pass.

    Args:
        bag: of an arm of this project's structure, with positions and efforts of its joints or motors.
        setup: the robot to simulate.
        layout: the contents of the bag.
        tolerances: limits for agreement.
        bandwidth: of the measured path as set-points, Hz; a third of it for the compared torques and positions. By
            default chosen from the data, as for an identification.
        progress: called with the name of each of three steps before it.

    Raises:
        BagError: for a bag that cannot be read.
        IdentificationError: for a bag or options that contradict each other, or a bag in which nothing moves.
        TrajectoryError: for a path beyond a joint's range, naming joint, value, time and range.
        DivergenceError: naming joint and tick.
        SupervisionError: if the controller's supervision cuts the power.
    """
    check_type(setup=(setup, Setup))
    path = Path(bag)
    what = _bag_layout(path, setup, layout)
    progress(path.name)
    record = read_record(path, what)
    pieces = filter_record(
        record,
        _bandwidths(
            record,
            setup,
            bandwidth,
            has_setpoints=absolute(REFERENCE) in topic_names(path, what.mapping),
        ),
    )
    run = max(pieces, key=lambda piece: len(piece.time))
    # A joint counts as moving if every motor and friction element that it turns is moving.
    matrix = setup.drives.turning.element_matrix
    resting = element_states(run, matrix)[0] @ (matrix != 0.0)
    moves = ~resting & (np.ptp(run.position, axis=0) > _MIN_TRAVEL)
    setpoints = _recorded_setpoints(run, record.position[0], setup, what) or path_setpoints(
        run, setup
    )
    beyond = _beyond(setpoints, path, setup)
    progress("closed loop")
    simulated, begin, end, saturated = _simulated(setup, setpoints, run)
    progress("comparison")
    time = run.time[run.rows]
    # covered for any lag of the simulated arm
    rows = (time >= begin + _MAX_LAG_S) & (time <= end - _MAX_LAG_S)
    if not rows.any():
        raise IdentificationError(
            "measured and simulated run have no time in common; accepted: a longer bag"
        )
    if not moves[rows].any():
        raise IdentificationError(
            f"{path}: no joint moves, and torques at rest are not compared; accepted: a joint that slides over "
            f"{1e3 * _MIN_TRAVEL:g} mrad or more"
        )
    time = time[rows]
    velocity = run.velocity[run.rows][rows]
    measured = run.parallel(np.stack([run.position, run.torque], axis=1))[rows]
    lag = 0.0
    for _ in range(_LAG_ROUNDS):  # least squares of the positions
        difference = simulated(time + lag - setpoints.start)[:, 0] - measured[:, 0]
        lag -= float(np.sum(difference * velocity)) / float(np.sum(velocity**2))
        lag = float(np.clip(lag, -_MAX_LAG_S, _MAX_LAG_S))
    follows = simulated(time + lag - setpoints.start)
    return MeasuredComparison(
        names=run.names,
        robot=setup.robot.model.name,
        source=record.bag,
        torque=TorquePrediction(time, measured[:, 1], follows[:, 1], moves[rows]),
        position=measured[:, 0],
        simulated_position=follows[:, 0],
        lag=lag,
        bandwidths=run.bandwidths,
        setpoints=setpoints.source,
        remarks=(
            *beyond,
            *(
                f"{name}'s motor is at its limit in {share:.1%} of the simulated time"
                for name, share in zip(run.names, saturated, strict=True)
                if share
            ),
            *_remarks(record, pieces, run, moves[rows]),
        ),
        tolerances=tolerances,
    )


def _bandwidths(
    record: JointRecord, setup: Setup, bandwidth: float | None, *, has_setpoints: bool
) -> Bandwidths:
    """Return the bandwidths by the data, or by the user, as far as the position loop's rate allows."""
    highest = _MAX_BANDWIDTH_SHARE * setup.rates.position_hz
    if bandwidth is None and has_setpoints:
        rate = 1.0 / float(np.median(np.diff(record.time)))
        position = min(highest, _MAX_BANDWIDTH_SHARE * rate)
        return Bandwidths(position, position / 3.0)
    if bandwidth is None:
        return Bandwidths.of_motion([record]).at_most(highest)
    if not 0.0 < bandwidth <= highest:
        raise IdentificationError(
            f"--bandwidth is {bandwidth:g} Hz; accepted: above 0, up to {highest:g} Hz"
        )
    return Bandwidths(bandwidth, bandwidth / 3.0)


class _SetPoints(NamedTuple):
    """Set-points for the simulated arm; times by the bag's stamps, s; before `begin` the arm moves to the first."""

    start: float
    values: Array  # position rad, velocity rad/s, acceleration rad/s^2, one for each position tick, shape (m, 3, n)
    begin: float
    initial_position: Array  # where the simulated arm rests at `start`, rad, shape (n,)
    source: str  # in words


def _recorded_setpoints(
    run: FilteredRun, first: Array, setup: Setup, layout: BagLayout
) -> _SetPoints | None:
    """Return the set-points of this project's controller in a bag; None if it contains none.

    A bag that begins at time 0 with an arm at rest is simulated as it ran, from the release of its brakes on. `first`
    is the first measured position, rad, shape (n,).
    """
    bag = run.source.path
    period = setup.rates.position_period
    found = read_setpoints(bag, run.names, layout.zero, layout.mapping)
    if found is None:
        return None
    series, position, velocity = found
    steps = np.diff(series.stamp_ns)
    time = series.time
    if len(steps) < 2 or not (steps > 0).all() or steps.max() > _MAX_GAP_PERIODS * np.median(steps):
        raise IdentificationError(
            f"{bag}: the set-points of {series.topic} have gaps; accepted: a steady stream"
        )
    if (steps != setup.rates.period_ns * setup.rates.ratio).any():
        since = (series.stamp_ns - series.stamp_ns[0]) / NANOSECONDS
        curve = CubicHermiteSpline(since, position, velocity)
        even = np.arange(int(since[-1] / period + 1e-6) + 1) * period
        position = curve(even)
        velocity = curve(even, 1)
    values = setpoint_rows(position, velocity, setup)
    source = f"{REFERENCE} in the bag"
    if series.stamp_ns[0] == 0 and np.abs(velocity[0]).max() < _REST_SPEED:
        return _SetPoints(
            0.0, values, 0.0, np.clip(first, setup.robot.lower, setup.robot.upper), source
        )
    return _with_lead_in(float(time[0]), values, setup, source)


def path_setpoints(run: FilteredRun, setup: Setup) -> _SetPoints:
    """Return the smoothed measured path as set-points, with its velocities and accelerations."""
    period = setup.rates.position_period
    # From 0 on: stamps of the wall clock are rounded too much for accelerations.
    samples = np.arange(len(run.time)) / run.rate
    count = int(samples[-1] / period + 1e-6) + 1
    curve = make_interp_spline(samples, run.position, k=5)
    time = np.minimum(np.arange(count) * period, samples[-1])
    values = np.ascontiguousarray(np.stack([curve(time, nu) for nu in range(3)], axis=1))
    source = f"the measured path below {run.bandwidths.position:.3g} Hz"
    return _with_lead_in(float(run.time[0]), values, setup, source)


def _with_lead_in(begin: float, values: Array, setup: Setup, source: str) -> _SetPoints:
    """Prepend a rest, and a motion from rest to the velocity of the first set-point."""
    period = setup.rates.position_period
    limits = setup.controller.limits(setup.robot)
    position, velocity, _ = values[0]
    lasting = max(_MIN_LEAD_S, float(np.max(2.0 * np.abs(velocity) / limits.acceleration)))
    lead = round(lasting / period)
    hold = round(_HOLD_S / period)
    start_pose = np.clip(position - 0.5 * lead * period * velocity, limits.lower, limits.upper)
    start_pose = np.where(np.abs(velocity) < _REST_SPEED, position, start_pose)
    still = np.stack([start_pose, 0.0 * start_pose, 0.0 * start_pose])
    ends = np.stack([still, values[0]], axis=1)
    moving = interpolate(np.array([0.0, lead * period]), *ends).sample(
        np.arange(lead, dtype=np.float64) * period
    )
    whole = np.ascontiguousarray(
        np.concatenate([np.broadcast_to(still, (hold, *still.shape)), moving, values])
    )
    return _SetPoints(begin - (hold + lead) * period, whole, begin, start_pose, source)


def _beyond(setpoints: _SetPoints, bag: Path, setup: Setup) -> tuple[str, ...]:
    """Return a sentence for velocities, and one for accelerations, that the controller would refuse.

    The measured arm did move so. Positions beyond a joint's range are refused.
    """
    limits = setup.controller.limits(setup.robot)
    found = []
    for k, (what, unit, low, high, _) in enumerate(limits.quantities(limits.lower, limits.upper)):
        values = setpoints.values[:, k]
        beyond = np.maximum(low - values, values - high) / (high - low)
        row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
        if beyond[row, joint] <= _RANGE_SLACK:
            continue
        time = setpoints.start + row * setup.rates.position_period
        where = f"{time:.3f} s" if time >= setpoints.begin else "the lead-in, before the bag begins"
        fault = (
            f"{limits.names[joint]} needs the {what} {values[row, joint]:.4g} {unit} at {where}; accepted by the "
            f"robot's files: [{low[joint]:.4g}, {high[joint]:.4g}] {unit}"
        )
        if k == 0:
            raise TrajectoryError(f"{bag}: {fault}; set-points are {setpoints.source}")
        found.append(f"{fault}; the simulation goes on nevertheless")
    return tuple(found)


def _simulated(
    setup: Setup, setpoints: _SetPoints, run: FilteredRun
) -> tuple[BSpline, float, float, Array]:
    """Return the simulated run, filtered by the low-pass of the measured one.

    Returns:
        Position rad and torque Nm by the time since the first set-point, shape (k, 2, n), the first and last time
        covered, by the bag's stamps, and the share of the time in which each motor was at its limit, shape (n,).
    """
    # Sampled at the measured rate: aliasing by slow sampling is then the same on both sides.
    rates = setup.rates
    often = run.rate > 1.5 * setup.rates.position_hz
    simulated = run_along(setup, setpoints.values, setpoints.initial_position, record_fast=often)
    values = simulated.slow.joint_states[:, ::2]
    rate = float(rates.base_hz if often else rates.position_hz)
    if simulated.fast is not None:
        turns = setup.drives.gear[:, None] * setup.drives.turning.turns
        position = simulated.fast.motor_states[:, 0] @ np.linalg.inv(turns).T
        values = np.stack([position, simulated.fast.motor_states[:, 2] @ turns], axis=1)
    taps = low_pass_taps(rate, run.bandwidths.torque)
    filtered = low_pass(values, taps)
    if len(filtered) < 4:
        raise IdentificationError(
            f"{run.source.path}: too short for a low-pass of {run.bandwidths.torque:.3g} Hz"
        )
    since = (len(taps) // 2 + np.arange(len(filtered))) / rate
    begin = setpoints.start + float(since[0])
    end = setpoints.start + float(since[-1])
    saturated = simulated.saturated / (len(setpoints.values) * rates.ratio)
    return make_interp_spline(since, filtered, k=3), max(begin, setpoints.begin), end, saturated


def _remarks(
    record: JointRecord, pieces: tuple[FilteredRun, ...], run: FilteredRun, compared: Mask
) -> tuple[str, ...]:
    """Return which parts of the bag are not compared, and why; `compared` as in TorquePrediction."""
    found = []
    if len(pieces) > 1:
        found.append(
            f"there are gaps in the record: only {run.time[0]:.3f} to {run.time[-1]:.3f} s of {record.time[0]:.3f} to "
            f"{record.time[-1]:.3f} s is compared, the longest part without one"
        )
    if record.outliers:
        found.append(
            f"left out: {counted(record.outliers, 'sample')} (NaN, single spikes or repeated stamps)"
        )
    if not compared.all():
        shares = zip(run.names, compared.mean(axis=0), strict=True)
        parts = ", ".join(f"{name} {share:.0%}" for name, share in shares if share < 1.0)
        found.append(f"torques are compared where a joint moves: {parts} of the time")
    return tuple(found)


def read_setpoints(
    bag: Path, names: Sequence[str], zero: Array | None, mapping: LogMapping | None = None
) -> tuple[JointSeries, Array, Array] | None:
    """Return the set-points of this project's controller in a bag; None if it contains none.

    Args:
        bag: the bag.
        names: of the joints.
        zero: recorded angles in the zero pose of the URDF, rad, shape (n,); they are subtracted from the positions.
        mapping: the columns of a table, if the file beside it does not state them.

    Returns:
        The series as it is in the bag, positions rad and velocities rad/s, shape (m, n).
    """
    if absolute(REFERENCE) not in topic_names(bag, mapping):
        return None
    series = read_joint_states(bag, REFERENCE, names, mapping=mapping)
    if series.position is None or series.velocity is None:
        return None
    return series, series.position if zero is None else series.position - zero, series.velocity


def setpoint_rows(position: Array, velocity: Array, setup: Setup) -> Array:
    """Return set-points at the position loop's rate with accelerations that lead to the next, shape (m, 3, n)."""
    acceleration = np.diff(velocity, axis=0, append=velocity[-1:]) / setup.rates.position_period
    return np.ascontiguousarray(np.stack([position, velocity, acceleration], axis=1))


def run_along(
    setup: Setup, setpoints: Array, start: Array, *, record_fast: bool = False
) -> RunResult:
    """Run the closed loop along set-points, shape (m, 3, n), from rest at `start`, rad, shape (n,)."""
    duration = len(setpoints) * setup.rates.position_period
    return simulate_commands(
        setup, (), start, duration, record_fast=record_fast, warn=False, sample=lambda *_: setpoints
    )
