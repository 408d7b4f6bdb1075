"""Bags of all kinds, opened to be looked at, and played on the page in a real browser."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import NamedTuple

import numpy as np
import pytest
from bag_making import joint_state, write_ros2
from browser import BrowserPage, served
from pinocchio_chain import tip_place, tip_pose
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.interpolate import interp1d

from rx90_common.bags import decoding
from rx90_common.bags.comparison import compare_bags
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.recorded import START, ParameterChange, time_shift
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError, Rx90Error
from rx90_common.description.robot_files import RobotFiles
from rx90_controller.lines.task import load_task
from rx90_emulator.cli.frame import run
from rx90_emulator.identification.options import MeasuredLayout
from rx90_emulator.loop.line import path_accuracy
from rx90_emulator.loop.setup import Setup
from rx90_emulator.view import scene
from rx90_emulator.view.page import Page
from rx90_emulator.view.player import BagPlayer, _difference_text, _recording_text, open_player
from rx90_emulator.view.recording import Recording, Track, difference, open_recording, path_errors, tip_path

REFERENCE = Path(__file__).resolve().parents[2] / "reference" / "reference_task"
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
MOTORS = [f"motor_{k}" for k in range(1, 7)]
STEP = 1_000_000


def opened(path: Path, setup: Setup, **options: object) -> Recording:
    """Return what is shown of a bag of the setup's robot."""
    return open_recording(path, setup.robot, RobotFiles(), MeasuredLayout(**options))  # type: ignore[arg-type]


