"""What bags that are made of arrays need: the messages of series, and a name when the bag is whole."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from rx90_common.bags.batch import Int64Array, MessageBatch
from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.temperatures import TemperatureEncoder
from rx90_common.base.errors import DISK_ERRORS, BagError, BagWriteError, check_bag_name
from rx90_common.base.quoting import plain
from rx90_common.exchange.joint_state_cdr import JointStateCodec
from rx90_common.process.files import hidden_beside


@contextmanager
def named_at_the_end(path: Path) -> Iterator[Path]:
    """Yield where to write a bag, which the storage file is named after, and give it its name when that is done.

    Raises:
        BagError: if something has that name, it is too long, or its place does not take a folder.
        BagWriteError: if the disk is full.
    """
    if os.path.lexists(path):
        raise BagError(f"{plain(path)} exists already, not overwriting.")
    check_bag_name(path)
    made = [folder for folder in path.parents if not folder.exists()]
    hidden = ExitStack()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = hidden.enter_context(hidden_beside(path))
    except OSError as error:
        kind = BagWriteError if error.errno in DISK_ERRORS else BagError
        raise kind(f"{plain(path)}: cannot be written ({error.strerror})") from error
    beside = folder / path.name
    try:
        yield beside
        beside.rename(path)
    except OSError as error:
        if os.path.lexists(path):  # somebody else was faster
            raise BagError(f"{plain(path)} exists already, not overwriting.") from error
        kind = BagWriteError if error.errno in DISK_ERRORS else BagError
        raise kind(f"{plain(path)}: cannot be written ({error.strerror})") from error
    finally:
        hidden.close()
        _remove_empty(made)


def _remove_empty(folders: Sequence[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


def encoded(
    encoders: Sequence[Callable[[Int64Array], MessageBatch]], source: Int64Array, row: Int64Array
) -> MessageBatch:
    """Return the messages with these places in these sources, in this order.

    Args:
        encoders: of each source, that give its messages of some rows.
        source: of each message, int64 (n,).
        row: of it in its source, int64 (n,).
    """
    by_source = np.argsort(source, kind="stable")
    found, counts = np.unique(source, return_counts=True)
    parts = np.split(row[by_source], np.cumsum(counts)[:-1])
    batch = MessageBatch.join([encoders[which](part) for which, part in zip(found, parts, strict=True)])
    place = np.empty_like(by_source)
    place[by_source] = np.arange(len(by_source))
    return MessageBatch(batch.data, batch.start[place], batch.size[place])


def series_encoder(series: JointSeries) -> JointStateEncoder | TemperatureEncoder:
    """Return what gives the messages of a series."""
    return JointStateEncoder(series) if series.temperature is None else TemperatureEncoder(series)


class JointStateEncoder:
    """Gives the messages of a series of joint states.

    Attributes:
        stamp_ns: of each message, int64 (n,).
    """

    def __init__(self, series: JointSeries) -> None:
        self._codec = JointStateCodec(series.names)
        self._series = series
        self.stamp_ns = series.stamp_ns

    def encode(self, rows: Int64Array) -> MessageBatch:
        """Return the messages of these rows."""
        series = self._series
        fields = (None if field is None else field[rows] for field in (series.position, series.velocity, series.effort))
        data = self._codec.encode_many(series.stamp_ns[rows], *fields)
        count, size = data.shape
        return MessageBatch(data.reshape(-1), np.arange(count) * size, np.full(count, size))
