"""A bag as the viewer shows it: the arm's states, friction, set-points, changes of parameters, and what is lacking."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.mapping import is_table
from rx90_common.bags.reading import BagReader, BagTopic
from rx90_common.bags.recorded import ParameterChange, changes_of, check_robot
from rx90_common.bags.topics import FIELDS, absolute, tells_changes
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.drives import load_drives
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.topics import MOTOR_STATES, SAMPLED
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.identification.robot import JOINT_STATES, arm_layout, with_signals
from rx90_emulator.view.track import Track

_FRICTION, _REFERENCE = "friction_states", "reference"
_SHOWN = {_FRICTION: ("effort",), _REFERENCE: ("position",)}  # beside the arm's own states
_SLACK = 0.05  # rad beyond a joint's range: end stops give way
_STEP = 8192  # messages between two looks at the progress bar


@dataclass(frozen=True, eq=False)
class Recording:
    """What is shown of a bag.

    Attributes:
        path: of the bag.
        kind: mcap, db3 or bag, with what is compressed in it.
        topics: all that it holds.
        arm: position of the joints, and velocity and effort (drive torque at the joint) where the bag has them.
        friction: effort, the friction torque of each element; None if the bag does not have it.
        reference: position, the set-points of the joints; None if the bag does not have them.
        changes: of parameters while the nodes ran.
        notes: lines for the user about what was read otherwise than the bag says.
    """

    path: Path
    kind: str
    topics: Sequence[BagTopic]
    arm: Track
    friction: Track | None
    reference: Track | None
    changes: Sequence[ParameterChange]
    notes: Sequence[str]

    @property
    def begin_ns(self) -> int:
        """Return the first stamp of the arm, ns."""
        return self.arm.begin_ns

    @property
    def lacking(self) -> tuple[str, ...]:
        """Return in words what a whole bag of the suite has and this one has not."""
        there = {
            "velocity": self.arm.velocity, "drive torque": self.arm.effort,
            "friction": self.friction, "set-points": self.reference,
        }  # fmt: skip
        return tuple(words for words, values in there.items() if values is None)

    def moved(self, by_ns: int) -> Recording:
        """Return the same recording, later by `by_ns`."""

        def later(track: Track) -> Track:
            return replace(track, stamp_ns=track.stamp_ns + by_ns)

        changes = [replace(change, stamp_ns=change.stamp_ns + by_ns) for change in self.changes]
        friction, reference = (track and later(track) for track in (self.friction, self.reference))
        return replace(self, arm=later(self.arm), friction=friction, reference=reference, changes=changes)


def open_recording(path: Path, robot: RobotModel, files: RobotFiles, options: MeasuredLayout) -> Recording:
    """Read a bag of a robot, with a progress bar if it takes a while.

    Args:
        path: a rosbag2 folder, an .mcap or .db3 file, or a ROS 1 .bag file.
        robot: whose joints are looked for.
        files: the robot's, of which the drives are read if the bag holds motors' states alone.
        options: what the messages hold where it is not as here.

    Raises:
        BagError: if the bag cannot be read, is of another robot, or tells no joint angles or no times.
        ConfigError: if the drives file or a signal map is not acceptable.
        IdentificationError: for options of another size, and gears and coupling that do not fit together.
    """
    check_robot(path, robot.model.name)
    options, mapping = with_signals(options, [path])
    with BagReader(path, mapping) as bag:
        arm = _topic_of_arm(bag, options.topic)
        layout = arm_layout(arm.name, robot.joint_names, options, lambda: load_drives(files.drives).gear, mapping)
        beside = {name: topic for name in _SHOWN if (topic := _topic_beside(arm, bag.topics, name)) is not None}
        fields = {arm: FIELDS, **{topic: _SHOWN[name] for name, topic in beside.items()}}
        changes, series = _read(bag, fields, record_time=layout.record_time)
        notes, topics, kind = [*bag.notes], bag.topics, " of ".join(filter(None, (bag.storage, bag.compression)))
    states = _with_joints(series.pop(arm), layout.messages)
    if states.position is None:
        raise BagError(f"{plain(path)}: {layout.topic} carries no positions; accepted: a bag with joint angles")
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(states.position).all(axis=1))
    if not finite.all():
        notes.append(f"{len(finite) - finite.sum():,} messages of {layout.topic} without finite positions are left out")
        states = states.take(finite)
    unit = states.effort_unit if layout.torque_constant is None else ""
    sides: dict[str, Any] = layout.joint_side(states.fields)
    track = _track(path, replace(states, names=layout.names, effort_unit=unit, **sides), notes)
    notes += _beyond_range(track, robot)
    friction, reference = (series[beside[name]] if name in beside else [] for name in _SHOWN)
    return Recording(
        path, kind, topics, track,
        _track(path, friction[0], notes) if friction else None,
        _track(path, _with_joints(reference, robot.joint_names), notes) if reference else None,
        changes, notes,
    )  # fmt: skip


def _topic_of_arm(bag: BagReader, wanted: str | None) -> BagTopic:
    held = [topic for topic in bag.topics if topic.is_joint_state and topic.count]
    if wanted is not None:
        fitting = [topic for topic in held if topic.name == absolute(wanted)]
    else:
        fitting = [topic for topic in held if topic.name.rpartition("/")[2] == JOINT_STATES]
        # Of those recorded with what the simulation publishes once more for who looks on.
        fitting = [topic for topic in fitting if not topic.name.endswith(f"/{SAMPLED}/{JOINT_STATES}")] or fitting
        fitting = fitting or [topic for topic in held if topic.name.rpartition("/")[2] == MOTOR_STATES]
        fitting = fitting or held * (is_table(bag.path) and len(held) == 1)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        what = f"holds the states of several arms, {listed(topic.name for topic in fitting)}"
    else:
        what = f"no messages in {plain(absolute(wanted))}" if wanted else f"neither {JOINT_STATES} nor {MOTOR_STATES}"
        what += f"; JointState topics with messages: {listed(topic.name for topic in held) or 'none'}"
    raise BagError(f"{plain(bag.path)}: {what}; accepted: --topic with one")


def _topic_beside(arm: BagTopic, topics: Sequence[BagTopic], name: str) -> BagTopic | None:
    """Return the JointState topic of a name in the namespace of the arm's, or below it."""
    namespace = arm.name.rpartition("/")[0] + "/"
    found = [
        topic
        for topic in topics
        if topic.is_joint_state and topic.count and topic.name.rpartition("/")[2] == name
        if topic.name.startswith(namespace) and topic != arm
    ]
    return min(found, key=lambda topic: topic.name.count("/"), default=None)