def positions(path: Path, topic: str) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps, ns, and positions of a topic as rosbags alone reads them."""
    stamps, found = [], []
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        for connection, _, raw in reader.messages(connections):
            message = reader.deserialize(raw, connection.msgtype)
            stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
            found.append(message.position)
    return np.array(stamps), np.array(found)


def track(stamps: np.ndarray, values: np.ndarray) -> tuple[Track, int]:
    """Return a track of positions, shape (n, k), and how often its time goes back."""
    return Track.of(JointSeries("/joint_states", JOINTS[: values.shape[1]], stamps.astype(np.int64), values))


def test_a_bag_of_the_suite_is_read_whole(shipped: Setup, monkeypatch: pytest.MonkeyPatch) -> None:
    """Joint angles, set-points and friction are those that rosbags reads, however the messages fall into blocks."""
    monkeypatch.setattr(decoding, "_BLOCK", 37)
    recording = opened(REFERENCE, shipped)
    assert recording.lacking == ()
    assert recording.reference is not None
    assert recording.friction is not None
    for track, topic in ((recording.arm, "/joint_states"), (recording.reference, "/rx90_controller/reference")):
        stamps, values = positions(REFERENCE, topic)
        np.testing.assert_array_equal(track.stamp_ns, stamps)
        np.testing.assert_array_equal(track.fields["position"], values)
    assert recording.friction.names == shipped.friction.names
    assert len(recording.friction.stamp_ns) == len(recording.arm.stamp_ns)


def test_the_path_error_of_a_bag_is_that_of_the_run(shipped: Setup, capsys: pytest.CaptureFixture[str]) -> None:
    """Across and along the reference line, and of the tool, the page has what `rx90_run` gives for the same states.

    `rx90_bag compare --path-error` says the same in words.
    """
    recording = opened(REFERENCE, shipped)
    errors = path_errors(recording.arm, recording.reference, shipped.robot)
    assert errors is not None
    times = recording.arm.stamp_ns * 1e-9
    run_ = path_accuracy(shipped.robot, load_task(), times, recording.arm.fields["position"])
    found = errors.distance
    error = found.fields["position"][:, 0]
    assert np.nanmax(error) == pytest.approx(run_.worst, rel=1e-6)
    assert found.worst() == [(np.nanmax(error), recording.arm.stamp_ns[np.nanargmax(error)])]
    for track, expected in ((errors.along, run_.worst_along_track), (errors.orientation, run_.worst_orientation)):
        assert np.nanmax(np.abs(track.fields["position"])) == pytest.approx(expected, rel=1e-5)
    assert run("rx90_bag", ["compare", str(REFERENCE), str(REFERENCE), "--path-error"]) == 0
    lines = capsys.readouterr().out.splitlines()[-2:]
    assert lines == [f"{REFERENCE}: {run_.words}"] * 2
    assert run("rx90_bag", ["compare", str(REFERENCE), str(REFERENCE), "--robot", "rx90b"]) == 2
    assert "--robot without --path-error" in capsys.readouterr().err


def test_joint_states_of_others(tmp_path: Path, shipped: Setup) -> None:
    """Joints are taken by name, whatever their order, namespace and company, and messages of a gripper are left out.

    Where stamps are all 0, the times of recording can be taken.
    """
    random = np.random.default_rng(2)
    values = random.normal(size=(20, 6))
    order = [*JOINTS[::-1], "rail"]
    messages = []
    for k in range(20):
        messages.append(("/cell/joint_states", k * STEP, joint_state(k * STEP, order, [*values[k, ::-1], 7.0])))
        messages.append(("/cell/joint_states", k * STEP, joint_state(k * STEP, ["finger"], [0.1])))
        messages.append(("/cell/sampled/joint_states", k * STEP, joint_state(k * STEP, JOINTS, [0.0] * 6)))
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped)
    np.testing.assert_array_equal(recording.arm.fields["position"], values)
    assert recording.lacking == ("velocity", "drive torque", "friction", "set-points")
    messages = [("/joint_states", 5 * k * STEP, joint_state(0, JOINTS, [0.1 * k] * 6)) for k in range(4)]
    recording = opened(write_ros2(tmp_path / "unstamped", messages), shipped, record_time=True)
    np.testing.assert_array_equal(recording.arm.stamp_ns, 5 * STEP * np.arange(4))


def test_motor_states_alone(tmp_path: Path, shipped: Setup) -> None:
    """Where a bag has the motors' states alone, joints are seen through the gears, motor 6 with joints 5 and 6."""
    random = np.random.default_rng(3)
    joints, torque, gear = random.normal(size=(5, 6)), random.normal(size=(5, 6)), shipped.drives.gear
    motors = gear * np.column_stack([joints[:, :5], joints[:, 4] + joints[:, 5]])
    messages = [
        ("/motor_states", k * STEP, joint_state(k * STEP, MOTORS, motors[k], motors[k], torque[k])) for k in range(5)
    ]
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped, zero=[0.0, 0.1, 0, 0, 0, 0])
    zero = np.array([0.0, 0.1, 0, 0, 0, 0])
    np.testing.assert_allclose(recording.arm.fields["position"], joints - zero, atol=1e-13)
    np.testing.assert_allclose(recording.arm.fields["velocity"], joints, atol=1e-13)
    # Power is the same on both sides.
    power = np.sum(motors * torque, axis=1)
    np.testing.assert_allclose(np.sum(joints * recording.arm.fields["effort"], axis=1), power, rtol=1e-12)


def _states(topic: str, names: list[str], stamps: range, value: float = 0.1) -> list[tuple[str, int, object]]:
    return [(topic, k, joint_state(stamp, names, [value] * len(names))) for k, stamp in enumerate(stamps)]


