"""Bags of others: what is not needed may be unknown, missing or told in two ways, and the bag is read all the same."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from bag_making import JOINT_STATE, ROS1, ROS2, STORAGES, joint_state, series
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from rx90_common.bags.reading import BagReader, read_joint_bag, read_joint_states
from rx90_common.bags.summary import summarise
from rx90_common.bags.writing import write_joint_states
from rx90_emulator.cli.frame import run

STAMPS = list(range(0, 40_000_000, 1_000_000))
INDEXES = {
    "all": IndexType.ALL,
    "none of messages": IndexType.CHUNK,
    "none of chunks": IndexType.MESSAGE,
    "no chunks": IndexType.ALL,
    "no summary": IndexType.NONE,
}


def write_foreign(path: Path, storage: str = "mcap", compression: CompressionMode = CompressionMode.NONE) -> Path:
    """Write joint states beside a service event, whose definition rosbags does not parse, and text of a ROS 1 kind."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    event, no_hash = "int64 a\nint64 b\n---\nint64 sum\n", "RIHS01_" + "0" * 64
    with writer:
        joints = writer.add_connection("/joint_states", JOINT_STATE, typestore=ROS2)
        kind = "example_interfaces/srv/AddTwoInts_Event"
        events = writer.add_connection("/add/_service_event", kind, msgdef=event, rihs01=no_hash)
        old = writer.add_connection(
            "/old", "sensor_msgs/JointState", msgdef="x", rihs01=no_hash, serialization_format="ros1"
        )
        for stamp in STAMPS:
            message = joint_state(stamp, ["a"], [stamp * 1e-9])
            writer.write(joints, stamp, ROS2.serialize_cdr(message, JOINT_STATE))
        writer.write(events, 5, b"\0\1\0\0" + bytes(16))
        writer.write(old, 7, bytes(ROS1.serialize_ros1(joint_state(9, ["b"], [2.0], store=ROS1), JOINT_STATE)))
    return path


