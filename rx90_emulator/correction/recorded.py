"""The errors of a trial, from the bag of an arm or of the nodes, and from a tip measured by a sensor.

The beginning of the trajectory is found in the record itself: the nominal motion is shifted to where it fits best. A
bag of the nodes contains their set-points, which determine it exactly. Measured joints lag behind the set-points; this
lag then does not count, and only the path remains, which is the purpose of a correction.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import fftconvolve

from rx90_common.bags.comparison import align
from rx90_common.bags.reading import read_joint_states
from rx90_common.base.arrays import Array, interpolated, rms
from rx90_common.base.errors import BagError, ConfigError
from rx90_common.base.quoting import counted, plain
from rx90_emulator.correction.file import CorrectionFile
from rx90_emulator.correction.learning import RECORD, LearnedCorrection, Learner, Measured
from rx90_emulator.correction.path import TrajectoryPath
from rx90_emulator.loop.drawing import UNITS, read_columns
from rx90_emulator.loop.setup import Setup

REFERENCE = "rx90_controller/reference"
TRACKING = "rx90_controller/tracking_error"
CORRECTION = "rx90_controller/correction"
_GAP = 3.5  # times the median interval, or the set-points' own: up to two missing samples are interpolated
# of the range of a motion, root mean square: a larger one means another motion
_MAX_DIFFERENCE = 0.02
# longest record, in set-points: the search for the motion then takes some GB
_MAX_ROWS = 10_000_000


class Laid(NamedTuple):
    """A record, aligned with the nominal motion.

    Attributes:
        values: at the nominal motion's set-points, shape (n, d).
        shift: beginning of the motion in the record's time, s.
        difference: root mean square difference, as a share of the motion's range.
    """

    values: Array
    shift: float
    difference: float


def laid_under(
    times: Array, values: Array, nominal: Array, path: TrajectoryPath, what: str
) -> Laid:
    """Find the time at which a nominal motion runs in a record, and return the record at its set-points.

    Args:
        times: of the record, s, increasing, shape (m,).
        values: shape (m, d).
        nominal: motion, shape (n, d).
        path: to which it belongs; its counted set-points must be in the record.
        what: name of the record, for refusals.
    """
    period = path.period
    counts = path.counts
    if len(times) < 2 or not (np.diff(times) > 0.0).all() or not np.isfinite(values).all():
        raise ConfigError(
            f"{what}: {counted(len(times), 'row')}; accepted: two or more, finite, with increasing times"
        )
    count = len(nominal)
    # The record is extended by its first and last value, so that a rest before or after the motion may be missing.
    if not times[-1] - times[0] <= _MAX_ROWS * period:
        raise ConfigError(
            f"{what}: {times[-1] - times[0]:.6g} s; accepted: up to {_MAX_ROWS * period:g} s"
        )
    grid = times[0] + np.arange(-count, round((times[-1] - times[0]) / period) + count) * period
    record = interpolated(grid, times, values)
    middle = nominal.mean(axis=0)
    record = record - middle
    motion = nominal - middle
    together = sum(
        fftconvolve(record[:, k], motion[::-1, k], "valid") for k in range(record.shape[1])
    )
    squares = np.append(0.0, np.cumsum((record**2).sum(axis=1)))
    between = (motion**2).sum() + squares[count:] - squares[:-count] - 2.0 * together
    best = int(np.argmin(between))
    shift = grid[best]
    if 0 < best < len(between) - 1:  # the parabola through three
        before, here, after = between[best - 1 : best + 2]
        bend = before - 2.0 * here + after
        shift += 0.0 if bend <= 0.0 else 0.5 * period * (before - after) / bend
    rows = shift + np.arange(count) * period
    begin, end = rows[counts][[0, -1]]
    if begin < times[0] - period or end > times[-1] + period:
        raise ConfigError(
            f"{what}: from {times[0]:.6g} to {times[-1]:.6g} s, the path takes from {begin:.6g} to {end:.6g} s of it; "
            "accepted: a record of all of the path"
        )
    steps = np.diff(times)
    inside = np.where((times[1:] > begin) & (times[:-1] < end), steps, 0.0)
    gap = int(np.argmax(inside))
    if inside[gap] > _GAP * max(float(np.median(steps)), period):
        raise ConfigError(
            f"{what}: nothing for {inside[gap]:.3g} s from {times[gap]:.6g} s on, within the path; "
            "accepted: a record without gaps"
        )
    found = interpolated(rows, times, values)
    difference = float(rms((found - nominal)[counts]) / max(np.ptp(nominal, axis=0).max(), 1e-12))
    if difference > _MAX_DIFFERENCE:
        raise ConfigError(
            f"{what}: {difference:.1%} of the motion's range away from the path where they fit best, at {shift:.6g} s; "
            f"accepted: up to {_MAX_DIFFERENCE:.0%}, a record of this path"
        )
    return Laid(found, float(shift), difference)


def joints_of_bag(
    bag: Path | str, setup: Setup, nominal: TrajectoryPath, topic: str = "joint_states"
) -> tuple[Array, Array | None, str]:
    """Return set-points less joints by the encoders, the offsets of a correction, and how they were found.

    Both are in rad, of shape (n, joints). In a bag of the nodes they are the controller's own; other bags do not
    contain the offsets, which are then None.
    """
    names = setup.robot.joint_names
    asked = nominal.setpoints[:, 0]
    tracking = None
    try:
        series = read_joint_states(bag, REFERENCE, names)
        tracking = read_joint_states(bag, TRACKING, names)
    except BagError:
        series = read_joint_states(bag, topic, names)
    if series.position is None:
        raise BagError(f"{plain(bag)}: {series.topic} without positions; accepted: joint positions")
    laid = laid_under(series.time, series.position, asked, nominal, plain(bag))
    if tracking is None:
        return (
            asked - laid.values,
            None,
            f"{topic}, begun at {laid.shift:.6f} s of its time, {laid.difference:.2%} apart",
        )
    assert tracking.position is not None
    added = np.zeros_like(tracking.position)
    with suppress(BagError):  # no such topic, or no message on it: no correction was played
        played = read_joint_states(bag, CORRECTION, names)
        assert played.position is not None
        both = align(tracking, played)
        added[both.rows_a] = played.position[both.rows_b]
    first = round(laid.shift / nominal.period)
    ticks = np.round(tracking.time / nominal.period).astype(np.int64)
    rows = np.clip(np.searchsorted(ticks, first + np.arange(len(asked))), 0, len(ticks) - 1)
    source = f"the controller's set-points, begun at {first * nominal.period:.6f} s"
    return (tracking.position - added)[rows], added[rows], source


def tip_of_file(file: Path | str, nominal: TrajectoryPath) -> tuple[Array, str]:
    """Return required less measured position of the tip at a path's set-points, m, shape (n, 3).

    The file is a CSV table with a header: `time [s]`, and `x`, `y`, `z` of the tool centre point in the base frame,
    each with its unit, such as `[mm]`.

    Returns:
        The error, and how it was found.
    """
    rows, units = read_columns(Path(file), ("time", "x", "y", "z"))
    if units[0] != "s" or len(set(units[1:])) > 1 or units[1] not in UNITS:
        named = ", ".join(unit or "none" for unit in units)
        raise ConfigError(
            f"{plain(file)}: time, x, y, z have the units {named}; accepted: the titles time [s] and x, y, z in one of "
            f"{', '.join(UNITS)}"
        )
    laid = laid_under(rows[:, 0], UNITS[units[1]] * rows[:, 1:], nominal.tip, nominal, plain(file))
    return (
        nominal.tip - laid.values,
        f"tip of {plain(file)}, begun at {laid.shift:.6f} s of its time",
    )


def measured(
    setup: Setup,
    nominal: TrajectoryPath,
    bag: Path | str | None,
    tip: Path | str | None,
    topic: str = "joint_states",
) -> tuple[Measured, list[str]]:
    """Return the errors of a trial, and a line on each record on how it was found; from a bag, a tip, or both.

    Raises:
        Rx90Error: as `joints_of_bag` and `tip_of_file`.
    """
    joints = np.zeros((len(nominal.counts), len(setup.robot.joint_names)))
    played = None
    sources = []
    if bag is not None:
        joints, played, text = joints_of_bag(bag, setup, nominal, topic)
        sources.append(text)
    error = None
    if tip is not None:
        error, text = tip_of_file(tip, nominal)
        sources.append(text)
    return Measured(joints, error, played), sources


def learn_from_record(
    learner: Learner, found: Measured, earlier: CorrectionFile | None = None
) -> tuple[LearnedCorrection, str]:
    """Learn from one recorded trial, and return the correction of the next one.

    It is compared with earlier trials that were measured in the same way, not with those of the engine, whose arm is
    another one.

    Args:
        learner: with the played offsets, if any, as `previous`.
        found: the errors of the trial.
        earlier: the file that was played.

    Returns:
        The correction, and why the trial was not accepted; empty if it was.

    Raises:
        ConfigError, CorrectionError: as `Learner.take`.
    """
    before = () if earlier is None else earlier.last_worst(learner.measurement(RECORD))
    if earlier is not None and before:
        learner.go_on(earlier.best, before)
    why = "" if learner.take(found).kept else f"worse than {min(before) * 1e3:.4f} mm before"
    return LearnedCorrection.of(learner, RECORD, learner.offsets), why