@pytest.mark.parametrize(
    ("messages", "options", "said"),
    [
        (_states("/joint_states", ["a", "b", "c", "d", "e", "f"], range(5)), {}, "is of a, b, c"),
        (_states("/joint_states", [f"a{k}" for k in range(7)], range(5)), {}, "every arm here has 6 joints"),
        (_states("/a/joint_states", JOINTS, range(3)) + _states("/b/joint_states", JOINTS, range(3)), {}, "--topic"),
        (_states("/tool", JOINTS, range(3)), {}, "neither joint_states nor motor_states; JointState topics"),
        (_states("/joint_states", JOINTS, range(3)), {"topic": "nothing"}, "no messages in /nothing"),
        (_states("/joint_states", JOINTS, range(0, 1)) * 3, {}, "--record-time"),
        ([("/joint_states", k, joint_state(k, JOINTS, (), [0.0] * 6)) for k in range(3)], {}, "carries no positions"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    tmp_path: Path, shipped: Setup, messages: list[tuple[str, int, object]], options: dict[str, object], said: str
) -> None:
    """Joints of other names, several arms, no times, options of another size: one line with what is accepted."""
    bag = write_ros2(tmp_path / "bag", messages)
    with pytest.raises(Rx90Error) as caught:
        opened(bag, shipped, **options)
    text = str(caught.value)
    assert said in text
    assert "\n" not in text
    assert "accepted" in text
    assert caught.value.exit_code == 2


def test_a_bag_of_another_robot_is_refused(tx40: Setup) -> None:
    """A bag that says of which robot it is is not shown with another's arm."""
    with pytest.raises(BagError, match=r"recorded of the robot 'rx90b'.*--robot"):
        open_recording(REFERENCE, tx40.robot, RobotFiles.named("tx40"), MeasuredLayout())


def test_what_is_odd_in_a_bag_is_told(tmp_path: Path, shipped: Setup) -> None:
    """Joints beyond their range, as another robot's, positions that are no numbers, and resets each make a note."""
    good = [(k, [0.1] * 6) for k in range(5)]
    odd = [(k, [0.1, 0.1, 3.0 * k, 0.1, 0.1, 0.1]) for k in range(4)]
    messages = [
        ("/joint_states", number, joint_state(k * STEP, JOINTS, values))
        for number, (k, values) in enumerate([*good, (5, [np.nan] * 6), *odd])
    ]
    recording = opened(write_ros2(tmp_path / "bag", messages), shipped)
    assert len(recording.arm.stamp_ns) == 4
    said = " ".join(recording.notes)
    assert "1 messages of /joint_states without finite positions" in said
    assert "goes back 1 times" in said
    assert "joint_3 goes from 0 to 9 rad, which rx90b cannot" in said


def test_states_between_samples_and_in_gaps() -> None:
    """A sample is given as it is, a time between two as on the line between them, and nothing in a gap or outside."""
    random = np.random.default_rng(1)
    stamps = np.array([0, 1, 2, 3, 4, 5, 9, 10, 11]) * STEP + 10**18  # of the wall clock; three are missing
    values = random.normal(size=(9, 2))
    found, resets = track(stamps, values)
    assert resets == 0
    np.testing.assert_array_equal(found.at("position", stamps), values)
    wanted = np.sort(random.integers(stamps[0] - 2 * STEP, stamps[-1] + 2 * STEP, 500))
    oracle = interp1d(
        (stamps - stamps[0]).astype(float), values, axis=0, bounds_error=False, fill_value=np.nan
    )((wanted - stamps[0]).astype(float))  # fmt: skip
    oracle[(wanted > stamps[5]) & (wanted < stamps[6])] = np.nan
    np.testing.assert_allclose(found.at("position", wanted), oracle, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found.gaps(), [[stamps[5], stamps[6]]])


def test_messages_out_of_order_repeated_and_after_a_reset() -> None:
    """Messages are put in order of time, repetitions count once, and after a reset what comes before it is left out."""
    before = np.arange(50) * STEP
    after = np.array([0, 1, 1, 1, 3, 2, 4, 5, 6, 7]) * STEP
    stamps = np.concatenate([before, after])
    found, resets = track(stamps, np.arange(60.0)[:, None])
    assert resets == 1
    np.testing.assert_array_equal(found.stamp_ns, np.arange(8) * STEP)
    np.testing.assert_array_equal(found.fields["position"][:, 0], [50, 51, 55, 54, 56, 57, 58, 59])


@pytest.mark.parametrize(("count", "buckets"), [(100_000, 40), (37, 40)])
def test_envelope_keeps_every_peak(count: int, buckets: int) -> None:
    """However few points a curve is drawn with, it passes through the extremes of all samples of each bucket."""
    random = np.random.default_rng(count)
    values = random.normal(size=(count, 2))
    values[count // 3, 0], values[count // 2, 1] = 50.0, -70.0
    found, _ = track(np.arange(count) * STEP, values)
    end = (count - 1) * STEP
    time, curve = found.envelope("position", 0, end, buckets)
    assert len(time) == 2 * buckets
    assert (np.diff(time) > 0).all()
    assert (curve[:, 0].max(), curve[:, 1].min()) == (50.0, -70.0)
    edges = [end * k // buckets for k in range(buckets + 1)]
    for k in range(buckets):
        inside = values[(np.arange(count) * STEP >= edges[k]) & (np.arange(count) * STEP < edges[k + 1])]
        pair = curve[2 * k : 2 * k + 2]
        assert edges[k] == time[2 * k]
        if len(inside):
            assert (pair.max(axis=0) >= inside.max(axis=0)).all()
            assert (pair.min(axis=0) <= inside.min(axis=0)).all()


def test_envelope_shows_a_gap_and_a_steep_line_as_they_are() -> None:
    """Where samples are missing a curve has nothing, and where it has more points than samples it is the line."""
    stamps = np.concatenate([np.arange(100), np.arange(200, 300)]) * STEP
    found, _ = track(stamps, 3e-9 * stamps[:, None].astype(float))
    time, curve = found.envelope("position", 0, 299 * STEP, 60)
    inside = (time > 105 * STEP) & (time < 195 * STEP)
    assert np.isnan(curve[inside]).all()
    assert inside.sum() > 30
    time, curve = found.envelope("position", 10 * STEP, 20 * STEP, 100)
    np.testing.assert_allclose(curve[:, 0], 3e-9 * time, rtol=0, atol=4e-9)


def test_time_of_a_playback(shipped: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time runs at the chosen speed while it plays, stops at the end or begins again, and stays within the record."""
    monkeypatch.setattr(scene, "drawn_shapes", lambda _: [])
    stamps = np.arange(0, 10_001, 10) * STEP
    states = JointSeries("/joint_states", JOINTS, stamps, motion(stamps * 1e-9))
    write_joint_states(tmp_path / "bag", [states])
    page = Page("test", port=0)
    play = BagPlayer(page, shipped.robot, [opened(tmp_path / "bag", shipped)])
    start = monotonic() + 10.0
    play.advance(start)
    assert play.time == 0.0
    play._toggle()
    play._speed.value = "0.5"
    play.advance(start + 4.0)
    assert play.time == pytest.approx(2.0)
    play.go_to(99.0)
    assert (play.time, play.playing) == (10.0, False)
    play._toggle()  # at its end: from the beginning
    assert (play.time, play.playing) == (0.0, True)
    play._speed.value = "10"
    play.advance(start + 14.0)
    assert (play.time, play.playing) == (10.0, False)
    play._toggle()
    play._loop.value = True
    play.advance(start + 16.3)
    assert play.time == pytest.approx(3.0)
    assert play.playing
    page.close()


def motion(time: np.ndarray) -> np.ndarray:
    """Return smooth joint angles, (n, 6) rad, at times in s."""
    return np.stack([0.4 * np.sin((0.5 + 0.3 * k) * time + k) for k in range(6)], axis=1)


def test_worst_differences_are_those_of_the_comparison(tmp_path: Path, shipped: Setup) -> None:
    """Per joint, value and time of the largest difference are those of `rx90_bag compare`; at the tip Pinocchio's."""
    random = np.random.default_rng(4)
    stamps = np.arange(300) * STEP
    values = [motion(stamps * 1e-9) + 1e-4 * random.normal(size=(300, 6)) for _ in range(2)]
    for name, value in zip("ab", values, strict=True):
        write_joint_states(tmp_path / name, [JointSeries("/joint_states", JOINTS, stamps, value)])
    first, second = (opened(tmp_path / name, shipped) for name in "ab")
    found = difference(first.arm, second.arm, shipped.robot.chain, (first.path, second.path))
    compared = compare_bags(tmp_path / "a", tmp_path / "b").topics[0].values
    for (worst, at_ns), value in zip(found.joints.worst(), compared, strict=True):
        assert (abs(worst), at_ns) == (value.maximum, value.at_ns)
    distances = [
        np.linalg.norm(tip_place(shipped.robot, b) - tip_place(shipped.robot, a)) for a, b in zip(*values, strict=True)
    ]
    np.testing.assert_allclose(found.tip.fields["position"][:, 0], distances, rtol=0, atol=1e-12)
    assert found.tip.worst()[0][1] == stamps[int(np.argmax(distances))]
    assert found.exact == 1.0


def test_bags_of_other_times_are_aligned(tmp_path: Path, shipped: Setup) -> None:
    """A run that was recorded later is the same once both begin together, and its changes come at their times."""
    stamps = np.arange(50) * STEP
    for name, later in (("a", 0), ("b", 7 * 10**9)):
        series = [
            JointSeries(topic, JOINTS, stamps + later, motion(stamps * 1e-9))
            for topic in ("/joint_states", "/friction_states", "/rx90_controller/reference")
        ]
        write_joint_states(tmp_path / name, series)
    first, second = (opened(tmp_path / name, shipped) for name in "ab")
    second = replace(second, changes=(ParameterChange("/rx90_controller", "servo.kp", "[1, 2]", 7_020_000_000),))
    shift = time_shift(START, first, second)
    assert shift == -7 * 10**9
    second = second.moved(shift)
    assert second.friction is not None
    assert second.reference is not None
    assert {track.begin_ns for track in (second.arm, second.friction, second.reference)} == {0}
    found = difference(first.arm, second.arm, shipped.robot.chain, (first.path, second.path))
    assert (found.tip.worst()[0][0], found.exact) == (0.0, 1.0)
    said = _recording_text(second, "arm", 0)
    assert r"| 0.020 | /rx90\_controller servo.kp | \[1, 2\] |" in said
    assert "/joint\\_states: 50, 1000 Hz" in said
    assert "-7.000000000 s" in _difference_text(found, ("a", "b"), 0, shift)[0]


def test_other_rates_and_gaps(shipped: Setup) -> None:
    """A recording of another rate is compared where both are, between its samples too, and not in its gaps."""
    first = track(np.arange(1000) * STEP, motion(np.arange(1000) * 1e-3))[0]
    stamps = np.concatenate([np.arange(100, 200), np.arange(220, 500)]) * 3_000_000 + 1
    second = track(stamps, motion(stamps * 1e-9) + 2e-3)[0]
    found = difference(first, second, shipped.robot.chain, (Path("a"), Path("b")))
    joints = found.joints.fields["position"]
    assert (found.joints.begin_ns, found.joints.end_ns) == (301 * STEP, 999 * STEP)
    inside = (found.joints.stamp_ns > stamps[99]) & (found.joints.stamp_ns < stamps[100])
    assert np.isnan(joints[inside]).all()
    np.testing.assert_allclose(joints[~inside], 2e-3, rtol=0, atol=2e-6)  # of lines between samples 3 ms apart
    assert found.exact == 0.0


@pytest.mark.parametrize("apart", [10_000, 999])
def test_disjoint_times_are_refused(shipped: Setup, apart: int) -> None:
    """Recordings without a time in common, or with one message alone in a gap, are refused with both spans."""
    stamps = np.arange(500)
    first = track(stamps * STEP, motion(stamps * 1e-3))[0]
    later = np.concatenate([[0], np.arange(apart, apart + 100)]) if apart == 999 else stamps + apart
    second = track(later * STEP + 1, motion(later * 1e-3))[0]
    with pytest.raises(BagError, match=r"a from 0\.000 to 0\.499 s and b from .* no time in common; accepted: --align"):
        difference(first, second, shipped.robot.chain, (Path("a"), Path("b")))


def test_path_error_is_the_distance_across_the_path(shipped: Setup, tmp_path: Path) -> None:
    """What a tip lags behind its set-points is no path error, moving or at rest; what is across it is Pinocchio's.

    Before the first motion nothing counts, nor later than 0.2 s after its end.
    """
    stamps = np.arange(600)
    time = stamps * 1e-3
    target = np.zeros((600, 6))
    target[:, 0] = 0.5 * np.clip(time, 0.05, 0.3)  # rest, an arc about the base, rest
    target[:, 1:] = [0.3, 1.2, 0.1, 0.4, 0.2]
    arm = target.copy()
    arm[:, 0] = np.minimum(arm[:, 0], 0.5 * np.clip(time - 0.002, 0.05, 0.298))  # 2 ms late, and never quite there
    for row in (20, 150, 350, 510):
        arm[row, 1] += 1e-3
    series = [
        JointSeries("/joint_states", JOINTS, stamps * STEP, arm),
        JointSeries("/rx90_controller/reference", JOINTS, stamps * STEP, target),
    ]
    write_joint_states(tmp_path / "bag", series)
    recording = opened(tmp_path / "bag", shipped)
    errors = path_errors(recording.arm, recording.reference, shipped.robot)
    assert errors is not None
    found = errors.distance
    error = found.fields["position"][:, 0]
    lag = np.linalg.norm(tip_place(shipped.robot, arm[100]) - tip_place(shipped.robot, target[100]))
    assert lag > 3e-4
    np.testing.assert_array_equal(np.isfinite(error), (stamps >= 50) & (stamps <= 500))
    assert np.nanmax(np.delete(error, [150, 350])) < lag**2  # of an arc with a radius of some 0.7 m
    for row in (150, 350):
        off = tip_place(shipped.robot, arm[row]) - tip_place(shipped.robot, target[row])
        tangent = np.cross([0.0, 0.0, 1.0], tip_place(shipped.robot, target[row]))
        across = off - (off @ tangent) * tangent / (tangent @ tangent)
        assert error[row] == pytest.approx(np.linalg.norm(across), rel=5e-3)
    points, largest = tip_path(recording.arm, found, shipped.robot.chain, 40)
    assert np.nanmax(largest) == np.nanmax(error)
    np.testing.assert_allclose(points[0], tip_place(shipped.robot, arm[0]), atol=1e-12)
    np.testing.assert_allclose(points[-1], tip_place(shipped.robot, arm[-1]), atol=1e-12)


CLOCK = 1_700_000_000 * 10**9  # of the wall clock
PIXEL = 1e-6  # m; positions go to the page as single precision
DISTANCES = """() => Object.values(window.__viserTestpoints.uplots).map(plot => plot.chart).find(
    chart => chart.root.querySelector('.u-title').textContent == 'distance of the tips [mm]'
    ).data.map(column => Array.from(column))"""
WORST = 350  # the message of the second bag that is farthest from that of the first one


class Played(NamedTuple):
    """Two bags' joint angles, rad, (1000, 6), and the page that plays them."""

    player: BagPlayer
    page: Page
    angles: tuple[np.ndarray, np.ndarray]


@pytest.fixture
def played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Played]:
    """Serve a page with two bags of two seconds; the second lacks 0.2 s and differs most at one message.

    The arms' frames are there without their shapes, which take Chromium long to draw without a graphics card.
    """
    monkeypatch.setattr(scene, "drawn_shapes", lambda _: [])
    stamps = CLOCK + np.arange(1000) * 2 * STEP
    first = motion(np.arange(1000) * 2e-3)
    second = first + 1e-3
    second[WORST] += 1e-3
    whole = [JointSeries("/joint_states", JOINTS, stamps, q, 2.0 * q, 100.0 * q) for q in (first, second)]
    bags = [tmp_path / "first", tmp_path / "second"]
    write_joint_states(bags[0], whole[:1])
    write_joint_states(bags[1], [whole[1].take(np.delete(np.arange(1000), np.arange(500, 600)))])
    page, player = open_player(lambda: Page("test", port=0), bags, RobotFiles(), MeasuredLayout(), 0)
    with served(page):
        yield Played(player, page, (first, second))


def scrub(shown: BrowserPage, time: str) -> None:
    """Type a time into the number beside the slider."""
    shown.page.locator("input[inputmode=decimal]").fill(time)


def test_scrubbing_shows_what_was_recorded(
    played: Played, open_page: Callable[..., BrowserPage], shipped: Setup
) -> None:
    """At a time that is chosen on the page both arms' tips are where Pinocchio has them for the recorded angles.

    In a gap an arm is not drawn, the button leads to the worst difference, curves keep its peak, and playing ends.
    """
    shown = open_page(played.page.address, (500, 400), pictures="few")
    player = played.player

    def wait_for_both_at(message: int) -> list[np.ndarray]:
        poses = [tip_pose(shipped.robot, angles[message]) for angles in played.angles]
        for drawn, placed in zip(player.arms, poses, strict=True):
            shown.wait_until(lambda: bool(np.allclose(shown.pose(drawn.tip), placed, atol=PIXEL)), f"message {message}")  # noqa: B023
        return [placed[:3, 3] for placed in poses]

    scrub(shown, "1.456")
    wait_for_both_at(728)
    scrub(shown, "1.1")
    shown.wait_until(lambda: "no states of second" in shown.text(), "word of the gap")
    ghost = "() => window.__viserMutable.nodeRefFromName['/ghost'].visible"
    shown.wait_until(lambda: not shown.page.evaluate(ghost), "the ghost to go")
    shown.page.get_by_text("Jump to the worst difference").dispatch_event("click")
    tips = wait_for_both_at(WORST)
    shown.page.get_by_label("ghost", exact=True).dispatch_event("click")
    shown.wait_until(lambda: not shown.page.evaluate(ghost), "the ghost to be hidden")
    shown.page.get_by_label("ghost", exact=True).dispatch_event("click")
    shown.wait_until(lambda: bool(shown.page.evaluate(ghost)), "the ghost to come")
    worst = 1e3 * np.linalg.norm(tips[1] - tips[0])
    text = re.compile(r"tips at most ([\d.]+) mm apart, at ([\d.]+) s")
    shown.wait_until(lambda: bool(text.search(shown.text())), "word of the worst difference")
    said = text.search(shown.text())
    assert said
    assert (float(said[1]), said[2]) == (pytest.approx(worst, rel=1e-3), "0.700")
    _, _, *parts, line, _ = shown.page.evaluate(DISTANCES)
    assert np.nanmax(np.array(parts, dtype=float)) == pytest.approx(worst, rel=1e-9)
    assert np.nanmax(np.array(line, dtype=float)) == pytest.approx(worst, rel=1e-9)
    assert len(parts) == 2  # before the gap and after it
    shown.page.get_by_text("Play", exact=True).dispatch_event("click")
    wait_for_both_at(999)
    shown.page.get_by_text("Play", exact=True).wait_for()
    assert (shown.complaints, shown.foreign_requests) == ([], [])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["first", "later"], "no time in common; accepted: --align"),
        (["first"] * 3, "3 bags; accepted: one, or two"),
        (["first", "--align", "start"], "--align start with 1 bags; accepted: two bags"),
        (["first", "first", "--align", "noon"], "--align is 'noon'; accepted: start, trajectory, or a time"),
        (["--record-time"], "--record-time without a bag"),
        (["first", "--demo"], "--demo with a bag"),
        (["first", "--nice", "0"], "--nice with a bag"),
        (["first", "--task", "line.yaml"], "--task with a bag"),
        (["nothing"], "nothing: no such bag"),
        (["first", "--robot", "tx40"], "recorded of the robot 'rx90b', not of"),
    ],
)
def test_bags_that_cannot_be_played_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    """What cannot be played is one line with what is accepted, and exit code 2, before any page is served."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "first").symlink_to(REFERENCE)
    if "later" in words:
        states = [joint_state(CLOCK + k * STEP, JOINTS, [0.1] * 6) for k in range(5)]
        write_ros2(tmp_path / "later", [("/joint_states", k, state) for k, state in enumerate(states)])
    assert run("rx90_view", [*words, "--port", "0"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.splitlines()) == 1
    assert said in err
    assert err.startswith("rx90_view: ")
