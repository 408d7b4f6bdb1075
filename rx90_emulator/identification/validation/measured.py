"""Simulate what a measured arm did, in the closed loop without ROS, and compare torques and positions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from rx90_common.bags.mapping import is_table, mapping_of
from rx90_common.bags.reading import BagReader
from rx90_common.bags.recorded import check_robot
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import ConfigError, IdentificationError, check_type
from rx90_common.base.quoting import listed
from rx90_common.description.drives import coupling_matrix, element_matrix
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.topics import MOTOR_NAMES, MOTOR_STATES
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.friction_set import element_names
from rx90_emulator.identification.excitation.filtering import (
    Bandwidths,
    FilteredRun,
    filter_record,
    low_pass,
    low_pass_taps,
)
from rx90_emulator.identification.excitation.problem import SlidingState, element_states
from rx90_emulator.identification.options import MeasuredLayout, MeasuredTolerances
from rx90_emulator.identification.records import BagSource, JointRecord, read_record
from rx90_emulator.identification.robot import JOINT_STATES, BagLayout, arm_layout, recorded_topic, with_signals
from rx90_emulator.identification.validation.setpoints import SetPoints, path_setpoints, recorded_setpoints, run_along
from rx90_emulator.identification.validation.verdict import Criterion, TorquePrediction, largest
from rx90_emulator.loop.setup import Setup

_JOINTS = 6
_MOVABLE = ("revolute", "continuous", "prismatic", "planar", "floating")
_OTHER_ARMS = (
    "the closed loop simulates arms of six joints whose motor 6 turns with joints 5 and 6; for the torque of another "
    "arm: rx90_identify --friction FILE --validation BAG --urdf URDF"
)


def simulated_setup(files: RobotFiles) -> Setup:
    """Return the setup of a robot's files; refuse an arm of another structure with what can be done for it.

    Raises:
        ConfigError: naming file and what is accepted.
    """
    for path in (files.drives, files.controller):
        if not path.is_file():
            raise ConfigError(f"{path.parent}: no {path.name}; {_OTHER_ARMS}")
    with suppress(ET.ParseError, OSError):  # Setup.load names the fault
        joints = [one.get("name", "") for one in ET.parse(files.urdf).iter("joint") if one.get("type") in _MOVABLE]
        if len(joints) != _JOINTS:
            raise ConfigError(f"{files.urdf}: {len(joints)} movable joints; {_OTHER_ARMS}")
        there = FrictionFile.read(files.friction).elements
        if missing := [name for name in element_names(joints) if name not in there]:
            raise ConfigError(f"{files.friction}: no friction element {listed(missing)}; {_OTHER_ARMS}")
    return Setup.load(files)


def _bag_layout(bag: Path, setup: Setup, options: MeasuredLayout) -> BagLayout:
    """Return what to read of a bag; refuse that of another arm, whose first message names none of its joints."""
    check_robot(bag, setup.robot.model.name)
    joints = setup.robot.joint_names
    options, mapping = with_signals(options, [bag])
    topic = options.topic or recorded_topic(bag, (MOTOR_STATES, JOINT_STATES), mapping)
    names: Sequence[str] = ()
    if options.names is not None:
        pass
    elif is_table(bag):
        names = next((t.names for one, t in mapping_of(bag, mapping).topics.items() if absolute(one) == topic), ())
    else:
        with BagReader(bag) as reader:
            there = [one for one in reader.topics if one.name == absolute(topic) and one.is_joint_state]
            if there and (first := next(reader.messages(there), None)):
                names = [str(name) for name in reader.deserialize(first[0], first[2]).name]
    if names and not {*names} & {*joints, *MOTOR_NAMES}:
        raise IdentificationError(
            f"{bag}: {topic} is of {listed(names)}; accepted: {listed(joints)}, or --names; {_OTHER_ARMS}"
        )
    return arm_layout(topic, joints, options, lambda: setup.drives.gear, mapping)


@dataclass(frozen=True, eq=False)
class MeasuredComparison:
    """A measured run and the simulated one along the same set-points, both through the same low-pass.

    Attributes:
        names: of the six joints.
        robot: name of the simulated robot.
        source: the measured bag.
        time: by the bag's stamps, s, shape (k,).
        torque: measured drive torque at the joints, Nm, shape (k, 6).
        simulated_torque: Nm, shape (k, 6).
        position: measured, rad, shape (k, 6).
        simulated_position: rad, shape (k, 6).
        compared: where a joint's torque is compared: not at rest, where it depends on what happened before,
            shape (k, 6).
        lag: by how much the simulated motion was later than the measured one, s; it is taken out of the series.
        bandwidths: of the set-points, and of torques and positions here.
        setpoints: where the set-points come from, in words.
        saturated: share of the time in which each motor was at its limit in the simulation, shape (6,).
        remarks: what else there is to say, a sentence each.
        tolerances: what counts as agreement.
    """

    names: tuple[str, ...]
    robot: str
    source: BagSource
    time: Array
    torque: Array
    simulated_torque: Array
    position: Array
    simulated_position: Array
    compared: Mask
    lag: float
    bandwidths: Bandwidths
    setpoints: str
    saturated: Array
    remarks: tuple[str, ...]
    tolerances: MeasuredTolerances

    @cached_property
    def agreement(self) -> TorquePrediction:
        """Return the torques, as a validation of friction compares them."""
        return TorquePrediction(self.time, self.torque, self.simulated_torque, self.compared)

    torque_rms = property(attrgetter("agreement.rms"), doc="RMS torque difference, Nm, shape (6,); NaN at rest.")
    torque_worst = property(attrgetter("agreement.worst"), doc="Largest torque difference, Nm, shape (6,); or NaN.")
    torque_share = property(attrgetter("agreement.rms_share"), doc="RMS difference over RMS torque, shape (6,).")
    worst_share = property(attrgetter("agreement.worst_share"), doc="Largest difference over largest torque, (6,).")
    total_share = property(attrgetter("agreement.total_share"), doc="RMS difference of all joints over RMS torque.")

    @property
    def compared_share(self) -> Array:
        """Return the share of the time in which a joint's torque is compared, shape (6,)."""
        return np.asarray(self.compared.mean(axis=0))

    @property
    def position_rms(self) -> Array:
        """Return the RMS position difference, rad, shape (6,)."""
        return np.asarray(np.sqrt(np.mean((self.simulated_position - self.position) ** 2, axis=0)))

    @property
    def position_worst(self) -> Array:
        """Return the largest position difference, rad, shape (6,)."""
        return np.asarray(np.abs(self.simulated_position - self.position).max(axis=0))

    @property
    def criteria(self) -> tuple[Criterion, Criterion, Criterion]:
        """Return what the verdict rests on: torques of all joints and of each, and positions."""
        limits = self.tolerances
        return (
            Criterion("torque RMS of all joints", self.total_share, limits.total_torque),
            largest("largest", self.names, self.torque_share, limits.torque),
            largest("position", self.names, self.position_worst, limits.position, "mrad", 3),
        )

    @property
    def passed(self) -> bool:
        """Return whether torques, of each joint that moves and of all together, and positions agree."""
        return all(one.passed for one in self.criteria)


