"""Simulate what a measured arm did, in the closed loop without ROS, and compare torques and positions."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from rx90_common.bags.mapping import LogMapping, is_table, mapping_of
from rx90_common.bags.reading import BagReader
from rx90_common.bags.recorded import check_robot
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import ConfigError, IdentificationError, check_type
from rx90_common.base.quoting import listed
from rx90_common.description.drives import coupling_matrix, element_matrix
from rx90_common.description.robot_files import FILES, RobotFiles
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
from rx90_emulator.identification.excitation.problem import element_states
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.identification.records import BagSource, JointRecord, read_record
from rx90_emulator.identification.robot import JOINT_STATES, BagLayout, arm_layout, recorded_topic, with_signals
from rx90_emulator.identification.validation.options import MeasuredTolerances
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
    for role in ("drives", "controller"):
        path: Path = getattr(files, role)
        if not path.is_file():
            raise ConfigError(f"{path.parent}: no {FILES[role]}; {_OTHER_ARMS}")
    try:
        joints = [one.get("name", "") for one in ET.parse(files.urdf).iter("joint") if one.get("type") in _MOVABLE]
    except (ET.ParseError, OSError):
        return Setup.load(files)  # which names the fault
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
    names = () if options.names is not None else _first_names(bag, topic, mapping)
    if names and not {*names} & {*joints, *MOTOR_NAMES}:
        raise IdentificationError(
            f"{bag}: {topic} is of {listed(names)}; accepted: {listed(joints)}, or --names; {_OTHER_ARMS}"
        )
    return arm_layout(topic, joints, options, lambda: setup.drives.gear, mapping)


def _first_names(bag: Path, topic: str, mapping: LogMapping | None) -> Sequence[str]:
    if is_table(bag):
        return next((t.names for name, t in mapping_of(bag, mapping).topics.items() if absolute(name) == topic), ())
    with BagReader(bag) as reader:
        there = [one for one in reader.topics if one.name == absolute(topic) and one.is_joint_state]
        first = next(reader.messages(there), None) if there else None
        return [str(name) for name in reader.deserialize(first[0], first[2]).name] if first else []


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

    @property
    def torque_rms(self) -> Array:
        """Return the RMS torque difference where a joint moves, Nm, shape (6,); NaN for a joint at rest."""
        return self.agreement.rms

    @property
    def torque_worst(self) -> Array:
        """Return the largest torque difference where a joint moves, Nm, shape (6,); NaN for a joint at rest."""
        return self.agreement.worst

    @property
    def torque_share(self) -> Array:
        """Return the RMS difference over the RMS measured torque, shape (6,)."""
        return self.agreement.rms_share

    @property
    def worst_share(self) -> Array:
        """Return the largest difference over the largest measured torque, shape (6,)."""
        return self.agreement.worst_share

    @property
    def compared_share(self) -> Array:
        """Return the share of the time in which a joint's torque is compared, shape (6,)."""
        return np.asarray(self.compared.mean(axis=0))

    @property
    def total_share(self) -> float:
        """Return the RMS difference of all joints over their RMS measured torque."""
        return self.agreement.total_share

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
    bandwidths = _bandwidths(record, setup, bandwidth)
    pieces = filter_record(record, bandwidths)
    run = max(pieces, key=lambda piece: len(piece.time))
    moves = _moves(run)
    nothing = IdentificationError(
        f"{path}: no joint moves, and torques at rest are not compared; accepted: a joint that slides over "
        f"{1e3 * _MIN_TRAVEL:g} mrad or more"
    )
    if not moves.any():
        raise nothing
    setpoints = recorded_setpoints(run, record.position[0], setup, what) or path_setpoints(run, setup)
    beyond = setpoints.beyond(path, setup.controller.limits(setup.robot), setup.rates.position_period)
    progress("closed loop")
    simulated = _Simulated(setup, setpoints, run)
    progress("comparison")
    rows = simulated.covered
    if not moves[rows].any():
        raise nothing
    time = run.time[run.rows][rows]
    measured = run.parallel(np.stack([run.position, run.torque], axis=1))[rows]
    lag = simulated.lag(time, measured[:, 0], run.velocity[run.rows][rows])
    follows = simulated.at(time + lag)
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
        bandwidths=bandwidths,
        setpoints=setpoints.source,
        saturated=simulated.saturated,
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


