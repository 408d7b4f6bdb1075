"""Bags as they lie on the disk: of others, compressed, in parts, cut off, damaged; read whole, or refused in a line."""

import faulthandler
import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import yaml
from bag_making import JOINT_STATE, ROS1, ROS2, as_sqlite, joint_state, series, write_ros1, write_ros2
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from rx90_common.bags.reading import BagReader, read_joint_bag, read_joint_states
from rx90_common.bags.summary import summarise
from rx90_common.bags.writing import string_message, write_joint_states
from rx90_common.base.errors import BagError
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.recorded_setup import check_robot

STAMPS = list(range(0, 40_000_000, 1_000_000))
Damage = Callable[[Path], object]


def metadata(change: Callable[[dict[str, Any]], object]) -> Damage:
    def edit(bag: Path) -> None:
        path = bag / "metadata.yaml"
        content = yaml.safe_load(path.read_text())
        change(content["rosbag2_bagfile_information"])
        path.write_text(yaml.safe_dump(content))

    return edit


def truncate(share: float) -> Damage:
    return lambda bag: os.truncate(bag / "bag.mcap", int(share * (bag / "bag.mcap").stat().st_size))


DAMAGES: dict[str, tuple[Damage, str]] = {
    "missing": (shutil.rmtree, "no such bag"),
    "foreign folder": (
        lambda bag: [*(file.unlink() for file in bag.iterdir()), (bag / "letter.txt").write_text("hello")],
        "no bag, or without metadata.yaml, which 'ros2 bag reindex' writes; accepted: ",
    ),
    "empty": (lambda bag: (bag / "metadata.yaml").write_bytes(b""), "metadata.yaml: holds nothing"),
    "without files": (metadata(lambda c: c.pop("relative_file_paths")), "damaged: KeyError: 'relative_"),
    "with other count": (metadata(lambda c: c.update(message_count=31)), "says 31 messages, the storage holds 30; "),
    "with a text for a count": (metadata(lambda c: c.update(message_count="x")), "metadata.yaml says 'x' messages"),
    "with other file": (metadata(lambda c: c.update(relative_file_paths=["other.mcap"])), "other.mcap is missing"),
    "storage gone": (lambda bag: (bag / "bag.mcap").unlink(), "bag.mcap is missing, which metadata.yaml names"),
    "storage empty": (truncate(0.0), "bag.mcap is empty"),
    "storage of noise": (
        lambda bag: (bag / "bag.mcap").write_bytes(bytes(range(256)) * 50),
        "bag.mcap is no bag, or damaged at its beginning",
    ),
    "storage cut at the end": (
        truncate(0.99),
        "bag.mcap is cut off (its recorder was killed, or the disk was full?); 'mcap recover' restores what is whole",
    ),
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_each_damage_is_one_line(tmp_path: Path, damage: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged, emptied, foreign or missing bag gives one line that names it and why, and exit code 2."""
    good, bad = tmp_path / "good", tmp_path / "bag"
    for path in (good, bad):
        write_joint_states(path, [series(30)])
    spoil, complaint = DAMAGES[damage]
    spoil(bad)
    for words in (["info", str(bad)], ["compare", str(good), str(bad)]):
        assert run("rx90 bag", words) == 2
        out, err = capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        assert err.startswith(f"rx90 bag: {bad}: ")
        assert complaint in err


def test_bags_without_joint_states(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bags without messages or without joint states cannot be compared, a pipe is not waited for; a line says why."""
    write_joint_states(tmp_path / "good", [series()])
    write_joint_states(tmp_path / "empty", [series(0)])
    write_joint_states(tmp_path / "text", [], messages=[string_message("robot_description", "x")])
    os.mkfifo(tmp_path / "pipe")
    for name, complaint in (
        ("empty", "holds no joint states, only /joint_states\n"),
        ("text", "holds no joint states, only /robot_description\n"),
        ("pipe", "no bag, or without metadata.yaml"),
    ):
        for pair in (("good", name), (name, "good")):
            assert run("rx90 bag", ["compare", *(str(tmp_path / n) for n in pair)]) == 2
            assert capsys.readouterr().err.startswith(f"rx90 bag: {tmp_path / name}: {complaint}")


def test_killed_sqlite3_recorder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A database with a journal is refused with what to do, which gives all messages up to the last commit."""
    bag = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    bag.open()
    connection = bag.add_connection("text", "std_msgs/msg/String", typestore=ROS2)
    big = string_message("text", "x" * 10_000).cdr
    for i in range(1500):
        bag.write(connection, i * 1_000_000, big)
        if i == 1000:
            bag.storage.conn.commit()  # type: ignore[union-attr]
    killed = tmp_path / "killed"
    shutil.copytree(tmp_path / "bag", killed)  # as a process leaves it that is killed now
    bag.close()
    assert run("rx90 bag", ["info", str(killed / "bag.db3")]) == 2
    assert "bag.db3 was not closed" in capsys.readouterr().err
    with sqlite3.connect(killed / "bag.db3") as database:
        database.execute("CREATE TABLE opened(x)")
    database.close()
    assert run("rx90 bag", ["info", str(killed / "bag.db3")]) == 0
    assert ": 1001 messages" in capsys.readouterr().out


Messages = list[tuple[str, int, bytes]]


def read_all(path: Path) -> Messages:
    with BagReader(path) as bag:
        return sorted((topic.name, log_ns, data) for topic, log_ns, data in bag.messages(bag.topics))


def read_by_index(path: Path) -> Messages | None:
    """Return all messages as rosbags follows the file's index to them; None if it cannot."""
    try:
        with Reader(path) as reader:
            return sorted((c.topic, log_ns, bytes(data)) for c, log_ns, data in reader.messages(reader.connections))
    except Exception:
        return None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "foreign mcap"])
