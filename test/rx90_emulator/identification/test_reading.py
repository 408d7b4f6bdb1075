"""Bags of this project and of other robots become joint-side records, or one line of refusal."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_making import ROS1, joint_state, write_ros1, write_ros2

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.base.errors import BagError, IdentificationError
from rx90_emulator.identification.records import read_record
from rx90_emulator.identification.robot import BagLayout, arm_layout

NAMES = ("a", "b")
PERIOD_NS = 2_000_000


def motion(count: int = 1000) -> tuple[Array, Array, Array]:
    t = np.arange(count) * PERIOD_NS * 1e-9
    phase = np.column_stack([2.0 * t, 3.0 * t])
    return 0.5 * np.sin(phase), np.array([1.0, 1.5]) * np.cos(phase), np.column_stack([5 * np.cos(t), 3 * np.sin(t)])


def messages(
    position: Array, velocity: Array | None, effort: Array | None, names: tuple[str, ...] = NAMES, **store: Any
) -> list[tuple[str, int, Any]]:
    rows = []
    for k, q in enumerate(position):
        stamp = 10**9 + k * PERIOD_NS
        v, e = (() if values is None else values[k] for values in (velocity, effort))
        rows.append(("/arm", stamp, joint_state(stamp, list(names), q, v, e, **store)))
    return rows


LAYOUT = arm_layout("arm", NAMES)


@pytest.mark.parametrize("ros", [1, 2])
def test_a_foreign_robots_bag_is_read(tmp_path: Path, ros: int) -> None:
    """A JointState bag of ROS 1 or ROS 2 with more joints in another order gives those asked for."""
    q, v, e = motion()
    swapped = [np.column_stack([values[:, 1], 7.0 + values[:, 0], values[:, 0]]) for values in (q, v, e)]
    names = ("b", "gripper", "a")
    if ros == 1:
        path = write_ros1(tmp_path / "arm.bag", messages(*swapped, names, store=ROS1))
    else:
        path = write_ros2(tmp_path / "arm", messages(*swapped, names))
    record = read_record(path, LAYOUT)
    assert record.names == NAMES
    for found, wanted in ((record.position, q), (record.velocity, v), (record.torque, e)):
        assert np.array_equal(found, wanted)
    assert record.time[0] == pytest.approx(1.0)
    assert record.outliers == 0


@pytest.mark.parametrize("given", [None, "quantised"])
def test_velocities_come_from_positions_where_messages_have_none(tmp_path: Path, given: str | None) -> None:
    """Without velocities, or with those of a coarse tachometer, the record's are right to 1 % of the largest."""
    q, v, e = motion()
    coarse = None if given is None else np.round(v, 1)
    record = read_record(write_ros2(tmp_path / "arm", messages(q, coarse, e)), LAYOUT)
    assert np.abs(record.velocity - v)[20:-20].max() < 0.015


def test_wrapped_positions_are_continued_and_named(tmp_path: Path) -> None:
    """Jumps by two pi are taken out, and the joint, the sample and its time are said."""
    q, v, e = motion()
    wrapped = q.copy()
    wrapped[400:700, 1] -= 2.0 * np.pi
    record = read_record(write_ros2(tmp_path / "arm", messages(wrapped, v, e)), LAYOUT)
    assert np.allclose(record.position, q)
    (alarm,) = record.alarms
    assert "the position of 'b' jumps by 2 pi at sample 400, 0.8 s after the first, and 2 times in all" in alarm


def test_repeated_positions_are_thinned_and_named(tmp_path: Path) -> None:
    """Of positions that change in every ninth sample the new ones stay; coarse and slow ones are left as they are."""
    q, _, e = motion()
    held = np.repeat(q[::9], 9, axis=0)[: len(q)]
    record = read_record(write_ros2(tmp_path / "held", messages(held, None, e)), LAYOUT)
    assert np.allclose(record.position, q[::9])
    (alarm,) = record.alarms
    assert "the positions change 56.1 times a second, in 501 samples" in alarm
    coarse = read_record(write_ros2(tmp_path / "coarse", messages(np.round(q, 2), None, e)), LAYOUT)
    assert coarse.alarms == ()
    assert len(coarse.time) == len(q)


@pytest.mark.parametrize(
    ("factor", "looks"), [(57.3, "it looks like deg/s"), (0.01745, "the position looks like deg"), (9.55, "rpm")]
)
def test_units_that_contradict_each_other_are_named(tmp_path: Path, factor: float, looks: str) -> None:
    """A velocity that is no change of the position is refused with the unit that it looks like."""
    q, v, e = motion()
    assert looks in refused(write_ros2(tmp_path / "arm", messages(q, factor * v, e)))


