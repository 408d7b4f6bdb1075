"""Write bags of series that come block by block, in memory that does not grow with them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from rx90_common.bags.joint_series import JointSeries
from rx90_common.bags.topics import absolute
from rx90_common.bags.whole import encoded, named_at_the_end, series_encoder
from rx90_common.bags.writing import BagWriter, offered_qos
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, plain


def write_blocks(
    path: Path, topics: Sequence[str], blocks: Sequence[Iterator[JointSeries]], storage: str = "mcap"
) -> list[int]:
    """Write the bag that `write_joint_states` would of the same series, block by block.

    Args:
        path: folder to make; must not exist.
        topics: names, each once.
        blocks: of each topic, in the order of stamps.
        storage: "mcap" or "sqlite3".

    Returns:
        The number of messages of each topic.

    Raises:
        BagError: if the bag cannot be made, or two topics have one name.
        BagWriteError: if it cannot be written on; nothing stays.
        ExchangeError: if a joint name or a stamp cannot stand in a message.
    """
    names = [absolute(topic) for topic in topics]
    if len(set(names)) != len(names):
        raise BagError(f"{plain(path)}: topics {listed(names)}; accepted: each topic once")
    with named_at_the_end(path) as beside, BagWriter(beside, storage, named=path) as bag:
        sources = [_Source(each) for each in blocks]
        kinds = zip(names, (source.msgtype for source in sources), strict=True)
        numbers = np.array([bag.add_topic(name, kind, [offered_qos()]).id for name, kind in kinds], dtype=np.int64)
        for name, each in zip(names, sources, strict=True):
            bag.say_unit(name, each.effort_unit)
        written = np.zeros(len(names), dtype=np.int64)
        for series in _merged(sources):
            parts = [series_encoder(one) for one in series]
            log_ns = np.concatenate([part.stamp_ns for part in parts])
            if not len(log_ns):  # rows of temperatures without any
                continue
            order = np.argsort(log_ns, kind="stable")
            counts = [len(part.stamp_ns) for part in parts]
            source = np.repeat(np.arange(len(parts)), counts)[order]
            row = np.concatenate([np.arange(count) for count in counts])[order]
            bag.write_many(numbers[source], log_ns[order], encoded([part.encode for part in parts], source, row))
            written += counts
        return written.tolist()


class _Source:
    """What has come of a topic and is still to be written, and the block behind it."""

    def __init__(self, blocks: Iterator[JointSeries]) -> None:
        self._blocks = blocks
        self._waiting = next(blocks)
        self.following = next(blocks, None)

    @property
    def msgtype(self) -> str:
        """Return the type of the topic's messages."""
        return self._waiting.msgtype

    @property
    def effort_unit(self) -> str:
        """Return the unit of the topic's efforts where its name does not say it."""
        return self._waiting.effort_unit

    def take(self, before_ns: int | None) -> JointSeries:
        """Return what has an earlier stamp, or all, and keep the rest."""
        stamps = self._waiting.stamp_ns
        count = len(stamps) if before_ns is None else int(np.searchsorted(stamps, before_ns))
        taken, self._waiting = self._waiting.take(slice(0, count)), self._waiting.take(slice(count, None))
        return taken

    def advance(self) -> None:
        """Put the block that follows behind what is waiting."""
        if self.following is not None:
            self._waiting = _joined(self._waiting, self.following)
            self.following = next(self._blocks, None)


def _joined(first: JointSeries, second: JointSeries) -> JointSeries:
    stamps = np.concatenate([first.stamp_ns, second.stamp_ns])
    fields: dict[str, Any] = {f: np.concatenate([values, second.fields[f]]) for f, values in first.fields.items()}
    return replace(first, stamp_ns=stamps, **fields)


def _merged(sources: Sequence[_Source]) -> Iterator[list[JointSeries]]:
    """Yield a part of each series, none of whose messages comes behind a message of a later part."""
    while True:
        follow = [int(one.following.stamp_ns[0]) for one in sources if one.following is not None]
        before = min(follow) if follow else None
        parts = [one.take(before) for one in sources]
        if any(len(part.stamp_ns) for part in parts):
            yield parts
        if before is None:
            return
        for one in sources:
            if one.following is not None and int(one.following.stamp_ns[0]) == before:
                one.advance()
