"""A recorded bag as the viewer shows it: series at any time, the difference of two, path errors, what is lacking."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.mapping import is_table
from rx90_common.bags.reading import BagReader, BagTopic
from rx90_common.bags.recorded import ParameterChange, changes_of, check_robot
from rx90_common.bags.topics import FIELDS, absolute, reports_changes
from rx90_common.base.arrays import Array, least_and_largest
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.description.chain import RigidChain
from rx90_common.description.drives import load_drives
from rx90_common.description.kinematics import tip_position
from rx90_common.description.robot import RobotModel
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.topics import MOTOR_STATES, SAMPLED
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.identification.robot import JOINT_STATES, arm_layout, with_signals
from rx90_emulator.loop.line import PathAccuracy, followed_accuracy

TIP, PATH_ERROR = "tip", "path error"
_GAP = 3.5  # times the median interval: fewer than three messages that are missing are interpolated
_BLOCK = 1 << 14  # samples; for all of them at once some steps would take too much memory


def since(time_ns: int, origin_ns: int) -> float:
    """Return how long after the origin a stamp is, s: the time that the page shows."""
    return (time_ns - origin_ns) / NANOSECONDS


def seconds(time_ns: int) -> str:
    """Return a time in s, to the ms."""
    return f"{since(time_ns, 0):.3f}"


@dataclass(frozen=True, eq=False)
class Track(JointSeries):
    """A series whose stamps increase, and what is known of the times between them.

    Attributes:
        gap_ns: an interval longer than this is a gap, in which nothing is known.
    """

    gap_ns: int = 0

    @classmethod
    def of(cls, series: JointSeries) -> tuple[Track, int]:
        """Return a series sorted by time, and how often its time jumped back, as after a reset of the simulation.

        Of messages with one stamp the first counts. Where time goes back by more than a gap, two runs would be mixed:
        what comes after the last such place is returned.
        """
        stamps = series.stamp_ns
        steps = np.diff(stamps)
        forward = steps[steps > 0]
        gap_ns = int(_GAP * np.median(forward)) if len(forward) else 0
        back = np.flatnonzero(steps < -gap_ns)
        begin = int(back[-1]) + 1 if len(back) else 0
        if not (steps[begin:] > 0).all():
            series = series.take(begin + np.unique(stamps[begin:], return_index=True)[1])
        elif begin:
            series = series.take(slice(begin, None))
        return cls(**vars(series), gap_ns=gap_ns), len(back)

    @property
    def begin_ns(self) -> int:
        """Return the first time."""
        return int(self.stamp_ns[0])

    @property
    def end_ns(self) -> int:
        """Return the last time."""
        return int(self.stamp_ns[-1])

    def gaps(self) -> NDArray[np.int64]:
        """Return the last time before and the first one after each gap, shape (m, 2)."""
        rows = np.flatnonzero(np.diff(self.stamp_ns) > self.gap_ns)
        return np.stack([self.stamp_ns[rows], self.stamp_ns[rows + 1]], axis=1)

    def at(self, field: str, time_ns: Int64Array) -> Array:
        """Return a field at any times, shape (m, k): a sample as it is, between two samples the line between them.

        NaN in gaps, before the first sample and after the last one.
        """
        wanted = np.asarray(time_ns, dtype=np.int64)
        values, last = self.fields[field], len(self.stamp_ns) - 1
        before = np.clip(np.searchsorted(self.stamp_ns, wanted, side="right") - 1, 0, last)
        after = np.minimum(before + 1, last)
        later, step = wanted - self.stamp_ns[before], self.stamp_ns[after] - self.stamp_ns[before]
        between = (later > 0) & (later < step) & (step <= self.gap_ns)
        share = np.where(between, later / np.maximum(step, 1), 0.0)[:, None]
        low = values[before]
        with np.errstate(invalid="ignore"):
            found = np.where(share > 0.0, low + share * (values[after] - low), low)
        found[~(between | (later == 0))] = np.nan
        return found

    def envelope(self, field: str, begin_ns: int, end_ns: int, buckets: int) -> tuple[Int64Array, Array]:
        """Return at most 2 `buckets` points of a curve in which every peak stands, however many samples there are.

        The time is cut into equal buckets; each gives its least and its largest value, samples inside it and the line
        at its edges alike, at its beginning and its end. A sample therefore stands up to one bucket beside its time.

        Args:
            field: of the values.
            begin_ns: of the curve.
            end_ns: of the curve, after its beginning.
            buckets: how many, at least 1.

        Returns:
            Times, shape (2 m,), and values, shape (2 m, k), NaN where nothing is known; m is `buckets`, or less where
            buckets would be shorter than 2 ns.
        """
        count = max(1, min(buckets, (end_ns - begin_ns) // 2))
        edges = begin_ns + ((end_ns - begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
        edge_values = self.at(field, edges)
        rising = edge_values[1:] >= edge_values[:-1]
        least, largest = np.fmin(edge_values[1:], edge_values[:-1]), np.fmax(edge_values[1:], edge_values[:-1])
        rows = np.searchsorted(self.stamp_ns, edges)
        filled = np.flatnonzero(np.diff(rows))
        if len(filled):
            lowest, highest = least_and_largest(self.fields[field][: rows[-1]], rows[filled])
            least[filled], largest[filled] = np.fmin(least[filled], lowest), np.fmax(largest[filled], highest)
        time = np.stack([edges[:-1], edges[1:] - 1], axis=1).reshape(-1)
        ends = [np.where(rising, least, largest), np.where(rising, largest, least)]
        return time, np.stack(ends, axis=1).reshape(2 * count, -1)

    def worst(self) -> list[tuple[float, int]]:
        """Return the largest absolute position of each column, with its sign, and its stamp, ns; NaN does not count."""
        values = self.fields["position"]
        rows = np.nanargmax(np.abs(values), axis=0).tolist()
        return [(float(values[row, column]), int(self.stamp_ns[row])) for column, row in enumerate(rows)]


class Difference(NamedTuple):
    """The second recording less the first, at the stamps of the first that both cover.

    Attributes:
        joints: position, rad, of each joint; nothing in gaps of the second.
        tip: position, the distance of both tips, m, under the name TIP.
        exact: share of the stamps at which the second has a sample of its own; at the others the line between two is
            taken.
    """

    joints: Track
    tip: Track
    exact: float


def difference(first: Track, second: Track, chain: RigidChain, paths: tuple[Path, Path]) -> Difference:
    """Compare the positions of two tracks of one arm; the second's times are already moved to the first's.

    Raises:
        BagError: if they have no time in common outside of gaps.
    """
    begin, end = max(first.begin_ns, second.begin_ns), min(first.end_ns, second.end_ns)
    low, high = np.searchsorted(first.stamp_ns, begin), np.searchsorted(first.stamp_ns, end, side="right")
    stamps, own = first.stamp_ns[low:high], first.fields["position"][low:high]
    joints, tip = np.empty((len(stamps), len(first.names))), np.empty((len(stamps), 1))
    for rows in _blocks(len(stamps)):
        other = second.at("position", stamps[rows])
        joints[rows] = other - own[rows]
        tip[rows, 0] = np.linalg.norm(tip_position(chain, other) - tip_position(chain, own[rows]), axis=1)
    known = np.isfinite(tip[:, 0])
    if not known.any():
        spans = " and ".join(
            f"{plain(path)} from {seconds(track.begin_ns)} to {seconds(track.end_ns)} s"
            for path, track in zip(paths, (first, second), strict=True)
        )
        raise BagError(f"{spans} have no time in common; accepted: --align start, trajectory, or a time in s")
    if not known.all():
        stamps, joints, tip = stamps[known], joints[known], tip[known]
    exact = float(np.isin(stamps, second.stamp_ns, assume_unique=True).mean())
    of_joints = Track(first.topic, first.names, stamps, joints, gap_ns=first.gap_ns)
    return Difference(of_joints, Track(TIP, (TIP,), stamps, tip, gap_ns=first.gap_ns), exact)


class PathErrors(NamedTuple):
    """Path error of a recording at the arm's stamps, NaN where none counts; position is the value, one column each.

    Attributes:
        accuracy: all of it, at the stamps that count.
        distance: from the path, m, under the name PATH_ERROR.
        along: how far ahead of its set-point the tip is along the path, m.
        orientation: angle between the tool and what the set-points ask for in that place, rad.
    """

    accuracy: PathAccuracy
    distance: Track
    along: Track
    orientation: Track


def path_errors(arm: Track, reference: Track | None, robot: RobotModel) -> PathErrors | None:
    """Return the path error by the set-points, as `followed_accuracy` says; None without set-points.

    In gaps of the set-points nothing counts.
    """
    if reference is None:
        return None
    known, found = np.empty(len(arm.stamp_ns), dtype=np.bool_), np.full((3, len(arm.stamp_ns)), np.nan)
    for rows in _blocks(len(arm.stamp_ns)):
        known[rows] = np.isfinite(reference.at("position", arm.stamp_ns[rows])).all(axis=1)
    finite = np.isfinite(reference.fields["position"]).all(axis=1)
    times, when = ((stamp - arm.begin_ns) / NANOSECONDS for stamp in (arm.stamp_ns[known], reference.stamp_ns[finite]))
    of = followed_accuracy(robot, times, arm.fields["position"][known], when, reference.fields["position"][finite])
    counts = np.flatnonzero(known)[np.searchsorted(times, of.times)]
    found[:, counts] = of.perpendicular, of.along_track, of.orientation
    names = (PATH_ERROR, "along the path", "orientation")
    return PathErrors(of, *(Track(name, (name,), arm.stamp_ns, values[:, None], gap_ns=arm.gap_ns)
                            for name, values in zip(names, found, strict=True)))  # fmt: skip


def tip_path(arm: Track, error: Track | None, chain: RigidChain, pieces: int) -> tuple[Array, Array]:
    """Return the way of the tip, (m, 3) m, NaN in gaps, and the largest path error of each piece, (m - 1,) m or NaN.

    The pieces are of equal time, `pieces` at most.
    """
    count = max(1, min(pieces, len(arm.stamp_ns) - 1))
    edges = arm.begin_ns + ((arm.end_ns - arm.begin_ns) * np.arange(count + 1, dtype=np.int64)) // count
    points = tip_position(chain, arm.at("position", edges))
    if error is None:
        return points, np.full(count, np.nan)
    _, values = error.envelope("position", arm.begin_ns, arm.end_ns, count)
    return points, np.asarray(np.fmax(values[0::2, 0], values[1::2, 0]))


def _blocks(count: int) -> Iterator[slice]:
    return (slice(start, start + _BLOCK) for start in range(0, count, _BLOCK))


_FRICTION, _REFERENCE = "friction_states", "reference"
_SHOWN_FIELDS = {_FRICTION: ("effort",), _REFERENCE: ("position",)}  # beside the arm's own states
_STOP_DEFLECTION = 0.05  # rad beyond a joint's range: end stops give way
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
        layout = arm_layout(arm.name, robot.joint_names, options, lambda: load_drives(files.drives), mapping)
        beside = {name: topic for name in _SHOWN_FIELDS if (topic := _topic_beside(arm, bag.topics, name)) is not None}
        fields = {arm: FIELDS, **{topic: _SHOWN_FIELDS[name] for name, topic in beside.items()}}
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
    friction, reference = (series[beside[name]] if name in beside else [] for name in _SHOWN_FIELDS)
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
    telling = [topic for topic in bag.topics if reports_changes(topic.name, topic.msgtype)]
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
    if beyond[joint] <= _STOP_DEFLECTION:
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
