"""Bags made with rosbags alone, independent of the code under test, and small helpers."""

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from rx90_common.bags.joint_series import JointSeries

JOINT_STATE = "sensor_msgs/msg/JointState"
NAMES = ("joint_1", "joint_2", "joint_3")
ROS2 = get_typestore(Stores.ROS2_JAZZY)
ROS1 = get_typestore(Stores.ROS1_NOETIC)


def joint_state(
    stamp_ns: int,
    names: list[str],
    position: Any = (),
    velocity: Any = (),
    effort: Any = (),
    frame_id: str = "",
    store: Any = ROS2,
) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)
    sequence = {"seq": 0} if store is ROS1 else {}
    header = store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **sequence)
    arrays = [np.array(values, dtype=np.float64) for values in (position, velocity, effort)]
    return store.types[JOINT_STATE](header, names, *arrays)


def write_ros2(path: Path, messages: list[tuple[str, int, Any]], storage: str = "mcap") -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()]) as writer:
        topics = dict.fromkeys(topic for topic, _, _ in messages)
        connections = {t: writer.add_connection(t, JOINT_STATE, typestore=ROS2) for t in topics}
        for topic, log_ns, message in messages:
            raw = message if isinstance(message, bytes) else ROS2.serialize_cdr(message, JOINT_STATE)
            writer.write(connections[topic], log_ns, raw)
    return path


def as_sqlite(bag: Path) -> Path:
    made = bag.with_name(f"{bag.name}_sqlite")
    with AnyReader([bag]) as reader, Writer(made, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        numbers = {}
        for connection in reader.connections:
            numbers[connection.id] = writer.add_connection(connection.topic, connection.msgtype, typestore=ROS2)
        for connection, log_ns, data in reader.messages():
            writer.write(numbers[connection.id], log_ns, data)
    return made


def write_ros1(path: Path, messages: list[tuple[str, int, Any]]) -> Path:
    with Rosbag1Writer(path) as writer:
        topics = dict.fromkeys(topic for topic, _, _ in messages)
        connections = {t: writer.add_connection(t, JOINT_STATE, typestore=ROS1) for t in topics}
        for topic, log_ns, message in messages:
            writer.write(connections[topic], log_ns, ROS1.serialize_ros1(message, JOINT_STATE))
    return path


def series(
    count: int = 20,
    names: tuple[str, ...] = NAMES,
    topic: str = "/joint_states",
    step_ns: int = 1_000_000,
    seed: int = 0,
) -> JointSeries:
    random = np.random.default_rng(seed)
    position, velocity, effort = (random.normal(size=(count, len(names))) for _ in range(3))
    return JointSeries(topic, names, np.arange(count) * step_ns, position, velocity, effort)