class _Simulated:
    """The simulated run, through the low-pass of the measured one, at any time."""

    def __init__(self, setup: Setup, setpoints: SetPoints, run: FilteredRun) -> None:
        rates = setup.rates
        # As often as it was measured: what a slow sampling folds into the band is then the same on both sides.
        often = run.rate > 1.5 * rates.position_hz
        fast, slow, self.saturated = run_along(setup, setpoints.values, setpoints.initial_position, record_fast=often)
        if often:
            turns = setup.drives.gear[:, None] * coupling_matrix()
            position = fast.motor_states[:, 0] @ np.linalg.inv(turns).T
            values = np.stack([position, fast.motor_states[:, 2] @ turns], axis=1)
        else:
            values = slow.joint_states[:, ::2]
        rate = float(rates.base_hz if often else rates.position_hz)
        taps = low_pass_taps(rate, run.bandwidths.torque)
        filtered = low_pass(values, taps)
        if len(filtered) < 4:
            raise IdentificationError(f"{run.source.path}: too short for a low-pass of {run.bandwidths.torque:.3g} Hz")
        since = (len(taps) // 2 + np.arange(len(filtered))) / rate
        self._start = setpoints.start
        self._curve: BSpline = make_interp_spline(since, filtered, k=3)
        first, last = max(self._start + float(since[0]), setpoints.begin), self._start + float(since[-1])
        time = run.time[run.rows]
        self.covered: Mask = (time >= first + _MAX_LAG_S) & (time <= last - _MAX_LAG_S)
        """Which of the run's rows it covers, however late it is."""
        if not self.covered.any():
            raise IdentificationError("measured and simulated run have no time in common; accepted: a longer bag")

    def at(self, time: Array) -> Array:
        """Return position rad and torque Nm at times, shape (k, 2, 6)."""
        return np.asarray(self._curve(time - self._start))

    def lag(self, time: Array, position: Array, velocity: Array) -> float:
        """Return by how much it is later than the measured motion, s: least squares of the positions."""
        lag, power = 0.0, float(np.sum(velocity**2))
        for _ in range(_LAG_ROUNDS):
            difference = self.at(time + lag)[:, 0] - position
            lag = float(np.clip(lag - np.sum(difference * velocity) / power, -_MAX_LAG_S, _MAX_LAG_S))
        return lag


def _moves(run: FilteredRun) -> Mask:
    """Return where each joint moves, and with it every motor and friction element that it turns, shape (k, 6)."""
    matrix = element_matrix()
    rests = element_states(run, matrix)[0] @ (matrix != 0.0)
    return np.asarray(~rests & (np.ptp(run.position, axis=0) > _MIN_TRAVEL))


def _remarks(record: JointRecord, pieces: tuple[FilteredRun, ...], run: FilteredRun) -> tuple[str, ...]:
    """Return what of the bag is not compared, and why."""
    said = []
    cut = 2.0 * (1.5 / run.bandwidths.position + 12.0 / run.rate)  # what the filters take at both ends
    if len(pieces) > 1 or record.time[-1] - record.time[0] - (run.time[-1] - run.time[0]) > 1.5 * cut:
        said.append(
            f"there are gaps in the record: only {run.time[0]:.3f} to {run.time[-1]:.3f} s of {record.time[0]:.3f} to "
            f"{record.time[-1]:.3f} s is compared, the longest part without one"
        )
    if record.outliers:
        said.append(f"{record.outliers} samples were left out: NaN, single spikes or repeated stamps")
    if record.missing:
        said.append(f"{record.missing} messages are missing from the stream")
    return tuple(said)
