"""Write bags, from the recorder's raw messages or from arrays; needs no ROS.

rosbags' writers make the files; messages are given to them in batches, which gives the same files, byte for byte, and
additional checksums, in a fraction of the time.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Final
from zlib import crc32

import numpy as np
from rosbags.interfaces import Connection, Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rx90_common.bags.joint_series import Int64Array, JointSeries
from rx90_common.bags.topics import (
    EFFORT_UNIT,
    JOINT_STATE,
    JOINT_TRAJECTORY,
    PARAMETER_EVENT,
    POINT_FIELDS,
    STRING,
    absolute,
)
from rx90_common.base.errors import DISK_ERRORS, BagError, BagWriteError, check_bag_name
from rx90_common.base.quoting import plain
from rx90_common.base.rates import NANOSECONDS
from rx90_common.exchange.cdr import JointStateCodec
from rx90_common.process.files import hidden_folder

_RESERVE_BYTES = 64 << 20  # kept free on the disk, so that index and metadata still fit
_MESSAGES_AT_ONCE = 10_000  # in memory while arrays are written
_INFINITE = QosTime(9_223_372_036, 854_775_807)
_INTEGER = 2  # of rcl_interfaces/ParameterType
_VALUE_ARRAYS = {"byte": np.uint8, "bool": np.bool_, "integer": np.int64, "double": np.float64}
# Of mcap: op codes, and bytes.
_MESSAGE = 0x05
_CHUNK_BYTES: Final = 1 << 20  # a chunk that is larger is closed, as rosbags does
_RECORD_HEAD: Final = 9  # op code and length
_MESSAGE_HEAD: Final = np.dtype(
    {
        "names": ["code", "length", "channel", "sequence", "log_ns", "published_ns"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<u8", "<u8"],
    }
)
# at the end of a file; a checksum of 4 bytes ends the footer
_FOOTER_BYTES = 20
_MAGIC_BYTES = 8


class _McapBatches(McapWriter):
    """rosbags' mcap writer; messages come by `write_many` alone, and chunks and summary get checksums."""

    def write_many(self, channel: Int64Array, log_ns: Int64Array, messages: list[bytes]) -> None:
        """Write messages, in this order, of the channels with these numbers, int64 (n,)."""
        length = np.fromiter(map(len, messages), np.int64, len(messages))
        heads = np.zeros(len(messages), _MESSAGE_HEAD)
        heads["code"] = _MESSAGE
        heads["length"] = _MESSAGE_HEAD.itemsize - _RECORD_HEAD + length
        heads["channel"] = channel
        heads["log_ns"] = log_ns
        heads["published_ns"] = log_ns
        records = [*chain.from_iterable(zip(heads.view(f"V{heads.itemsize}").tolist(), messages, strict=True))]
        ends = np.cumsum(_MESSAGE_HEAD.itemsize + length)
        starts = ends - length - _MESSAGE_HEAD.itemsize
        begin = 0
        while begin < len(messages):
            moved = self.chunk.bio.tell() - starts[begin]
            end = min(int(np.searchsorted(ends + moved, _CHUNK_BYTES, side="right")) + 1, len(messages))
            self.chunk.bio.write(b"".join(records[2 * begin : 2 * end]))
            times = log_ns[begin:end]
            for noted in (self, self.chunk):
                noted.message_start_time = min(int(times.min()), noted.message_start_time)
                noted.message_end_time = max(int(times.max()), noted.message_end_time)
            numbers = channel[begin:end]
            places = starts[begin:end] + moved
            for number in dict.fromkeys(numbers.tolist()):  # in the order of their first messages
                those = numbers == number
                self.chunk.msgs[number] += zip(times[those].tolist(), places[those].tolist(), strict=True)
                self.channel_stats[number] += int(those.sum())
            if self.chunk.bio.tell() > _CHUNK_BYTES:
                self.close_chunk()
            begin = end

    def checkpoint(self) -> None:
        """Write pending data to the file."""
        if self.chunk.msgs:
            self.close_chunk()
        self.bio.flush()

    def close_chunk(self) -> None:
        """Write the pending chunk, and its checksum behind the record's head, two times and a length."""
        crc = crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _RECORD_HEAD + 24)
        self.bio.write(crc.to_bytes(4, "little"))
        self.bio.seek(end)

    def close(self, version: int, metadata: str) -> None:
        """Write the summary and its checksum, and close the file."""
        super().close(version, metadata)
        with self.path.open("r+b") as stream:
            stream.seek(-_FOOTER_BYTES - _MAGIC_BYTES, 2)
            stream.seek(int.from_bytes(stream.read(8), "little"))  # where the summary begins
            crc = crc32(stream.read()[: -4 - _MAGIC_BYTES])
            stream.seek(-4 - _MAGIC_BYTES, 2)
            stream.write(crc.to_bytes(4, "little"))