def test_lost_messages_and_spikes_are_counted(tmp_path: Path) -> None:
    """A NaN, a spike and a repeated stamp are counted and leave the rest as it is, as missing messages do."""
    q, v, e = motion()
    e[100, 0], e[200, 1] = np.nan, 80.0
    rows = messages(q, v, e)
    rows[300] = (rows[300][0], rows[300][1], rows[299][2])
    record = read_record(write_ros2(tmp_path / "arm", rows[:400] + rows[405:]), LAYOUT)
    assert record.outliers == 3
    assert len(record.time) == 1000 - 5 - 3
    assert np.abs(record.torque).max() <= 5.0


def test_a_lower_rate_gives_means(tmp_path: Path) -> None:
    """At a fifth of the rate each sample is the mean of five, its time included; the digest is the file's SHA-256."""
    q, v, e = motion()
    path = write_ros2(tmp_path / "arm", messages(q, v, e))
    record = read_record(path, LAYOUT, rate=100.0)
    assert len(record.time) == 200
    assert np.allclose(record.torque[3], e[15:20].mean(axis=0))
    assert record.time[3] == pytest.approx(1.0 + 17 * PERIOD_NS * 1e-9)
    (file,) = path.glob("*.mcap")
    assert record.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


def test_both_topics_of_this_project_agree(tx40: rx.Setup, tmp_path: Path) -> None:
    """motor_states, motor 4 turned round, give what joint_states hold, within the encoders' counts."""
    names, zero = tx40.robot.joint_names, np.zeros(6)
    goal = np.array([0.1, 0.4, 1.0, -0.2, 0.6, 0.3])
    points = rx.TrajectoryPoints.create(names, names, [0.5], [goal], [zero], [zero])
    result = rx.simulate(tx40, points, goal - 0.1, 0.7, record_fast=True)
    rx.write_bag(result, tmp_path / "run")
    motors, joints = (
        read_record(tmp_path / "run", arm_layout(topic, names, own_drives=lambda: tx40.drives))
        for topic in ("motor_states", "joint_states")
    )
    same = np.isin(motors.time, joints.time)
    assert same.sum() > 600
    rows = np.isin(joints.time, motors.time)
    assert np.abs(motors.position[same] - joints.position[rows]).max() < 1e-5
    assert np.abs(motors.torque[same] - joints.torque[rows]).max() < 1e-9


def refused(path: Path, layout: BagLayout = LAYOUT) -> str:
    with pytest.raises((BagError, IdentificationError)) as caught:
        read_record(path, layout)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_bad_bags_are_refused_in_one_line(tmp_path: Path) -> None:
    """Wrong names or velocities, no or zero effort, no position, and stamps that go back are each refused."""
    q, v, e = motion(200)

    def bag(name: str, rows: list[tuple[str, int, Any]]) -> Path:
        return write_ros2(tmp_path / name, rows)

    good, sized = messages(q, v, e), e / np.abs(e).max()
    assert "carries no effort; accepted" in refused(bag("effort", messages(q, v, None)))
    assert "effort 0 throughout" in refused(bag("zero", messages(q, v, 0.0 * e)))
    assert "carries no effort" in refused(bag("nan", messages(q, v, np.nan * e)))
    assert "the largest effort is 3e+200; accepted: 1e-09 to" in refused(bag("huge", messages(q, v, sized * 3e200)))
    assert "carries no position" in refused(bag("position", messages(np.zeros((200, 0)), v, e)))
    assert "velocity of 'a' is -1 times the change of its position" in refused(bag("v", messages(q, -v, e)))
    back = [(topic, 10**9 + k, message) for k, (topic, _, message) in enumerate([*good[25:], *good[:25]])]
    assert "stamp goes back from 1.398000000 s to 1.000000000 s" in refused(bag("back", back))


def test_a_delay_of_the_torques_is_taken_out(tmp_path: Path) -> None:
    """A torque that acted 10 ms before its stamp stands where it acted, by the map's `torque_delay`."""
    q, v, e = motion()
    late = np.vstack([np.repeat(e[:1], 5, axis=0), e[:-5]])
    path = write_ros2(tmp_path / "arm", messages(q, v, late))
    record = read_record(path, dataclasses.replace(LAYOUT, torque_delay=-5e-9 * PERIOD_NS))
    np.testing.assert_allclose(record.torque[:-5], e[:-5], atol=1e-9)


def test_currents_are_no_torques(tmp_path: Path) -> None:
    """A bag that says its efforts are in A is read with torque constants alone, which make Nm of them."""
    q, v, current = motion(200)
    stamps = 10**9 + PERIOD_NS * np.arange(200)
    for unit in ("A", "rad/s^2"):
        path = tmp_path / unit[0]
        rx.write_joint_states(path, [rx.JointSeries("/arm", NAMES, stamps, q, v, current, effort_unit=unit)])
    assert "/arm: its efforts are in A; accepted: Nm, or A with --torque-constant" in refused(tmp_path / "A")
    constants = dataclasses.replace(LAYOUT, torque_constant=np.array([2.0, 3.0]))
    np.testing.assert_array_equal(read_record(tmp_path / "A", constants).torque, current * [2.0, 3.0])
    assert "its efforts are in rad/s^2" in refused(tmp_path / "r", constants)
