"""A log in columns as a storage file of a bag, so that whoever reads bags reads CSV, Parquet and NPZ as they are."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path

import numpy as np

from rx90_common.bags.batch import series_encoder
from rx90_common.bags.log_series import read_logs
from rx90_common.bags.mapping import LogMapping, mapping_of
from rx90_common.bags.storage_files import FileTopic, LoggedMessage

_ROWS_AT_ONCE = 8192


class TableFile:
    """A log in columns that was read into memory.

    Args:
        path: of the log.
        mapping: what its columns hold; by default as the file beside it says.

    Attributes:
        effort_units: of topics whose efforts are not in the unit that their names say.

    Raises:
        BagError: if it cannot be read, does not fit its mapping or holds damaged rows.
        ConfigError: if its mapping is not acceptable.
    """

    compression = ""

    def __init__(self, path: Path, mapping: LogMapping | None) -> None:
        self.kind = path.suffix.lower().removeprefix(".")
        _, self._series = read_logs([path], mapping_of(path, mapping), lambda _: None, skip_corrupt=False)
        self.topics = [
            FileTopic(key, one.topic, one.msgtype, "cdr", one.messages) for key, one in enumerate(self._series)
        ]
        self.effort_units = {one.topic: one.effort_unit for one in self._series if one.effort_unit}

    def close(self) -> None:
        """Close nothing: it was read."""

    def messages(self, keys: Collection[int]) -> Iterator[LoggedMessage]:
        """Yield the messages of these topics in the order of their stamps."""
        yield from heapq.merge(*map(self._messages, sorted(keys)), key=itemgetter(1))

    def _messages(self, key: int) -> Iterator[LoggedMessage]:
        part = series_encoder(self._series[key])
        for begin in range(0, len(part.stamp_ns), _ROWS_AT_ONCE):
            rows = np.arange(begin, min(begin + _ROWS_AT_ONCE, len(part.stamp_ns)))
            for stamp_ns, data in zip(part.stamp_ns[rows].tolist(), part.encode(rows), strict=True):
                yield key, stamp_ns, data
