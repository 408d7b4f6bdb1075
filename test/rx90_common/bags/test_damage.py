"""Bags that cannot be read: one clear line each, and no other exception whatever the bytes."""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import yaml
from backports import zstd
from bag_making import ROS1, STORAGES, joint_state, series, write_one, write_ros1, write_ros2
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from rx90_common.bags.reading import BagReader, read_joint_bag
from rx90_common.bags.storage_files import MCAP_MAGIC
from rx90_common.bags.writing import BagWriter, offered_qos, string_message, write_joint_states
from rx90_common.base.errors import BagError
from rx90_emulator.cli.frame import run


def edit_metadata(bag: Path, edit: Callable[[dict[str, Any]], object]) -> None:
    """Change metadata.yaml."""
    path = bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    edit(content["rosbag2_bagfile_information"])
    path.write_text(yaml.safe_dump(content))


def truncate(share: float) -> Callable[[Path], None]:
    """Return what cuts the storage file to this share of its length."""

    def damage(bag: Path) -> None:
        file = bag / "bag.mcap"
        file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])

    return damage


def forget_a_message(content: dict[str, Any]) -> None:
    """Let the metadata count one message more than there are."""
    content["topics_with_message_count"][0]["message_count"] += 1
    content["message_count"] += 1


def places(content: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return where the metadata count messages."""
    return {"in all": content, "of a topic": content["topics_with_message_count"][0]}


ALIASES = "a0: &a0 1\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))
"""Two to the power of 59 values."""

DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (shutil.rmtree, "no such bag"),
    "emptied": (lambda bag: [file.unlink() for file in bag.iterdir()], "not a bag"),
    "foreign folder": (
        lambda bag: [shutil.rmtree(bag), bag.mkdir(), (bag / "letter.txt").write_text("hello")],
        "not a bag",
    ),
    "metadata no YAML": (lambda bag: (bag / "metadata.yaml").write_text("{]"), "metadata.yaml: not valid YAML"),
    "metadata empty": (lambda bag: (bag / "metadata.yaml").write_text(""), "metadata.yaml: holds nothing"),
    "metadata binary": (lambda bag: (bag / "metadata.yaml").write_bytes(b"\xff\xfe"), "metadata.yaml: cannot be read"),
    "metadata of aliases": (
        lambda bag: (bag / "metadata.yaml").write_text(ALIASES),
        "metadata.yaml: not valid YAML (more than 400,000 values",
    ),
    "metadata without topics": (
        lambda bag: edit_metadata(bag, lambda c: c.pop("topics_with_message_count")),
        "topics_with_message_count",
    ),
    "metadata with other count": (
        lambda bag: edit_metadata(bag, forget_a_message),
        "metadata.yaml says 31 messages of /joint_states",
    ),
    **{
        f"metadata with {count} messages {where}": (
            lambda bag, count=count, where=where: edit_metadata(
                bag, lambda c: places(c)[where].update(message_count=count)
            ),
            f"message_count is {count!r}; accepted: an integer in [0, ",
        )
        for where, count in (("of a topic", 1e20), ("in all", 10**20), ("of a topic", -1), ("in all", "many"))
    },
    "metadata with other sum": (
        lambda bag: edit_metadata(bag, lambda c: c.update(message_count=7)),
        "metadata.yaml says 7 messages in all",
    ),
    "metadata with other type": (
        lambda bag: edit_metadata(
            bag, lambda c: c["topics_with_message_count"][0]["topic_metadata"].update(type="a/msg/B")
        ),
        "metadata.yaml says",
    ),
    "metadata with other file": (
        lambda bag: edit_metadata(bag, lambda c: c.update(relative_file_paths=["other.mcap"])),
        "other.mcap",
    ),
    "storage gone": (lambda bag: (bag / "bag.mcap").unlink(), "bag.mcap is missing, which metadata.yaml names"),
    "storage empty": (lambda bag: (bag / "bag.mcap").write_bytes(b""), "bag.mcap is empty"),
    "storage of noise": (
        lambda bag: (bag / "bag.mcap").write_bytes(bytes(range(256)) * 50),
        "bag.mcap is no bag, or damaged at its beginning",
    ),
    "storage cut at the end": (
        truncate(0.99),
        "bag.mcap is cut off (its recorder was killed, or the disk was full?): 30 messages up to t = 0.029000 s are",
    ),
    "storage cut early": (truncate(0.5), "cut off before its first whole chunk: nothing can be recovered"),
}


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("verb", ["info", "compare"])
def test_each_damage_is_one_line(tmp_path: Path, damage: str, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A damaged, emptied, foreign or missing bag gives one line that names it and why, and exit code 2."""
    good, bad = tmp_path / "good", tmp_path / "bag"
    for path in (good, bad):
        write_joint_states(path, [series(30)])
    spoil, complaint = DAMAGES[damage]
    spoil(bad)
    assert run("rx90_bag", [verb, *([str(good)] if verb == "compare" else []), str(bad)]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err.startswith(f"rx90_bag: {bad}: ")
    assert err.count("\n") == 1
    assert complaint in err


@pytest.mark.parametrize("verb", ["info", "compare"])
@pytest.mark.parametrize("rows", ["1", "20, 3, 4", "30"])
def test_deleted_rows_are_noticed(tmp_path: Path, rows: str, verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A database that is read alone says how many messages were deleted from it, unless these were the last ones."""
    write_joint_states(tmp_path / "bag", [series(30)], storage="sqlite3")
    file = tmp_path / "bag" / "bag.db3"
    copy = str(shutil.copy(file, tmp_path / "whole.db3"))
    with sqlite3.connect(file) as database:
        database.execute(f"DELETE FROM messages WHERE id IN ({rows})")
    database.close()
    last = rows == "30"
    assert run("rx90_bag", [verb, *([copy] if verb == "compare" else []), str(file)]) == (
        verb == "compare" if last else 2
    )
    out, err = capsys.readouterr()
    lost = len(rows.split(","))
    assert bool(out) == last
    assert last or err == (
        f"rx90_bag: {file}: bag.db3 is damaged: {lost} messages are gone: the last one has number 30, {30 - lost} are "
        "there; 'ros2 bag convert' makes a bag of these\n"
    )


def test_bags_without_joint_states(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bags without messages or without joint states cannot be compared, and the line says which it is."""
    write_joint_states(tmp_path / "good", [series()])
    write_joint_states(tmp_path / "empty", [series(0)])
    write_joint_states(tmp_path / "void", [])
    write_joint_states(tmp_path / "text", [], messages=[string_message("robot_description", "x")])
    for name, complaint in (
        ("empty", "holds no messages"),
        ("void", "holds no messages"),
        ("text", "holds no JointState or Temperature topic, only /robot_description"),
    ):
        for pair in (("good", name), (name, "good")):
            assert run("rx90_bag", ["compare", *(str(tmp_path / n) for n in pair)]) == 2
            err = capsys.readouterr().err
            assert err == f"rx90_bag: {tmp_path / name}: {complaint}\n"


def test_a_pipe_is_refused_without_waiting(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What cannot be read twice is refused before it is opened, which would wait for a writer."""
    os.mkfifo(tmp_path / "bag.mcap")
    assert run("rx90_bag", ["info", str(tmp_path / "bag.mcap")]) == 2
    assert "no file that can be read twice; accepted: " in capsys.readouterr().err


def test_storage_file_alone_is_enough(tmp_path: Path) -> None:
    """Without metadata a whole storage file can still be read by its own path."""
    for storage, suffix in zip(STORAGES, ("mcap", "db3"), strict=True):
        path = tmp_path / storage
        write_joint_states(path, [series()], storage=storage)
        (path / "metadata.yaml").unlink()
        assert run("rx90_bag", ["compare", *[str(path / f"{storage}.{suffix}")] * 2]) == 0


def test_killed_sqlite3_recorder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A database with a journal is refused with what to do, which gives all messages up to the checkpoint."""
    bag = BagWriter(tmp_path / "bag", "sqlite3")
    connection = bag.add_topic("text", "std_msgs/msg/String", [offered_qos()])
    big = string_message("text", "x" * 10_000).cdr
    for i in range(1500):
        write_one(bag, connection, i * 1_000_000, big)
    killed = tmp_path / "killed"
    shutil.copytree(tmp_path / "bag", killed)  # as a process leaves it that is killed now
    bag.close()
    for path in (killed, killed / "bag.db3"):
        assert run("rx90_bag", ["info", str(path)]) == 2
        assert "bag.db3 was not closed" in capsys.readouterr().err
    with sqlite3.connect(killed / "bag.db3") as database:
        database.execute("CREATE TABLE opened(x)")
    database.close()
    assert run("rx90_bag", ["info", str(killed / "bag.db3")]) == 0
    assert " 1001 messages" in capsys.readouterr().out


Messages = list[tuple[str, int, bytes]]


def read_all(path: Path) -> Messages:
    """Return all messages as this project reads them."""
    with BagReader(path) as bag:
        return sorted((topic.name, log_ns, data) for topic, log_ns, data in bag.messages(bag.topics))


def read_or_refusal(path: Path) -> tuple[Messages, str]:
    """Return all messages, or why there are none."""
    try:
        return read_all(path), ""
    except BagError as error:
        return [], str(error)


def read_by_index(path: Path) -> Messages | None:
    """Return all messages as rosbags follows the file's index to them; None if it cannot."""
    try:
        with Reader(path) as reader:
            return sorted((c.topic, log_ns, bytes(data)) for c, log_ns, data in reader.messages(reader.connections))
    except Exception:
        return None


@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "foreign mcap"])
def test_a_bit_that_has_changed_is_noticed_or_does_no_harm(tmp_path: Path, kind: str) -> None:
    """Each bag with a flipped bit is refused, or gives what another reader finds by the index; ours: what was written.

    An mcap file of this project has checksums over all that leads to messages: no bit of it changes one unnoticed.
    """
    storage = kind.rpartition(" ")[2]
    if kind.startswith("foreign"):
        messages = [(f"/{x}", i, joint_state(i, [x], [1.0])) for i in range(4) for x in "ab"]
        write_ros2(tmp_path / "bag", messages, storage)
    else:
        write_joint_states(tmp_path / "bag", [series(4, topic=f"/{x}") for x in "ab"], storage=storage)
    source = next(file for file in (tmp_path / "bag").iterdir() if file.suffix != ".yaml")
    content, written = source.read_bytes(), read_all(source)
    file = tmp_path / f"flipped{source.suffix}"
    random = np.random.default_rng(1)
    noticed = 0
    for at in random.choice(len(content), 60 if storage == "sqlite3" else 200, replace=False).tolist():
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(random.integers(8))
        file.write_bytes(flipped)
        read, refusal = read_or_refusal(file)
        if refusal:
            noticed += 1
            assert refusal.startswith(f"{file}: {file.name} ")
            continue
        assert kind != "mcap" or read == written, at
        assert read_by_index(file) in (read, None), at
    assert noticed >= {"mcap": 80, "foreign mcap": 40, "sqlite3": 3}[kind]


INDEX_FAULTS = {
    "a message index": (0x07, 14, "the index of the chunk"),
    "the chunk index": (0x08, 0, "its index is not that of its chunks"),
    "the statistics": (0x0B, 0, "its statistics say"),
    "a channel of the summary": (0x04, 0, "its summary lacks channel"),
    "a channel's metadata": (0x04, 21, "is damaged: "),
    "the kind of a record in the summary": (0x04, -9, "is damaged: "),
    "the footer": (0x02, 0, "is damaged: "),
}


@pytest.mark.parametrize("fault", INDEX_FAULTS)
def test_an_index_that_leads_elsewhere_is_refused(tmp_path: Path, fault: str) -> None:
    """Without checksums, too, each record by which others find the messages is held against these."""
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


@pytest.mark.parametrize(("kind", "compress"), [("zstd", zstd.compress), ("lz4", lz4.frame.compress)])
def test_a_chunk_takes_no_more_memory_than_its_head_says(
    tmp_path: Path, kind: str, compress: Callable[[bytes], bytes]
) -> None:
    """A few kB that decompress to 64 MB are refused after some MB, and a chunk that is cut off at once."""
    file = tmp_path / "bag.mcap"
    content = compress(bytes(64 << 20))
    for cut, complaint in ((content, "a chunk is longer than 1,000 bytes"), (content[:20], "a chunk is shorter")):
        file.write_bytes(mcap_of_a_chunk(kind, cut, 1000))
        tracemalloc.start()
        try:
            with pytest.raises(BagError, match=complaint):
                read_all(file)
            assert tracemalloc.get_traced_memory()[1] < 16 << 20
        finally:
            tracemalloc.stop()


def mcap_of_a_chunk(compression: str, content: bytes, size: int) -> bytes:
    """Return an mcap file that is one chunk of `size` bytes, by its head, without an index."""
    name = compression.encode()
    chunk = struct.pack("<QQQII", 0, 0, size, 0, len(name)) + name + struct.pack("<Q", len(content)) + content
    records = ((0x01, bytes(8)), (0x06, chunk), (0x0F, bytes(4)), (0x02, bytes(20)))
    body = b"".join(struct.pack("<BQ", op, len(record)) + record for op, record in records)
    return MCAP_MAGIC + body + MCAP_MAGIC


# The list stands for that of the profile.
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.data())
@pytest.mark.parametrize("kind", [*STORAGES, "ros1"])
def test_no_other_exception(tmp_path: Path, kind: str, data: Any) -> None:
    """Whatever bytes are cut off or changed, a bag is read or refused with a BagError of one line."""
    path = tmp_path / ("bag.bag" if kind == "ros1" else "bag")
    shutil.rmtree(path, ignore_errors=True)
    path.unlink(missing_ok=True)
    if kind == "ros1":
        write_ros1(path, [("/x", i, joint_state(i, ["a"], [1.0], store=ROS1)) for i in range(20)])
    else:
        write_ros2(path, [("/x", i, joint_state(i, ["a"], [1.0])) for i in range(20)], kind)
    files = [path] if path.is_file() else sorted(path.iterdir())
    file = data.draw(st.sampled_from(files))
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(0, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    file.write_bytes(content[: data.draw(st.integers(0, len(content)))] if data.draw(st.booleans()) else content)
    message = ""
    try:
        read_joint_bag(path)
    except BagError as error:
        message = str(error)
    assert "\n" not in message
    assert not message or str(path) in message


def test_a_row_that_claims_gigabytes_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """SQLite finds too little memory for a row whose length is damaged; that is one line, too."""
    write_joint_states(tmp_path / "bag", [series(30)], storage="sqlite3")
    file = tmp_path / "bag" / "bag.db3"
    with sqlite3.connect(file) as database:
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
        (size,) = database.execute("PRAGMA page_size").fetchone()
    database.close()
    content = bytearray(file.read_bytes())
    while content[page := (root - 1) * size] == 5:  # an inner page of a table: go down to a leaf
        (cell,) = struct.unpack_from(">H", content, page + 12)
        (root,) = struct.unpack_from(">I", content, page + cell)
    (cell,) = struct.unpack_from(">H", content, page + 5)  # where the content begins
    # 4 GB in all (a varint), row 4, a head of 9 bytes: no id, 3,084 bytes as topic, which begin beyond the page.
    content[page + cell : page + cell + 12] = b"\x8f\xff\xff\xff\x7f\x04\x09\x00\xf4\x24\x00\x00"
    file.write_bytes(content)
    assert run("rx90_bag", ["info", str(file)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "bag.db3 is damaged: " in err
