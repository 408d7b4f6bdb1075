"""A bag as the viewer shows it: the arm's states, friction, set-points, changes of parameters, and what is lacking."""

from __future__ import annotations

import sys
from collections.abc import Sequence
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
from rx90_emulator.identification.robot import arm_layout, with_signals
from rx90_emulator.view.track import Track

_FRICTION, _REFERENCE = "friction_states", "reference"
_SHOWN = {_FRICTION: ("effort",), _REFERENCE: ("position",)}
"""What is read beside the arm's own states: friction torque, and set-points."""
_SLACK = 0.05  # rad beyond a joint's range: end stops give way
_STEP = 8192  # messages between two looks at the progress bar
_JOINT_STATES = "joint_states"
_ONCE_MORE = f"/{SAMPLED}/{_JOINT_STATES}"
Wanted = tuple[Sequence[str], Sequence[str] | None]
"""Fields, where the messages carry them, and joints of a topic; None for those of its first message."""


def _topic(bag: BagReader, wanted: str | None) -> BagTopic:
    held = [topic for topic in bag.topics if topic.is_joint_state and topic.count]
    there = listed(topic.name for topic in held) or "none"
    if wanted is not None:
        fitting = [topic for topic in held if topic.name == absolute(wanted)]
    else:
        fitting = [topic for topic in held if topic.name.rpartition("/")[2] == _JOINT_STATES]
        # Of those recorded with what the simulation publishes once more for who looks on.
        fitting = [topic for topic in fitting if not topic.name.endswith(_ONCE_MORE)] or fitting
        fitting = fitting or [topic for topic in held if topic.name.rpartition("/")[2] == MOTOR_STATES]
        fitting = fitting or held * (is_table(bag.path) and len(held) == 1)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        arms = listed(topic.name for topic in fitting)
        raise BagError(f"{plain(bag.path)}: holds the states of several arms, {arms}; accepted: --topic with one")
    what = f"no messages in {plain(absolute(wanted))}" if wanted else f"neither {_JOINT_STATES} nor {MOTOR_STATES}"
    raise BagError(f"{plain(bag.path)}: {what}; JointState topics with messages: {there}; accepted: --topic with one")


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
    topics: tuple[BagTopic, ...]
    arm: Track
    friction: Track | None
    reference: Track | None
    changes: tuple[ParameterChange, ...]
    notes: tuple[str, ...]

    @property
    def begin_ns(self) -> int:
        """Return the first stamp of the arm, ns."""
        return self.arm.begin_ns

    @property
    def lacking(self) -> tuple[str, ...]:
        """Return in words what a whole bag of the suite has and this one has not."""
        fields = {"velocity": "velocity", "effort": "drive torque"}
        absent = [text for field, text in fields.items() if field not in self.arm.values]
        absent += ["friction"] * (self.friction is None) + ["set-points"] * (self.reference is None)
        return tuple(absent)

    def moved(self, by_ns: int) -> Recording:
        """Return the same recording, later by `by_ns`."""
        if not by_ns:
            return self
        tracks = [track and track.moved(by_ns) for track in (self.friction, self.reference)]
        changes = tuple(replace(change, stamp_ns=change.stamp_ns + by_ns) for change in self.changes)
        return replace(
            self, arm=self.arm.moved(by_ns), friction=tracks[0], reference=tracks[1], changes=changes
        )  # fmt: skip


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
        topic = _topic(bag, options.topic)
        layout = arm_layout(topic.name, robot.joint_names, options, lambda: load_drives(files.drives).gear, mapping)
        topics = bag.topics
        arm = next(topic for topic in topics if topic.name == layout.topic and topic.is_joint_state)
        wanted: dict[BagTopic, Wanted] = {arm: (FIELDS, layout.messages)}
        for name, fields in _SHOWN.items():
            shown = _beside(arm, topics, name)
            if shown is not None:
                wanted[shown] = fields, robot.joint_names if name == _REFERENCE else None
        changes, series = _read(bag, wanted, record_time=layout.record_time)
        notes = [*bag.notes]
        kind = " of ".join(part for part in (bag.storage, bag.compression) if part)
    states = series.pop(arm)
    if states is None or states.position is None:
        raise BagError(f"{plain(path)}: {layout.topic} carries no positions; accepted: a bag with joint angles")
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(states.position).all(axis=1))
    if not finite.all():
        notes.append(f"{len(finite) - finite.sum():,} messages of {layout.topic} without finite positions are left out")
        states = states.take(finite)
    unit = states.effort_unit if layout.torque_constant is None else ""
    sides: dict[str, Any] = layout.joint_side(states.fields)
    track = _track(path, replace(states, names=layout.names, effort_unit=unit, **sides), notes)
    notes += _beyond_range(track, robot)
    others = {topic.name.rpartition("/")[2]: _track(path, one, notes) for topic, one in series.items() if one}
    return Recording(
        path, kind, tuple(topics), track, others.get(_FRICTION), others.get(_REFERENCE), tuple(changes), tuple(notes)
    )


