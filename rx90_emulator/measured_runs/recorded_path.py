"""The path error of a recorded arm, by the path that the set-points in its bag describe."""

from __future__ import annotations

from contextlib import suppress
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import LogMapping, is_table
from rx90_common.bags.reading import read_joint_bag
from rx90_common.bags.recorded import read_trajectories
from rx90_common.bags.topics import absolute
from rx90_common.base.arrays import Array, Mask
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS, message_time_ns
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.topics import MOTOR_STATES, REFERENCE, SAMPLED
from rx90_controller.lines.task import SETTLING
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.identification.robot import (
    JOINT_STATES,
    arm_layout,
    recorded_topic,
    topic_names,
    with_signals,
)
from rx90_emulator.loop.line import PathAccuracy, followed_accuracy
from rx90_emulator.loop.recorded_setup import check_robot

_AT_REST = 1e-6  # rad
_GAP = 3.5  # times the median interval: where more than two set-points in a row are missing, nothing counts


class RecordedAccuracy(NamedTuple):
    """The path error in a bag.

    Attributes:
        line: without approaches; None in a bag of these alone, or without set-points.
        approach: on the way to the first point of a trajectory that rests there; None if there is no such way.
    """

    line: PathAccuracy | None = None
    approach: PathAccuracy | None = None


def recorded_accuracy(
    bag: Path, robot: RobotModel, files: RobotFiles, signals: Path | None = None
) -> RecordedAccuracy:
    """Measure the path error in a bag by `followed_accuracy`.

    The joints are those of `joint_states` in any namespace, else of `motor_states` through the gears.

    Args:
        bag: a rosbag2 folder, an .mcap or .db3 file, a ROS 1 .bag file, or a table.
        robot: the arm in it.
        files: the robot's, of which the drives are read if the bag has states of the motors alone.
        signals: signal map of a table; by default the file beside it.
    """
    check_robot(bag, robot.model.name)
    options, mapping = with_signals(
        MeasuredLayout(signals=signals if is_table(bag) else None), [bag]
    )
    topic = _arm_topic(bag, mapping)
    setpoint_topic = _setpoint_topic(bag, topic, mapping)
    if setpoint_topic is None:
        return RecordedAccuracy()
    layout = arm_layout(
        topic, robot.joint_names, options, lambda: load_drives(files.drives), mapping
    )
    series = read_joint_bag(
        bag, [topic, setpoint_topic], mapping=mapping, record_time=layout.record_time
    )
    arm = _last_run(bag, series.one(topic, layout.messages))
    setpoints = _last_run(bag, series.one(setpoint_topic, robot.joint_names))
    counted = arm.take(_between_setpoints(arm, setpoints))
    position = layout.joint_side(counted.fields)["position"]
    begin = arm.stamp_ns[0]
    times = (counted.stamp_ns - begin) / NANOSECONDS
    setpoint_times = (setpoints.stamp_ns - begin) / NANOSECONDS
    accuracy = followed_accuracy(
        robot, times, position, setpoint_times, setpoints.fields["position"]
    )
    approach = _approach(bag, setpoints, np.rint(accuracy.times * NANOSECONDS) + begin)
    if not approach.any():
        return RecordedAccuracy(accuracy)
    line = None if approach.all() else accuracy.take(~approach)
    return RecordedAccuracy(line, accuracy.take(approach))


def _approach(bag: Path, setpoints: JointSeries, stamps: Array) -> Mask:
    """Tell at which stamps, ns, the arm was on the way to the first point of a trajectory, or settled there."""
    rows = np.zeros(len(stamps), dtype=np.bool_)
    with suppress(BagError):  # a table, or the trajectories of several controllers
        trajectories = read_trajectories(bag)
        for (begin, trajectory), later in zip_longest(trajectories, trajectories[1:]):
            points = trajectory.points
            if len(points) < 2 or not len(points[0].velocities) or any(points[0].velocities):
                continue
            end = begin + message_time_ns(points[0].time_from_start)
            if end == begin:
                continue
            # until the set-points go on
            there = np.searchsorted(setpoints.stamp_ns, [end, end + SETTLING * NANOSECONDS])
            held = setpoints.fields["position"][slice(*there)]
            moved = np.abs(held - held[:1]).max(axis=1) > _AT_REST
            settled = setpoints.stamp_ns[slice(*there)][~moved]
            way = (stamps >= begin) & (stamps <= settled.max(initial=end))
            rows |= way if later is None else way & (stamps < later.start_ns)
    return rows


def _arm_topic(bag: Path, mapping: LogMapping | None) -> str:
    for wanted in (JOINT_STATES, MOTOR_STATES):
        # What is sampled is the same once more, for those who look on.
        topics = [
            topic
            for topic in topic_names(bag, mapping)
            if topic.endswith(f"/{wanted}") and f"/{SAMPLED}/" not in topic
        ]
        if len(topics) > 1:
            raise BagError(
                f"{plain(bag)}: holds several arms, {listed(sorted(topics))}; accepted: a bag of one arm"
            )
        if topics:
            return topics[0]
    return absolute(recorded_topic(bag, (JOINT_STATES, MOTOR_STATES), mapping))


def _setpoint_topic(bag: Path, arm: str, mapping: LogMapping | None) -> str | None:
    """Return the topic of set-points in the arm's namespace, or below it."""
    namespace = arm.rpartition("/")[0]
    topics = [
        topic
        for topic in topic_names(bag, mapping)
        if topic.startswith(f"{namespace}/") and topic.endswith(f"/{REFERENCE}")
    ]
    return min(topics, key=lambda topic: topic.count("/"), default=None)


def _last_run(bag: Path, series: JointSeries) -> JointSeries:
    """Return finite positions at increasing stamps; after a jump back by more than a gap only what follows it."""
    if series.position is None:
        raise BagError(
            f"{plain(bag)}: {series.topic} carries no positions; accepted: a bag with joint angles"
        )
    finite: Mask = np.asarray(np.isfinite(series.position).all(axis=1))
    series = series.take(finite)
    back = np.flatnonzero(np.diff(series.stamp_ns) < -_longest_step(series))
    if len(back):
        series = series.take(slice(int(back[-1]) + 1, None))
    rows = np.unique(series.stamp_ns, return_index=True)[1]
    if len(rows) < 2:
        raise BagError(
            f"{plain(bag)}: {series.topic} has no two stamps; accepted: increasing stamps"
        )
    return series.take(rows)


def _longest_step(series: JointSeries) -> float:
    """Return the longest interval without a gap, ns."""
    steps = np.diff(series.stamp_ns)
    forward = steps[steps > 0]
    return _GAP * float(np.median(forward)) if len(forward) else 0.0


def _between_setpoints(arm: JointSeries, setpoints: JointSeries) -> Mask:
    """Tell at which stamps of the arm there are set-points, and no gap of them."""
    stamps = setpoints.stamp_ns
    after = np.searchsorted(stamps, arm.stamp_ns)
    inside = (arm.stamp_ns >= stamps[0]) & (after < len(stamps))
    after = np.clip(after, 1, len(stamps) - 1)
    exact = np.isin(arm.stamp_ns, stamps)
    step = stamps[after] - stamps[after - 1]
    return np.asarray(inside & (exact | (step <= _longest_step(setpoints))))
