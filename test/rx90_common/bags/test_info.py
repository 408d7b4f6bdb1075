"""The summary of a bag."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bag_making import ROS1, STORAGES, joint_state, series, write_ros1

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.summary import summarise
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_emulator.cli.frame import run


@pytest.mark.parametrize("storage", STORAGES)
def test_counts_rates_and_gaps(tmp_path: Path, storage: str) -> None:
    """Count, rate, first and last stamp, number of gaps and the longest of them are those of the stamps."""
    steady = series(101, step_ns=250_000, topic="/motor_states")
    rows = np.r_[0:30, 33:60, 70:101]
    write_joint_states(
        tmp_path / "bag",
        [steady, series(101).take(rows)],
        storage=storage,
        messages=[string_message("note", "")],
    )
    summary = summarise(tmp_path / "bag")
    assert (summary.count, summary.storage) == (101 + 88 + 1, {"mcap": "mcap", "sqlite3": "db3"}[storage])
    assert summary.size == sum(f.stat().st_size for f in (tmp_path / "bag").iterdir())
    joint, motor, note = summary.topics
    assert (motor.rate, motor.gaps, motor.longest_gap_ns) == (4000.0, 0, None)
    assert (motor.first_ns, motor.last_ns) == (0, 25_000_000)
    assert (joint.gaps, joint.longest_gap_ns, joint.longest_gap_at_ns) == (2, 11_000_000, 59_000_000)
    assert joint.rate == pytest.approx(870.0)
    assert (note.count, note.time, note.rate) == (1, "log", None)


def test_time_that_goes_back(tmp_path: Path) -> None:
    """Stamps that repeat or go back are counted, in ROS 1 bags too."""
    stamps = [0, 10, 20, 20, 30, 5, 15]
    path = write_ros1(
        tmp_path / "bag.bag",
        [("/x", i, joint_state(s, ["a"], [1.0], store=ROS1)) for i, s in enumerate(stamps)],
    )
    (topic,) = summarise(path).topics
    assert (topic.backward, topic.repeated, topic.first_ns, topic.last_ns) == (1, 1, 0, 30)


def test_table_and_json_agree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The printed table and the JSON carry the same counts and times."""
    write_joint_states(tmp_path / "bag", [series(11)])
    assert run("rx90_bag", ["info", str(tmp_path / "bag")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[2].split() == [
        "/joint_states",
        "sensor_msgs/msg/JointState",
        "11",
        "1000.000",
        "0.000000",
        "0.010000",
    ]
    assert run("rx90_bag", ["info", "--json", str(tmp_path / "bag")]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["count"] == 11
    assert content["topics"][0]["last_ns"] == 10_000_000


def test_messages_of_one_moment_are_no_fault(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Temperatures come as one message for each joint at the same time; of set-points a repeated time is told."""
    names = ("joint_1", "joint_2", "joint_3")
    stamps = np.arange(3, dtype=np.int64) * 10**9
    warm = JointSeries("/temperatures", names, stamps, temperature=np.full((3, 3), 20.0))
    write_joint_states(tmp_path / "bag", [series(11), warm])
    write_joint_states(tmp_path / "twice", [series(11).take([0, 1, 1, 2])])
    for bag, repeated in (("bag", False), ("twice", True)):
        assert run("rx90_bag", ["info", str(tmp_path / bag)]) == 0
        assert ("repeated times" in capsys.readouterr().out) == repeated