def edit(bag: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change metadata.yaml."""
    path = bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    change(content["rosbag2_bagfile_information"])
    path.write_text(yaml.safe_dump(content))


def first_topic(content: dict[str, Any]) -> Any:
    """Return what the metadata say of the first topic."""
    return content["topics_with_message_count"][0]["topic_metadata"]


OTHERWISE: dict[str, Callable[[Path], object]] = {
    "quality of service": lambda bag: edit(bag, lambda c: first_topic(c).update(offered_qos_profiles=[])),
    "no quality of service": lambda bag: edit(bag, lambda c: first_topic(c).pop("offered_qos_profiles")),
    "another type hash": lambda bag: edit(bag, lambda c: first_topic(c).update(type_description_hash="RIHS01_0")),
    "another encoding": lambda bag: edit(bag, lambda c: first_topic(c).update(serialization_format="other")),
    "another storage": lambda bag: edit(bag, lambda c: c.update(storage_identifier="other")),
    "a later version": lambda bag: edit(bag, lambda c: c.update(version=99)),
    "no metadata": lambda bag: (bag / "metadata.yaml").unlink(),
}


@pytest.mark.parametrize("otherwise", OTHERWISE)
def test_what_the_metadata_say_beside_the_counts_is_not_needed(tmp_path: Path, otherwise: str) -> None:
    """Metadata that differ from the storage in what no message needs, or are not there, keep no message back."""
    write_joint_states(tmp_path / "bag", [series(30)])
    OTHERWISE[otherwise](tmp_path / "bag")
    read = read_joint_states(tmp_path / "bag", "joint_states")
    assert read.position is not None
    np.testing.assert_array_equal(read.position, series(30).position)
    with BagReader(tmp_path / "bag") as bag:
        note = "metadata.yaml is missing; read as they are: bag.mcap"
        assert bag.notes == ([note] if otherwise == "no metadata" else [])


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("mode", ["NONE", "MESSAGE", "FILE", "STORAGE"])
def test_types_that_cannot_be_parsed_and_compressed_bags(
    tmp_path: Path, storage: str, mode: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Topics of unknown types are listed and left aside; storage and compression are named; a file alone will do."""
    if (storage, mode) == ("sqlite3", "STORAGE"):
        return  # sqlite3 has no compression of its own
    bag = write_foreign(tmp_path / "bag", storage, CompressionMode[mode])
    kind = {"mcap": "mcap", "sqlite3": "db3"}[storage]
    words = {"NONE": "", "MESSAGE": "zstd messages", "FILE": "zstd files", "STORAGE": "zstd chunks"}[mode]
    (file,) = (file for file in bag.iterdir() if file.name != "metadata.yaml")
    for path in (bag, shutil.copy(file, tmp_path / "alone")):
        summary = summarise(path)
        assert (summary.storage, summary.compression) == (kind, words)
        assert {t.topic: t.count for t in summary.topics} == {"/joint_states": 40, "/add/_service_event": 1, "/old": 1}
        assert read_joint_states(path, "joint_states").stamp_ns.tolist() == STAMPS
        (old,) = read_joint_bag(path, ["old"]).series["/old"]
        assert (old.names, old.stamp_ns.tolist()) == (("b",), [9])
    assert run("rx90_bag", ["compare", str(bag), str(bag)]) == 0
    assert "not compared, as they are no JointState or Temperature: /add/_service_event\n" in capsys.readouterr().out
    assert run("rx90_bag", ["info", str(bag)]) == 0
    assert f"{bag}: {kind}{f' ({words})' * bool(words)}, " in capsys.readouterr().out


@pytest.mark.parametrize("index", ["all", "none of messages", "none of chunks", "no chunks", "no summary"])
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_an_mcap_file_is_read_by_whatever_index_it_has(
    tmp_path: Path, index: str, compression: CompressionType
) -> None:
    """Files of the mcap project's writer, with less and less of an index, of another profile, with other topics."""
    path = tmp_path / "bag.mcap"
    summary = index != "no summary"
    writer = McapWriter(
        str(path), chunk_size=500, compression=compression, index_types=INDEXES[index],
        use_chunking=index != "no chunks", use_statistics=summary, use_summary_offsets=summary,
        repeat_channels=summary, repeat_schemas=summary,
    )  # fmt: skip
    writer.start(profile="")
    joints, other = (
        writer.register_channel(topic, encoding, writer.register_schema(kind, schema, b""))
        for topic, kind, encoding, schema in (
            ("/joint_states", JOINT_STATE, "cdr", "ros2msg"),
            ("/other", "Other", "json", "jsonschema"),
        )
    )
    for stamp in STAMPS[::-1]:
        data = bytes(ROS2.serialize_cdr(joint_state(stamp, ["a"], [stamp * 1e-9]), JOINT_STATE))
        writer.add_message(joints, log_time=stamp, publish_time=stamp, data=data)
        writer.add_message(other, log_time=stamp, publish_time=stamp, data=b"{}")
    writer.finish()
    assert read_joint_states(path, "joint_states").stamp_ns.tolist() == STAMPS
    assert {(t.topic, t.encoding, t.count) for t in summarise(path).topics} == {
        ("/joint_states", "cdr", 40), ("/other", "json", 40),
    }  # fmt: skip


def test_chunks_hold_other_topics_than_those_asked_for(tmp_path: Path) -> None:
    """Of chunks with as many topics as are asked for, but not the same ones, no message too many is read."""
    data = b"\x00\x01" * 50  # not decoded here
    with (tmp_path / "bag.mcap").open("wb") as stream:
        writer = McapWriter(stream, chunk_size=300)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        channels = {name: writer.register_channel(name, "cdr", schema) for name in ("/a", "/b", "/c")}
        for i, name in enumerate(["/a", "/b", "/a", "/b", "/a", "/c", "/a", "/c"]):
            writer.add_message(channels[name], i, data, i)
        writer.finish()
    with BagReader(tmp_path / "bag.mcap") as bag:
        wanted = [topic for topic in bag.topics if topic.name in ("/a", "/c")]
        assert [(topic.name, log_ns) for topic, log_ns, _ in bag.messages(wanted)] == [
            ("/a", 0), ("/a", 2), ("/a", 4), ("/c", 5), ("/a", 6), ("/c", 7)
        ]  # fmt: skip


def test_several_files_are_read_as_one(tmp_path: Path) -> None:
    """Files of one folder, whose times overlap, come in the order of log time, with metadata or without."""
    folder = tmp_path / "bag"
    folder.mkdir()
    whole = series(60)
    for i, part in enumerate((slice(0, 60, 2), slice(1, 60, 2))):
        write_joint_states(tmp_path / f"part_{i}", [whole.take(part)])
        shutil.copy(tmp_path / f"part_{i}" / f"part_{i}.mcap", folder / f"bag_{i}.mcap")
    np.testing.assert_array_equal(read_joint_states(folder, "joint_states").stamp_ns, whole.stamp_ns)


def test_parts_of_a_recording_are_read_by_their_numbers(tmp_path: Path) -> None:
    """Without metadata, messages of equal time come in the order in which the files were written: 10 follows 9."""
    (tmp_path / "bag").mkdir()
    for i in range(3, 13):
        write_joint_states(tmp_path / f"part_{i}", [series(1, seed=i)])
        shutil.copy(tmp_path / f"part_{i}" / f"part_{i}.mcap", tmp_path / "bag" / f"bag_{i}.mcap")
    read = read_joint_states(tmp_path / "bag", "joint_states")
    np.testing.assert_array_equal(read.position, np.vstack([series(1, seed=i).position for i in range(3, 13)]))


@pytest.mark.parametrize(
    "names", ["a b", "bag_0 bag_2", "a_0 b_1", "bag_0 bag_00", "bag bag_0", "bag_0.mcap bag_1.db3"]
)
@pytest.mark.parametrize("verb", ["info", "compare"])
def test_files_that_are_not_of_one_recording_are_refused(
    tmp_path: Path, names: str, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files of one folder without metadata, of which one is missing or foreign, are one line."""
    write_joint_states(tmp_path / "whole", [series()])
    folder = tmp_path / "bag"
    folder.mkdir()
    for name in names.split():
        shutil.copy(tmp_path / "whole" / "whole.mcap", folder / (name if "." in name else f"{name}.mcap"))
    assert run("rx90_bag", [verb, *[str(folder)] * (1 + (verb == "compare"))]) == 2
    out, err = capsys.readouterr()
    assert not out
    there = ", ".join(sorted(file.name for file in folder.iterdir()))
    assert err == (
        f"rx90_bag: {folder}: metadata.yaml is missing, and {there} are not the parts of one recording; accepted: "
        "NAME_0.mcap, NAME_1.mcap and so on without a gap, or each file by its path\n"
    )


def test_names_in_a_bag_forge_no_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A topic with line breaks in its name, or of thousands of characters, is one short row of the summary."""
    hostile = "/a\n[INFO] [rx90_sim]: all is well\u202e" + "x" * 100_000
    write_joint_states(tmp_path / "bag", [series(3, topic=hostile)])
    assert run("rx90_bag", ["info", str(tmp_path / "bag")]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 3
    assert len(out) < 1500
    assert "/a\\n[INFO]" in out
    assert run("rx90_bag", ["compare", "--topics", "/b", "--", *[str(tmp_path / "bag")] * 2]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert len(err) < 1000