def _beside(arm: BagTopic, topics: Sequence[BagTopic], name: str) -> BagTopic | None:
    """Return the JointState topic of a name in the namespace of the arm's, or below it."""
    namespace = arm.name.rpartition("/")[0] + "/"
    found = [
        topic
        for topic in topics
        if topic.is_joint_state and topic.count and topic.name.rpartition("/")[2] == name
        if topic.name.startswith(namespace) and topic != arm
    ]
    return min(found, key=lambda topic: topic.name.count("/")) if found else None


def _read(
    bag: BagReader, wanted: dict[BagTopic, Wanted], *, record_time: bool
) -> tuple[list[ParameterChange], dict[BagTopic, JointSeries | None]]:
    """Return the changes of parameters, and of each topic the wanted fields of the wanted joints."""
    builders = {topic: bag.series_builder(topic, fields) for topic, (fields, _) in wanted.items()}
    telling = [topic for topic in bag.topics if tells_changes(topic.name, topic.msgtype)]
    changes: list[ParameterChange] = []
    total = sum(topic.count for topic in (*wanted, *telling))
    try:
        with tqdm(total=total, unit=" messages", unit_scale=True, delay=0.5, disable=None, file=sys.stderr, leave=False,
                  desc=f"reading {plain(bag.path.name, 40)}") as bar:  # fmt: skip
            for number, (topic, log_ns, data) in enumerate(bag.messages([*wanted, *telling]), 1):
                builder = builders.get(topic)
                if builder is None:
                    changes += changes_of(bag.deserialize(topic, data))
                else:
                    builder.add(data, log_ns if record_time else None)
                if number % _STEP == 0:
                    bar.update(_STEP)
        return changes, {topic: _series_of(builders.pop(topic).build(), wanted[topic][1]) for topic in wanted}
    except BagError as error:
        text, name = str(error), plain(bag.path)
        raise error if text.startswith(name) else BagError(f"{name}: {text}") from error


def _series_of(found: Sequence[JointSeries], names: Sequence[str] | None) -> JointSeries | None:
    """Return the first series that has these joints (None: any), in their order; None without messages."""
    for series in found:
        if names is None or series.names == tuple(names):
            return series
        if set(names) <= set(series.names):
            return series.select(names)
    if not found or names is None:
        return None
    other = f"; every arm here has {len(names)} joints" * (len(found[-1].names) != len(names))
    raise BagError(
        f"{found[-1].topic} is of {listed(found[-1].names)}; accepted: a bag with {listed(names)}, --robot with the "
        f"bag's, or --names with what it calls these joints{other}"
    )


def _beyond_range(track: Track, robot: RobotModel) -> list[str]:
    """Return a line for joints that go where this robot cannot: many bags do not say whose they are."""
    values = track.values["position"]
    low, high = values.min(axis=0), values.max(axis=0)
    beyond = np.maximum(robot.lower - low, high - robot.upper)
    joint = int(np.argmax(beyond))
    if beyond[joint] <= _SLACK:
        return []
    span = f"from {low[joint]:.4g} to {high[joint]:.4g} rad"
    accepted = f"[{robot.lower[joint]:.4g}, {robot.upper[joint]:.4g}]"
    return [
        f"{robot.joint_names[joint]} goes {span}, which {robot.model.name} cannot: {accepted} rad; another robot's bag "
        "(--robot), or other zeros (--zero)?"
    ]


def _track(path: Path, series: JointSeries, notes: list[str]) -> Track:
    track, resets = Track.of(series)
    if resets:
        notes.append(f"the time of {series.topic} goes back {resets} times; shown is what comes after the last one")
    if len(track.time_ns) < 2:
        last = f", all at {track.begin_ns / NANOSECONDS:.9f} s" if len(track.time_ns) else ""
        raise BagError(
            f"{plain(path)}: {series.topic}: {len(series.stamp_ns)} messages that can be shown{last}; accepted: "
            "increasing stamps, or --record-time"
        )
    return track