def test_a_bit_that_has_changed_is_noticed_or_does_no_harm(tmp_path: Path, kind: str) -> None:
    """Each bag with a flipped bit is refused, or gives what was written or others find; ours: what was written."""
    storage = kind.rpartition(" ")[2]
    if kind.startswith("foreign"):
        messages = [(f"/{x}", i, joint_state(i, [x], [1.0])) for i in range(4) for x in "ab"]
        write_ros2(tmp_path / "bag", messages, storage)
    else:
        write_joint_states(tmp_path / "bag", [series(4, topic=f"/{x}") for x in "ab"])
    bag = as_sqlite(tmp_path / "bag") if storage == "sqlite3" else tmp_path / "bag"
    source = next(file for file in bag.iterdir() if file.suffix != ".yaml")
    content, written = source.read_bytes(), read_all(source)
    file = tmp_path / f"flipped{source.suffix}"
    random = np.random.default_rng(1)
    noticed = 0
    places = random.choice(len(content), 60 if storage == "sqlite3" else 200, replace=False).tolist()
    for at in [*places, content.rindex(b"/a") + 1]:  # also in the name of a topic in the summary
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(random.integers(8))
        file.write_bytes(flipped)
        refusal = ""
        try:
            read = read_all(file)
        except BagError as error:
            refusal = str(error)
        if refusal:
            noticed += 1
            assert refusal.startswith(f"{file}: {file.name} ")
            continue
        assert kind != "mcap" or read == written, at
        assert read == written or read_by_index(file) in (read, None), at
    assert noticed >= {"mcap": 80, "foreign mcap": 30, "sqlite3": 3}[kind]


INDEX_FAULTS = {
    "the place of a chunk": (0x08, 16, "is damaged: "),
    "a count of the statistics": (0x0B, 48, "is damaged: it has 4 messages, its topics 0"),
    "a channel's metadata": (0x04, 21, "is damaged: "),
    "the kind of a record in the summary": (0x04, -9, "is damaged: "),
    "the footer": (0x02, 0, "is damaged: "),
}


@pytest.mark.parametrize("fault", INDEX_FAULTS)
def test_an_index_that_leads_elsewhere_is_refused(tmp_path: Path, fault: str) -> None:
    """Without checksums, too, what leads to the messages is held against them."""
    op, place, complaint = INDEX_FAULTS[fault]
    write_ros2(tmp_path / "bag", [("/x", i, joint_state(i, ["a"], [1.0])) for i in range(4)])
    file = tmp_path / "bag" / "bag.mcap"
    content = bytearray(file.read_bytes())
    at = last = 8
    while at < len(content) - 8:  # from record to record: a byte for its kind, eight for its length
        last = at if content[at] == op else last
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    content[last + 9 + place] ^= 1 if place < 0 else 4
    file.write_bytes(content)
    with pytest.raises(BagError, match=complaint):
        read_all(file)


INDEXES = {"all": IndexType.ALL, "none of chunks": IndexType.MESSAGE, "no chunks": IndexType.ALL,
           "no summary": IndexType.NONE}  # fmt: skip