class _BatchWriter(Writer):
    STORAGE_PLUGINS = {StoragePlugin.MCAP: _McapBatches}  # noqa: RUF012 - as in rosbags


@cache
def typestore() -> Typestore:
    """Return the message types of ROS 2 Jazzy's common interfaces."""
    return get_typestore(Stores.ROS2_JAZZY)


def offered_qos(*, reliable: bool = True, transient_local: bool = False) -> Qos:
    """Return a publisher's quality of service as a recorder receives it: its depth is not announced."""
    return Qos(
        history=QosHistory.UNKNOWN,
        depth=0,
        reliability=QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        durability=QosDurability.TRANSIENT_LOCAL if transient_local else QosDurability.VOLATILE,
        deadline=_INFINITE,
        lifespan=_INFINITE,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_INFINITE,
        avoid_ros_namespace_conventions=False,
    )


class BagWriter:
    """A new rosbag2 folder, open from the start; `close()`, or leaving its context, makes it a valid bag.

    An error within its context before anything was written is a refusal: no folder stays. Equal calls give equal files,
    byte for byte. All calls must come from one thread.

    Args:
        path: folder to make; must not exist.
        named: final name of a bag that is renamed when it is complete; an incomplete one is removed.

    Raises:
        BagWriteError: if the disk is full.
    """

    def __init__(self, path: Path | str, *, named: Path | None = None) -> None:
        self.path = Path(path)
        self._named = named or self.path
        self._stays = named is None
        check_bag_name(self.path)
        self._second = 0  # of the newest log time
        self._opened = False
        self._closed = False
        self._has_messages = False
        self._above = [folder for folder in self.path.parents if not folder.exists()]  # made with it
        with self._failures():
            self._writer = _BatchWriter(
                self.path, version=_BatchWriter.VERSION_LATEST, storage_plugin=StoragePlugin.MCAP
            )
            self._writer.open()
        self._opened = True

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, _kind: object, error: object, _trace: object) -> None:
        if error is None:
            self.close()
        else:
            with suppress(BagError):  # the first error is the one to report
                self.close()
            if not self._has_messages:
                shutil.rmtree(self.path, ignore_errors=True)
                with suppress(OSError):
                    for folder in self._above:
                        folder.rmdir()

    def add_topic(self, topic: str, msgtype: str, qos: Sequence[Qos] = (), definition: str = "") -> Connection:
        """Announce a topic and return its connection, whose `id` `write_many` wants.

        Args:
            topic: its name.
            msgtype: a type of the common interfaces, or of the definition.
            qos: quality of service that its publishers offer.
            definition: the text of its .msg file, and behind it of those that it uses, as bags have it.

        Raises:
            BagWriteError: if the disk is full.
        """
        types = typestore()
        if definition and msgtype not in types.fielddefs:
            types = get_typestore(Stores.ROS2_JAZZY)
            types.register(get_types_from_msg(definition, msgtype))
        if msgtype not in types.fielddefs:
            raise BagError(f"{absolute(topic)} has type {msgtype}; accepted: types of ROS 2's common interfaces")
        with self._failures():
            return self._writer.add_connection(absolute(topic), msgtype, typestore=types, offered_qos_profiles=qos)

    def say_unit(self, topic: str, effort_unit: str) -> None:
        """Say in the metadata in which unit a topic's efforts are, where it is not the usual one."""
        if effort_unit:
            self._writer.set_custom_data(f"{EFFORT_UNIT}{absolute(topic)}", effort_unit)

    def write_many(self, number: Int64Array, log_ns: Int64Array, messages: list[bytes]) -> None:
        """Write serialised messages in this order; a checkpoint follows the first one of each second.

        Args:
            number: of the connection of each, as in its `id`, int64 (n,).
            log_ns: log times, int64 (n,).
            messages: n messages.

        Raises:
            BagWriteError: if the disk is full or nearly so, or writing fails otherwise.
        """
        second = np.maximum.accumulate(np.append(self._second, log_ns // NANOSECONDS))
        stops = np.flatnonzero(np.diff(second)) + 1
        writer = self._writer
        storage: Any = writer.storage
        begin = 0
        for end in dict.fromkeys([*stops.tolist(), len(messages)]):
            rows = slice(begin, end)
            begin = end
            if not messages[rows]:
                continue
            self._has_messages = True
            with self._failures():
                storage.write_many(number[rows], log_ns[rows], messages[rows])
                writer.min_timestamp = min(writer.min_timestamp, int(log_ns[rows].min()))
                writer.max_timestamp = max(writer.max_timestamp, int(log_ns[rows].max()))
                for connection, count in zip(*np.unique(number[rows], return_counts=True), strict=True):
                    writer.counts[int(connection)] += int(count)
                if end in stops:
                    storage.checkpoint()
                self._check_space(int(log_ns[end - 1]))
        self._second = int(second[-1])

    def _check_space(self, last_ns: int) -> None:
        free = shutil.disk_usage(self.path).free
        if free < _RESERVE_BYTES:
            whole = "; what was written is whole" if self._stays else ""
            raise BagWriteError(
                f"{plain(self._named)}: stopped at t = {last_ns / NANOSECONDS:.6f} s, as the disk is nearly "
                f"full ({free >> 20} MiB left; accepted: {_RESERVE_BYTES >> 20} MiB or more){whole}"
            )

    def close(self) -> None:
        """Write index and metadata. A second call does nothing.

        Raises:
            BagWriteError: if that fails; data written before stay.
        """
        if self._closed:
            return
        self._closed = True
        with self._failures():
            try:
                self._writer.close()
            except (WriterError, OSError):
                with suppress(OSError):
                    self._writer.abort()
                raise

    @contextmanager
    def _failures(self) -> Iterator[None]:
        try:
            yield
        except WriterError as error:
            raise BagError(plain(error, 1000)) from error
        except OSError as error:
            # What is refused before anything is written is the user's to mend: another folder, another name.
            failed = self._opened or error.errno in DISK_ERRORS
            half = "; what was written before stays" if self._opened and self._stays else ""
            text = f"{plain(self._named)}: cannot be written ({error.strerror}){half}"
            raise (BagWriteError if failed else BagError)(text) from error


@dataclass(frozen=True)
class RawMessage:
    """A message of any type for `write_joint_states`.

    Attributes:
        topic: topic name.
        msgtype: e.g. std_msgs/msg/String.
        log_ns: log time in ns.
        cdr: the serialised message.
        transient_local: whether its publisher keeps it for those who come late.
    """

    topic: str
    msgtype: str
    log_ns: int
    cdr: bytes
    transient_local: bool = False


def _latched(topic: str, msgtype: str, log_ns: int, message: Any) -> RawMessage:
    return RawMessage(topic, msgtype, log_ns, bytes(typestore().serialize_cdr(message, msgtype)), transient_local=True)


def string_message(topic: str, text: str) -> RawMessage:
    """Return a latched std_msgs/String, such as robot_description."""
    return _latched(topic, STRING, 0, typestore().types[STRING](data=text))


def parameters_message(topic: str, node: str, values: Mapping[str, int]) -> RawMessage:
    """Return the latched rcl_interfaces/ParameterEvent of a node with whole numbers at the start of its run."""
    types = typestore().types
    empty: dict[str, Any] = {f"{kind}_array_value": np.zeros(0, dtype) for kind, dtype in _VALUE_ARRAYS.items()}
    new = []
    for name, number in values.items():
        value = types["rcl_interfaces/msg/ParameterValue"](
            type=_INTEGER, bool_value=False, integer_value=number, double_value=0.0, string_value="",
            string_array_value=[], **empty,
        )  # fmt: skip
        new.append(types["rcl_interfaces/msg/Parameter"](name, value))
    message = types[PARAMETER_EVENT](types["builtin_interfaces/msg/Time"](0, 0), node, new, [], [])
    return _latched(topic, PARAMETER_EVENT, 0, message)


def trajectory_message(topic: str, start_ns: int, content: dict[str, Any]) -> RawMessage:
    """Return a latched trajectory_msgs/JointTrajectory that starts at `start_ns`, from its content as YAML has it."""
    types = typestore().types
    points = []
    for values in content["points"]:
        vectors = (np.array(values.get(name) or [], dtype=np.float64) for name in POINT_FIELDS)
        since = types["builtin_interfaces/msg/Duration"](**values["time_from_start"])
        points.append(types["trajectory_msgs/msg/JointTrajectoryPoint"](*vectors, since))
    stamp = types["builtin_interfaces/msg/Time"](*divmod(start_ns, NANOSECONDS))
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
    return _latched(topic, JOINT_TRAJECTORY, start_ns, types[JOINT_TRAJECTORY](header, content["joint_names"], points))


@contextmanager
def named_at_the_end(path: Path) -> Iterator[Path]:
    """Yield a new folder for a file or folder of this name and its companions; then these are moved to their places.

    Raises:
        BagWriteError: if the disk is full.
    """
    missing_folders = [folder for folder in path.parents if not folder.exists()]
    try:
        if os.path.lexists(path):
            raise FileExistsError
        path.parent.mkdir(parents=True, exist_ok=True)
        with hidden_folder(path) as folder:
            yield folder
            for made in folder.iterdir():
                target = path.parent / made.name
                try:
                    if made.is_dir():
                        made.rename(target)
                    else:  # a file that another process has written meanwhile stays
                        os.link(made, target)
                except OSError:  # also of a file system without hard links
                    if os.path.lexists(target):
                        raise
                    made.rename(target)
    except OSError as error:
        if os.path.lexists(path):  # also if somebody else was faster
            raise BagError(f"{plain(path)} exists already, not overwriting.") from error
        kind = BagWriteError if error.errno in DISK_ERRORS else BagError
        raise kind(f"{plain(path)}: cannot be written ({error.strerror})") from error
    finally:
        with suppress(OSError):  # the folders of the new file
            for folder in missing_folders:
                folder.rmdir()


def write_joint_states(
    path: Path | str,
    series: Sequence[JointSeries],
    *,
    messages: Sequence[RawMessage] = (),
) -> None:
    """Write a bag as if nodes had published these series and the recorder had recorded them.

    It is written beside its place and renamed at the end: an interrupt, a kill or a full disk
    leaves no part of a bag under that name.

    The messages are in the order of log time, which is their stamp; at equal times in the order of
    `series`, then of `messages`.

    Args:
        path: folder to make; must not exist.
        series: one per topic.
        messages: further messages of the bag.

    Raises:
        BagError: if the bag cannot be made, or two series share a topic.
        BagWriteError: if it cannot be written.
        ExchangeError: for a joint name or a stamp that a message cannot contain.
    """
    path = Path(path)
    topics = [absolute(part.topic) for part in series]
    if len(set(topics)) != len(topics):
        raise BagError(f"{path}: topics {', '.join(topics)}; accepted: each topic once")
    check_bag_name(path)
    with named_at_the_end(path) as folder, BagWriter(folder / path.name, named=path) as bag:
        numbers = [bag.add_topic(topic, JOINT_STATE, [offered_qos()]).id for topic in topics]
        for part in series:
            bag.say_unit(part.topic, part.effort_unit)
        numbers_of: dict[str, int] = {}
        for message in messages:
            if message.topic not in numbers_of:
                qos = offered_qos(transient_local=message.transient_local)
                numbers_of[message.topic] = bag.add_topic(message.topic, message.msgtype, [qos]).id
        encoders: list[Callable[[Int64Array], list[bytes]]] = [*map(_encoder, series)]
        encoders.append(lambda rows: [messages[row].cdr for row in rows.tolist()])
        stamps = [*(part.stamp_ns for part in series), np.array([message.log_ns for message in messages], np.int64)]
        counts = [len(stamp) for stamp in stamps]
        log_ns = np.concatenate(stamps)
        source = np.repeat(np.arange(len(counts)), counts)
        row = np.concatenate([np.arange(count) for count in counts])
        number = np.repeat(numbers, counts[:-1])
        number = np.concatenate([number, [numbers_of[message.topic] for message in messages]]).astype(np.int64)
        order = np.argsort(log_ns, kind="stable")
        for begin in range(0, len(order), _MESSAGES_AT_ONCE):
            rows = order[begin : begin + _MESSAGES_AT_ONCE]
            block = np.empty(len(rows), dtype=object)
            for k, encode in enumerate(encoders):
                block[source[rows] == k] = encode(row[rows[source[rows] == k]])
            bag.write_many(number[rows], log_ns[rows], block.tolist())


def _encoder(series: JointSeries) -> Callable[[Int64Array], list[bytes]]:
    """Return a function that returns the messages of some rows of a series."""
    codec = JointStateCodec(series.names)

    def encode(rows: Int64Array) -> list[bytes]:
        part = series.take(rows)
        data = codec.encode_many(part.stamp_ns, part.position, part.velocity, part.effort)
        messages: list[bytes] = data.view(f"V{data.shape[1]}")[:, 0].tolist()
        return messages

    return encode
