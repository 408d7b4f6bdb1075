"""Temperatures of joints and windings in bags: read, exported and imported, compared, drawn as other series are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_making import JOINT_STATE, ROS2, joint_state
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

import rx90_emulator as rx
from rx90_common.bags.batch import temperature_cdr
from rx90_common.bags.plotting import plot_bags
from rx90_common.base.errors import BagError, ExchangeError
from rx90_common.report.plot import Curve
from rx90_emulator.cli.frame import run

TEMPERATURE = "sensor_msgs/msg/Temperature"
SECOND = 1_000_000_000
NAMES = ("joint_1", "joint_5_6", "motor_1")
START = 1_790_000_000 * SECOND + 7  # of the wall clock
STAMPS = [START + k * SECOND for k in range(20)]
LOST = (4, "joint_5_6")
VALUES = np.random.default_rng(5).uniform(-40.0, 120.0, (20, 3))
VALUES[2] = [-0.0, 5e-324, 0.1 + 0.2]

Told = tuple[int, str, float]


def cdr(stamp_ns: int, name: str, value: float) -> bytes:
    """Return a message as rosbags writes it."""
    time = ROS2.types["builtin_interfaces/msg/Time"](stamp_ns // SECOND, stamp_ns % SECOND)
    message: Any = ROS2.types[TEMPERATURE](ROS2.types["std_msgs/msg/Header"](time, name), value, 0.0)
    return bytes(ROS2.serialize_cdr(message, TEMPERATURE))


def usual() -> list[Told]:
    """Return what a node publishes: all names at each stamp; one message was lost, and one came twice."""
    told = [
        (stamp, name, float(VALUES[k, column]))
        for k, stamp in enumerate(STAMPS)
        for column, name in enumerate(NAMES)
        if (k, name) != LOST
    ]
    return [*told, told[-1]]


def write(path: Path, told: list[Told]) -> Path:
    """Write a bag with these temperatures, and with joint states."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        joints = writer.add_connection("/joint_states", JOINT_STATE, typestore=ROS2)
        warmth = writer.add_connection("/temperatures", TEMPERATURE, typestore=ROS2)
        for stamp in STAMPS:
            writer.write(joints, stamp, ROS2.serialize_cdr(joint_state(stamp, ["joint_1"], [0.5]), JOINT_STATE))
        for stamp, name, value in told:
            writer.write(warmth, stamp, cdr(stamp, name, value))
    return path


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag with the usual temperatures."""
    return write(tmp_path_factory.mktemp("bag") / "run", usual())


def test_temperatures_are_a_series(bag: Path) -> None:
    """`read_bag` gives a row for each stamp, a column for each frame_id, °C, and NaN for the message that is lost."""
    series = rx.read_bag(bag)["temperatures"]
    assert series.names == NAMES
    assert series.quantities["temperature"] == "temperature [°C]"
    assert series.stamp_ns.tolist() == [*STAMPS, STAMPS[-1]]
    expected = np.vstack([VALUES, [np.nan, np.nan, VALUES[-1, 2]]])
    expected[LOST[0], NAMES.index(LOST[1])] = np.nan
    assert series.temperature is not None
    assert series.temperature.tobytes() == expected.tobytes()
    assert series.messages == len(usual())
    with pytest.raises(BagError, match="position, temperature; accepted: temperature alone"):
        rx.JointSeries("/t", NAMES, series.stamp_ns, series.temperature, temperature=series.temperature)


def test_names_that_come_and_go_leave_rows_whole(tmp_path: Path) -> None:
    """One that falls silent, and one that comes after many rows, have a column from the first row to the last.

    With `record_time` the stamp of a row is when its first message was recorded; rows are by headers.
    """
    told = [
        (stamp, name, float(VALUES[k, column]))
        for k, stamp in enumerate(STAMPS)
        for column, name in enumerate(NAMES)
        if {"joint_1": True, "joint_5_6": k >= 15, "motor_1": k < 4}[name]
    ]
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        warmth = writer.add_connection("/temperatures", TEMPERATURE, typestore=ROS2)
        for k, (stamp, name, value) in enumerate(told):
            writer.write(warmth, START + 1000 * k, cdr(stamp, name, value))
    expected = np.full((20, 3), np.nan)
    expected[:, 0], expected[:4, 1], expected[15:, 2] = VALUES[:, 0], VALUES[:4, 2], VALUES[15:, 1]
    recorded = [START + 1000 * k for k, (_, name, _) in enumerate(told) if name == "joint_1"]
    for record_time, stamps in ((False, STAMPS), (True, recorded)):
        found = rx.read_bag(tmp_path / "run", record_time=record_time)["temperatures"]
        assert (found.names, found.stamp_ns.tolist()) == (("joint_1", "motor_1", "joint_5_6"), stamps)
        assert found.temperature is not None
        assert found.temperature.tobytes() == expected.tobytes()


def test_temperatures_are_compared(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A temperature that differs is a line with the difference and 1; within --tolerance it is none, and 0."""
    told = usual()
    stamp, name, value = told[30]
    other = write(tmp_path / "other", [*told[:30], (stamp, name, value + 0.25), *told[31:]])
    assert run("rx90_bag", ["compare", str(bag), str(other)]) == 1
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.endswith("  1")]
    assert line.split()[:3] == ["temperature", name, "2.500e-01"]
    assert line.split()[-3:] == ["°C", "0", "1"]
    assert run("rx90_bag", ["compare", str(bag), str(other), "--tolerance", "temperatures:temperature=0.3"]) == 0
    # Bags are not the same in what neither has.
    words = ["compare", str(bag), str(bag), "--topics", "joint_states", "--fields", "temperature"]
    assert run("rx90_bag", [*words, "velocity"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "rx90_bag: fields temperature, velocity: no message has any of them; accepted: some of position"
    assert run("rx90_bag", [*words, "position"]) == 0


def test_temperatures_are_drawn(bag: Path, tmp_path: Path) -> None:
    """A plot has a curve for each name, in one line, over an axis in °C, without a gap where a message was lost."""
    (plot,) = plot_bags([bag], topics=["temperatures"])
    (panel,) = plot.plot.panels
    assert (panel.y_label, plot.messages) == ("temperature, °C", (len(usual()),))
    for curve, name in zip(panel.marks, NAMES, strict=True):
        assert isinstance(curve, Curve)
        assert curve.label == name
        assert curve.y.tolist() == [value for _, one, value in usual() if one == name]
    odd = write(tmp_path / "odd", [(STAMPS[0], "a\n\x1b[31m", 20.0), (STAMPS[1], "a\n\x1b[31m", 21.0)])
    (plot,) = plot_bags([odd], topics=["temperatures"])
    assert [mark.label for mark in plot.plot.panels[0].marks if isinstance(mark, Curve)] == [r"a\n\x1b[31m"]


def test_a_mapping_has_temperatures_in_a_topic_of_their_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`rx90_bag import` makes Temperature messages of any log's columns; beside positions it refuses them."""
    log, mapping = tmp_path / "log.csv", tmp_path / "log.yaml"
    log.write_text("0.0,20.5,1.0\n0.5,21.5,2.0\n", encoding="utf-8")
    text = (
        "time: {column: 1, unit: s}\ntopics:\n  warmth:\n    names: [gear]\n    temperature: {columns: [2], unit: °C}\n"
    )
    mapping.write_text(text, encoding="utf-8")
    assert run("rx90_bag", ["import", str(log), str(tmp_path / "bag")]) == 0
    with AnyReader([tmp_path / "bag"]) as reader:
        assert [data for _, _, data in reader.messages()] == [cdr(0, "gear", 20.5), cdr(SECOND // 2, "gear", 21.5)]
    mapping.write_text(text + "    position: {columns: [3], unit: rad}\n", encoding="utf-8")
    capsys.readouterr()
    assert run("rx90_bag", ["import", str(log), str(tmp_path / "none")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "temperature stands beside others; accepted: temperatures in a topic of their own" in line


def test_messages_are_those_of_another_serialiser() -> None:
    """A message has the bytes that rosbags writes, however long the name; what cannot stand in it is refused."""
    for name in ("", "j", "größe", *("x" * length for length in range(2, 12))):
        assert temperature_cdr(START, name, 36.6) == cdr(START, name, 36.6)
    for stamp, name in ((-1, "j"), (2**31 * SECOND, "j"), (0, "a\0b")):
        with pytest.raises(ExchangeError, match="accepted: "):
            temperature_cdr(stamp, name, 20.0)