def write_mcap(path: Path, compression: CompressionType, index: str) -> Path:
    summary = index != "no summary"
    writer = McapWriter(
        str(path), chunk_size=500, compression=compression, index_types=INDEXES[index],
        use_chunking=index != "no chunks", use_statistics=summary, use_summary_offsets=summary,
        repeat_channels=summary, repeat_schemas=summary,
    )  # fmt: skip
    writer.start(profile="ros2")
    joints, late, other = (
        writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", b""))
        for topic, kind in (("/joint_states", JOINT_STATE), ("/late", JOINT_STATE), ("/other", "a/msg/B"))
    )
    for stamp in STAMPS[::-1] if index == "all" else STAMPS:
        data = bytes(ROS2.serialize_cdr(joint_state(stamp, ["a"], [stamp * 1e-9]), JOINT_STATE))
        writer.add_message(joints, log_time=stamp, publish_time=stamp, data=data)
        writer.add_message(other if stamp < STAMPS[20] else late, log_time=stamp, publish_time=stamp, data=data)
    writer.finish()
    return path


def undamaged(folder: Path, kind: str) -> Path:
    folder.mkdir()
    if kind in ("mcap", "sqlite3"):
        return write_ros2(folder / "bag", [("/x", i, joint_state(i, ["a"], [1.0])) for i in range(20)], kind)
    if kind == "ros1":
        messages = [("/x", i, joint_state(i, ["a"], [1.0], store=ROS1)) for i in range(20)]
        return write_ros1(folder / "bag.bag", messages)
    index = "all" if kind == "zstd" else "no summary"
    return write_mcap(folder / "bag.mcap", CompressionType[kind.upper()], index)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "zstd", "lz4", "ros1"])
def test_each_of_600_damages_is_one_line(tmp_path: Path, kind: str) -> None:
    """Whatever bytes are cut off or changed, 120 times of each kind, a bag is read or refused in a line, in seconds."""
    path = undamaged(tmp_path / "whole", kind)
    files = [path] if path.is_file() else sorted(path.iterdir())
    contents = [file.read_bytes() for file in files]
    random = np.random.default_rng(11)
    for number in range(120):
        choice = number % len(files)
        content = bytearray(contents[choice])
        for at in random.integers(len(content), size=random.integers(9)):
            content[at] = random.integers(256)
        files[choice].write_bytes(content if number % 4 else content[: random.integers(len(content))])
        faulthandler.dump_traceback_later(30, exit=True)
        try:
            for read in (read_joint_bag, summarise):
                message = f"{path}"
                try:
                    read(path)
                except BagError as error:
                    message = str(error)
                assert "\n" not in message
                assert str(path) in message
        finally:
            faulthandler.cancel_dump_traceback_later()
        files[choice].write_bytes(contents[choice])


def test_what_the_metadata_say_beside_the_counts_is_not_needed(tmp_path: Path) -> None:
    """Another version and storage, and nothing about the topics, keep no message back."""
    write_joint_states(tmp_path / "bag", [series(30)])
    metadata(lambda c: c.update(version=99, storage_identifier="other", topics_with_message_count=[]))(tmp_path / "bag")
    np.testing.assert_array_equal(read_joint_states(tmp_path / "bag", "joint_states").position, series(30).position)


