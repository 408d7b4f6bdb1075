"""Simulate what a measured arm did, and compare torques and positions."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import IdentificationError, check_type
from rx90_common.description.wrist import coupling_matrix, element_matrix
from rx90_emulator.identification.excitation.filtering import (
    Bandwidths,
    FilteredRun,
    filter_record,
    low_pass,
    low_pass_taps,
)
from rx90_emulator.identification.excitation.problem import SlidingState, element_states
from rx90_emulator.identification.records.reading import read_record
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.loop.closed_loop import run_setpoints
from rx90_emulator.loop.result import empty_series
from rx90_emulator.loop.setup import Setup
from rx90_emulator.measured.comparison import MeasuredComparison
from rx90_emulator.measured.layout import bag_layout
from rx90_emulator.measured.options import MeasuredLayout, MeasuredTolerances
from rx90_emulator.measured.setpoints import SetPoints, path_setpoints, recorded_setpoints

_HIGHEST = 0.3  # bandwidth of the set-points over the rate of the position loop, at most
_LATEST = 0.1  # s, by which the simulated motion may be later or earlier
_TRAVEL = 2e-3  # rad, some times the presliding travel of a joint: who stays within it rests
_ROUNDS = 4  # of the search for that time
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
    what = bag_layout(path, setup, layout)
    progress(path.name)
    record = read_record(path, what)
    bandwidths = _bandwidths(record, setup, bandwidth)
    pieces = filter_record(record, bandwidths)
    run = max(pieces, key=lambda piece: len(piece.time))
    moves = _moves(run)
    if not moves.any():
        raise IdentificationError(
            f"{path}: no joint moves, and torques at rest are not compared; accepted: a joint that slides over "
            f"{1e3 * _TRAVEL:g} mrad or more"
        )
    setpoints = recorded_setpoints(run, record.position[0], setup, what.zero) or path_setpoints(run, setup)
    beyond = setpoints.beyond(path, setup.controller.limits(setup.robot), setup.rates.position_period)
    progress("closed loop")
    simulated = _Simulated(setup, setpoints, run)
    progress("comparison")
    rows = simulated.within(run.time[run.rows])
    time = run.time[run.rows][rows]
    measured = run.parallel(np.stack([run.position, run.torque], axis=1))[rows]
    speed = run.velocity[run.rows][rows]
    lag = _lag(simulated, time, measured[:, 0], speed)
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
    highest = _HIGHEST * setup.rates.position_hz
    if bandwidth is None:
        chosen = Bandwidths.of([record])
        if chosen.position <= highest:
            return chosen
        reason = f"{chosen.reason}; no more than {_HIGHEST:g} of the position loop's rate"
        return Bandwidths(highest, highest / 3.0, reason)
    if not 0.0 < bandwidth <= highest:
        raise IdentificationError(f"--bandwidth is {bandwidth:g} Hz; accepted: above 0, up to {highest:g} Hz")
    return Bandwidths(bandwidth, bandwidth / 3.0)


class _Simulated:
    """The simulated run, through the low-pass of the measured one, at any time.

    Attributes:
        saturated: share of the ticks in which each motor was at its limit, shape (6,).
    """

    def __init__(self, setup: Setup, setpoints: SetPoints, run: FilteredRun) -> None:
        rates, gear = setup.rates, setup.drives.gear
        ticks = len(setpoints.values) * rates.ratio
        plant, controller = setup.plant(), setup.cs7b()
        plant.reset(setpoints.initial_position)
        controller.reset(plant.motor_states()[0])
        # As often as it was measured: what a slow sampling folds into the band is then the same on both sides.
        often = run.rate > 1.5 * rates.position_hz
        fast, slow = empty_series(ticks, rates.ratio, record_fast=often)
        run_setpoints(plant, controller, setpoints.values, ticks, fast, slow)
        if often:
            turns = gear[:, None] * coupling_matrix()
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
        self.saturated = np.asarray(controller.saturated / ticks)
        self._start = setpoints.start
        self._first, self._last = max(self._start + float(since[0]), setpoints.begin), self._start + float(since[-1])
        self._curve: BSpline = make_interp_spline(since, filtered, k=3)

    def within(self, time: Array) -> Mask:
        """Return which of the times it covers, however late it is."""
        inside = (time >= self._first + _LATEST) & (time <= self._last - _LATEST)
        if not inside.any():
            raise IdentificationError("measured and simulated run have no time in common; accepted: a longer bag")
        return inside

    def at(self, time: Array) -> Array:
        """Return position rad and torque Nm at times, shape (k, 2, 6)."""
        return np.asarray(self._curve(time - self._start))


def _lag(simulated: _Simulated, time: Array, position: Array, velocity: Array) -> float:
    """Return by how much the simulated motion is later than the measured one, s: least squares of the positions."""
    lag, power = 0.0, float(np.sum(velocity**2))
    for _ in range(_ROUNDS):
        difference = simulated.at(time + lag)[:, 0] - position
        lag = float(np.clip(lag - np.sum(difference * velocity) / power, -_LATEST, _LATEST))
    return lag


def _moves(run: FilteredRun) -> Mask:
    """Return where each joint moves, and with it every motor and friction element that it turns, shape (k, 6)."""
    matrix = element_matrix()
    rests = (element_states(run, matrix) == SlidingState.RESTS) @ (matrix != 0.0)
    return np.asarray(~rests & (np.ptp(run.position, axis=0) > _TRAVEL))


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