def _read(
    bag: BagReader, fields: Mapping[BagTopic, Sequence[str]], *, record_time: bool
) -> tuple[list[ParameterChange], dict[BagTopic, list[JointSeries]]]:
    """Return the changes of parameters, and the series of each topic with the wanted fields."""
    builders = {topic: bag.series_builder(topic, wanted) for topic, wanted in fields.items()}
    telling = [topic for topic in bag.topics if tells_changes(topic.name, topic.msgtype)]
    changes: list[ParameterChange] = []
    total = sum(topic.count for topic in (*fields, *telling))
    try:
        with tqdm(total=total, unit=" messages", unit_scale=True, delay=0.5, disable=None, file=sys.stderr, leave=False,
                  desc=f"reading {plain(bag.path.name, 40)}") as bar:  # fmt: skip
            for number, (topic, log_ns, data) in enumerate(bag.messages([*fields, *telling]), 1):
                builder = builders.get(topic)
                if builder is None:
                    changes += changes_of(bag.deserialize(topic, data))
                else:
                    builder.add(data, log_ns if record_time else None)
                if number % _STEP == 0:
                    bar.update(_STEP)
        return changes, {topic: builders.pop(topic).build() for topic in fields}
    except BagError as error:
        text, name = str(error), plain(bag.path)
        raise error if text.startswith(name) else BagError(f"{name}: {text}") from error


def _with_joints(found: Sequence[JointSeries], names: Sequence[str]) -> JointSeries:
    """Return the first series that has these joints, in their order."""
    for series in found:
        if set(names) <= set(series.names):
            return series if series.names == tuple(names) else series.select(names)
    other = f"; every arm here has {len(names)} joints" * (len(found[-1].names) != len(names))
    raise BagError(
        f"{found[-1].topic} is of {listed(found[-1].names)}; accepted: a bag with {listed(names)}, --robot with the "
        f"bag's, or --names with what it calls these joints{other}"
    )


def _beyond_range(track: Track, robot: RobotModel) -> list[str]:
    """Return a line for joints that go where this robot cannot: many bags do not say whose they are."""
    values = track.fields["position"]
    low, high = values.min(axis=0), values.max(axis=0)
    beyond = np.maximum(robot.lower - low, high - robot.upper)
    joint = int(np.argmax(beyond))
    if beyond[joint] <= _SLACK:
        return []
    return [
        f"{robot.joint_names[joint]} goes from {low[joint]:.4g} to {high[joint]:.4g} rad, which {robot.model.name} "
        f"cannot: [{robot.lower[joint]:.4g}, {robot.upper[joint]:.4g}] rad; another robot's bag (--robot), or other "
        "zeros (--zero)?"
    ]


def _track(path: Path, series: JointSeries, notes: list[str]) -> Track:
    track, resets = Track.of(series)
    if resets:
        notes.append(f"the time of {series.topic} goes back {resets} times; shown is what comes after the last one")
    if len(track.stamp_ns) < 2:
        last = f", all at {track.begin_ns / NANOSECONDS:.9f} s" if len(track.stamp_ns) else ""
        raise BagError(
            f"{plain(path)}: {series.topic}: {len(series.stamp_ns)} messages that can be shown{last}; accepted: "
            "increasing stamps, or --record-time"
        )
    return track