_MAX_BANDWIDTH_SHARE = 0.3  # bandwidth of the set-points over the rate of the position loop, at most
_MAX_LAG_S = 0.1  # s, by which the simulated motion may be later or earlier
_MIN_TRAVEL = 2e-3  # rad, some times the presliding travel of a joint: who stays within it rests
_LAG_ROUNDS = 4  # of the search for that time
_DEFAULT_LAYOUT = MeasuredLayout()
_DEFAULT_TOLERANCES = MeasuredTolerances()


def compare_measured(
    bag: Path | str,
    setup: Setup,
    layout: MeasuredLayout = _DEFAULT_LAYOUT,
    tolerances: MeasuredTolerances = _DEFAULT_TOLERANCES,
    *,
    bandwidth: float | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> MeasuredComparison:
    """Run the closed loop along what a measured arm did and compare torques and positions with the measured ones.

    Set-points are those of this project's controller where the bag holds them, else the measured path, smoothed
    without delay, with the velocities and accelerations that belong to it. Both runs pass the same zero-phase low-pass.

    Args:
        bag: of an arm of this project's structure, with positions and efforts of its joints or motors.
        setup: the robot to simulate.
        layout: what the bag holds.
        tolerances: what counts as agreement.
        bandwidth: of the measured path as set-points, Hz, a third of it for torques and positions that are compared;
            by default chosen from the data, as for an identification.
        progress: called with the name of each of three steps before it.

    Raises:
        BagError: for a bag that cannot be read.
        IdentificationError: for a bag or options that do not fit, or a bag in which nothing moves.
        TrajectoryError: for a path beyond a joint's range, naming joint, value, time and range.
        DivergenceError: naming joint and tick.
        SupervisionError: if the controller's supervision cuts the power.
    """
    check_type(setup=(setup, Setup))
    path = Path(bag)
    what = _bag_layout(path, setup, layout)
    progress(path.name)
    record = read_record(path, what)
    pieces = filter_record(record, _bandwidths(record, setup, bandwidth))
    run = max(pieces, key=lambda piece: len(piece.time))
    # A joint moves where every motor and friction element moves that it turns.
    matrix = element_matrix()
    rests = (element_states(run, matrix) == SlidingState.RESTS) @ (matrix != 0.0)
    moves = np.asarray(~rests & (np.ptp(run.position, axis=0) > _MIN_TRAVEL))
    nothing = IdentificationError(
        f"{path}: no joint moves, and torques at rest are not compared; accepted: a joint that slides over "
        f"{1e3 * _MIN_TRAVEL:g} mrad or more"
    )
    if not moves.any():
        raise nothing
    setpoints = recorded_setpoints(run, record.position[0], setup, what) or path_setpoints(run, setup)
    beyond = setpoints.beyond(path, setup)
    progress("closed loop")
    simulated, begin, end, saturated = _simulated(setup, setpoints, run)
    progress("comparison")
    time = run.time[run.rows]
    rows = (time >= begin + _MAX_LAG_S) & (time <= end - _MAX_LAG_S)  # covered, however late the simulated arm is
    if not rows.any():
        raise IdentificationError("measured and simulated run have no time in common; accepted: a longer bag")
    if not moves[rows].any():
        raise nothing
    time, velocity = time[rows], run.velocity[run.rows][rows]
    measured = run.parallel(np.stack([run.position, run.torque], axis=1))[rows]
    lag = 0.0
    for _ in range(_LAG_ROUNDS):  # least squares of the positions
        difference = simulated(time + lag - setpoints.start)[:, 0] - measured[:, 0]
        lag -= float(np.sum(difference * velocity)) / float(np.sum(velocity**2))
        lag = float(np.clip(lag, -_MAX_LAG_S, _MAX_LAG_S))
    follows = np.asarray(simulated(time + lag - setpoints.start))
    return MeasuredComparison(
        names=run.names,
        robot=setup.robot.model.name,
        source=record.bag,
        time=time,
        torque=measured[:, 1],
        simulated_torque=follows[:, 1],
        position=measured[:, 0],
        simulated_position=follows[:, 0],
        compared=moves[rows],
        lag=lag,
        bandwidths=run.bandwidths,
        setpoints=setpoints.source,
        saturated=saturated,
        remarks=(*beyond, *_remarks(record, pieces, run)),
        tolerances=tolerances,
    )


def _bandwidths(record: JointRecord, setup: Setup, bandwidth: float | None) -> Bandwidths:
    """Return the bandwidths that the data, or the user, and the position loop's rate allow."""
    highest = _MAX_BANDWIDTH_SHARE * setup.rates.position_hz
    if bandwidth is None:
        chosen = Bandwidths.of([record])
        if chosen.position <= highest:
            return chosen
        reason = f"{chosen.reason}; no more than {_MAX_BANDWIDTH_SHARE:g} of the position loop's rate"
        return Bandwidths(highest, highest / 3.0, reason)
    if not 0.0 < bandwidth <= highest:
        raise IdentificationError(f"--bandwidth is {bandwidth:g} Hz; accepted: above 0, up to {highest:g} Hz")
    return Bandwidths(bandwidth, bandwidth / 3.0)


def _simulated(setup: Setup, setpoints: SetPoints, run: FilteredRun) -> tuple[BSpline, float, float, Array]:
    """Return the simulated run through the low-pass of the measured one.

    Returns:
        Position rad and torque Nm by the time since the first set-point, shape (k, 2, 6), first and last time that it
        covers, by the bag's stamps, and the share of the time in which each motor was at its limit, shape (6,).
    """
    # As often as it was measured: what a slow sampling folds into the band is then the same on both sides.
    rates, often = setup.rates, run.rate > 1.5 * setup.rates.position_hz
    fast, slow, saturated = run_along(setup, setpoints.values, setpoints.initial_position, record_fast=often)
    values, rate = slow.joint_states[:, ::2], float(rates.base_hz if often else rates.position_hz)
    if often:
        turns = setup.drives.gear[:, None] * coupling_matrix()
        position = fast.motor_states[:, 0] @ np.linalg.inv(turns).T
        values = np.stack([position, fast.motor_states[:, 2] @ turns], axis=1)
    taps = low_pass_taps(rate, run.bandwidths.torque)
    filtered = low_pass(values, taps)
    if len(filtered) < 4:
        raise IdentificationError(f"{run.source.path}: too short for a low-pass of {run.bandwidths.torque:.3g} Hz")
    since = (len(taps) // 2 + np.arange(len(filtered))) / rate
    begin, end = (setpoints.start + float(since[k]) for k in (0, -1))
    return make_interp_spline(since, filtered, k=3), max(begin, setpoints.begin), end, saturated


def _remarks(record: JointRecord, pieces: tuple[FilteredRun, ...], run: FilteredRun) -> tuple[str, ...]:
    """Return what of the bag is not compared, and why."""
    found = []
    cut = 2.0 * (1.5 / run.bandwidths.position + 12.0 / run.rate)  # what the filters take at both ends
    if len(pieces) > 1 or record.time[-1] - record.time[0] - (run.time[-1] - run.time[0]) > 1.5 * cut:
        found.append(
            f"there are gaps in the record: only {run.time[0]:.3f} to {run.time[-1]:.3f} s of {record.time[0]:.3f} to "
            f"{record.time[-1]:.3f} s is compared, the longest part without one"
        )
    if record.outliers:
        found.append(f"{record.outliers} samples were left out: NaN, single spikes or repeated stamps")
    if record.missing:
        found.append(f"{record.missing} messages are missing from the stream")
    return tuple(found)