@pytest.mark.parametrize(
    ("storage", "mode"), [("mcap", m) for m in ("NONE", "MESSAGE", "FILE", "STORAGE")] + [("sqlite3", "NONE"),
    ("sqlite3", "MESSAGE"), ("sqlite3", "FILE")],
)  # fmt: skip
def test_types_that_cannot_be_parsed_and_compressed_bags(
    tmp_path: Path, storage: str, mode: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Topics of unknown types are listed and left aside; the storage is named; a file alone will do."""
    bag = tmp_path / "bag"
    writer = Writer(bag, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if mode != "NONE":
        writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    event, no_hash = "int64 a\nint64 b\n---\nint64 sum\n", "RIHS01_" + "0" * 64  # which rosbags does not parse
    with writer:
        joints = writer.add_connection("/joint_states", JOINT_STATE, typestore=ROS2)
        kind = "example_interfaces/srv/AddTwoInts_Event"
        events = writer.add_connection("/add/_service_event", kind, msgdef=event, rihs01=no_hash)
        old = writer.add_connection(
            "/old", "sensor_msgs/JointState", msgdef="x", rihs01=no_hash, serialization_format="ros1"
        )
        for stamp in STAMPS:
            writer.write(joints, stamp, ROS2.serialize_cdr(joint_state(stamp, ["a"], [1.0]), JOINT_STATE))
        writer.write(events, 5, b"\0\1\0\0" + bytes(16))
        writer.write(old, 7, bytes(ROS1.serialize_ros1(joint_state(9, ["b"], [2.0], store=ROS1), JOINT_STATE)))
    (file,) = (file for file in bag.iterdir() if file.name != "metadata.yaml")
    for path in (bag, shutil.copy(file, tmp_path / "alone")):
        summary = summarise(path)
        assert {t.topic: t.count for t in summary.topics} == {"/joint_states": 40, "/add/_service_event": 1, "/old": 1}
        read = read_joint_bag(path).series
        assert read["/joint_states"][0].stamp_ns.tolist() == STAMPS
        assert (read["/old"][0].names, read["/old"][0].stamp_ns.tolist()) == (("b",), [9])
    assert run("rx90 bag", ["compare", str(bag), str(bag)]) == 0
    assert "; 1 other topic not compared\n" in capsys.readouterr().out
    assert run("rx90 bag", ["info", str(bag)]) == 0
    assert f"{bag}: 42 messages\n" in capsys.readouterr().out


@pytest.mark.parametrize("index", INDEXES)
@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD])
def test_an_mcap_file_is_read_whatever_index_it_has(tmp_path: Path, index: str, compression: CompressionType) -> None:
    """Files of the mcap project's writer, with less and less of an index, in any order of time, by chosen topics."""
    path = write_mcap(tmp_path / "bag.mcap", compression, index)
    assert {t.topic: t.count for t in summarise(path).topics} == {"/joint_states": 40, "/late": 20, "/other": 20}
    for topic, stamps in (("joint_states", STAMPS), ("late", STAMPS[20:])):
        assert read_joint_states(path, topic).stamp_ns.tolist() == stamps
    with BagReader(path) as bag:
        wanted = [topic for topic in bag.topics if topic.name != "/joint_states"]
        found = [(topic.name, log_ns) for topic, log_ns, _ in bag.messages(wanted)]
    assert found == [("/other" if stamp < STAMPS[20] else "/late", stamp) for stamp in STAMPS]


def test_files_of_a_split_recording_need_their_metadata(tmp_path: Path) -> None:
    """Parts come in the order of the list; without metadata each is read alone."""
    bag = tmp_path / "bag"
    bag.mkdir()
    names = [f"bag_{i}.mcap" for i in range(9, 12)]
    for i, name in enumerate(names):
        write_joint_states(tmp_path / f"part_{i}", [series(2, seed=i)])
        shutil.copy(tmp_path / f"part_{i}" / f"part_{i}.mcap", bag / name)
    with pytest.raises(BagError, match=r"no bag, or without metadata\.yaml"):
        read_joint_states(bag, "joint_states")
    shutil.copy(tmp_path / "part_0" / "metadata.yaml", bag)
    metadata(lambda c: c.update(relative_file_paths=names, message_count=6))(bag)
    parts = [series(2, seed=i).position for i in range(3)]
    np.testing.assert_array_equal(read_joint_states(bag, "joint_states").position, np.vstack(parts))


def test_names_in_a_bag_forge_no_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A topic with line breaks in its name, or of thousands of characters, is one short row of the summary."""
    hostile = "/a\n[INFO] [rx90_sim]: all is well\u202e" + "x" * 100_000
    write_joint_states(tmp_path / "bag", [series(3, topic=hostile)])
    assert run("rx90 bag", ["info", str(tmp_path / "bag")]) == 0
    assert run("rx90 bag", ["compare", "--topic", "/b", "--", *[str(tmp_path / "bag")] * 2]) == 2
    out, err = capsys.readouterr()
    assert (out.count("\n"), err.count("\n")) == (3, 1)
    assert max(len(out), len(err)) < 1500
    assert "/a\\n[INFO]" in out


@pytest.mark.parametrize("name", ["a & b", "it's", 'said "so"', "a > b", "größer", "<robot name='other'>"])
def test_a_robot_knows_its_own_bag(name: str, tmp_path: Path) -> None:
    """Whatever its name, as the XML of its description has it, and whatever comes before it."""
    description = f"<?xml version='1.0'?><!-- <robot name='x'/> --><robot color='b' name={quoteattr(name)}/>"
    write_joint_states(tmp_path / "bag", [], messages=[string_message("robot_description", description)])
    check_robot(tmp_path / "bag", name)
    with pytest.raises(BagError, match=r"^[^:]*: recorded of the robot"):
        check_robot(f"{tmp_path}/bag/", "other")
