"""Write the joint states and temperatures of a bag as tables, block by block."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rx90_common.bags.exporting.blocks import read_blocks
from rx90_common.bags.exporting.tables import FORMATS, TableFile
from rx90_common.bags.reading import picked
from rx90_common.bags.storage import BagReader, BagTopic
from rx90_common.base.errors import BagError, write_error
from rx90_common.base.quoting import listed, plain
from rx90_common.process.files import hidden_beside

_OTHERS = (".mat", ".xls", ".xlsx", ".txt", ".tsv", ".json", ".gz", ".zip", ".h5", ".feather")  # no folder's name
_ONE_TOPIC = (".csv", ".parquet")


@dataclass(frozen=True)
class ExportedBag:
    """What an export has done.

    Attributes:
        files: that were written.
        topics: names and numbers of messages.
        left_out: topics that hold no joint states or temperatures, or no messages.
    """

    files: tuple[Path, ...]
    topics: tuple[tuple[str, int], ...]
    left_out: tuple[str, ...]


def export_bag(
    path: Path,
    output: Path,
    *,
    topics: Sequence[str] | None = None,
    kind: str = ".csv",
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> ExportedBag:
    """Write JointState and Temperature topics of a bag as tables. Who interrupts it leaves nothing behind.

    Args:
        path: a bag.
        output: file, whose suffix says the format, or a folder, which gets a file for each topic; new.
        topics: topic names; by default all that hold messages.
        kind: suffix of the files in a folder.
        progress: called with the numbers of messages that are written and that there are.

    Raises:
        BagError: if the bag cannot be read, has no such topic, or a topic that no table can hold.
        Rx90Error: if the files cannot be written.
    """
    single = output.suffix.lower() in FORMATS
    if single:
        kind = output.suffix.lower()
    elif output.suffix.lower() in _OTHERS:
        raise BagError(f"{plain(output)}: the suffix says the format; accepted: {listed(FORMATS)}, or none")
    with BagReader(path) as bag:
        chosen, left_out = _choose(bag, topics)
        counts = {topic.name: topic.count for topic in chosen}
        if not single:
            plan = {f"{_file_name(name)}{kind}": [name] for name in counts}
        elif kind in _ONE_TOPIC and len(chosen) > 1:
            what = f"{plain(output)} would hold {len(chosen)} topics, {listed(counts)}"
            raise BagError(f"{what}; accepted: one, with --topic, or the name of a folder")
        else:
            plan = {output.name: list(counts)}
        with named_when_done(output, single=single) as folder:
            _write(bag, chosen, {folder / name: held for name, held in plan.items()}, progress)
            names = sorted(file.name for file in folder.iterdir())
    place = output.parent if single else output
    return ExportedBag(tuple(place / name for name in names), tuple(counts.items()), left_out)


def _file_name(topic: str) -> str:
    return topic.removeprefix("/").replace("/", ".")


def _write(
    bag: BagReader, topics: Sequence[BagTopic], plan: Mapping[Path, Sequence[str]], progress: Callable[[int, int], None]
) -> None:
    total, done = sum(topic.count for topic in topics), 0
    with ExitStack() as open_files:
        files: dict[str, TableFile] = {}
        for path, held in plan.items():
            file = FORMATS[path.suffix.lower()](path)
            open_files.callback(file.close)
            files |= dict.fromkeys(held, file)
        for series in read_blocks(bag, topics):
            files[series.topic].add(series)
            done += series.messages
            progress(done, total)


def _choose(bag: BagReader, topics: Sequence[str] | None) -> tuple[list[BagTopic], tuple[str, ...]]:
    if topics is not None:
        chosen = picked(bag.path, bag.topics, topics)
        for topic in chosen:
            if not topic.count:
                raise BagError(f"{plain(bag.path)}: no messages in {plain(topic.name)}")
        return chosen, ()
    chosen = [topic for topic in bag.topics if topic.holds_series and topic.count]
    if not chosen:
        there = listed(t.name for t in bag.topics) or "nothing"
        raise BagError(f"{plain(bag.path)}: holds no joint states or temperatures, only {there}")
    return chosen, tuple(topic.name for topic in bag.topics if topic not in chosen)


@contextmanager
def named_when_done(output: Path, *, single: bool) -> Iterator[Path]:
    """Yield a new folder beside the output; at the end it gets the output's name, or its files go where that stands."""
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with hidden_beside(output) as hidden:
            folder = hidden / "files"
            folder.mkdir()
            yield folder
            if not single:
                folder.rename(output)
            else:
                for file in folder.iterdir():
                    _give_free_name(file, output.parent / file.name)
    except OSError as error:
        if os.path.lexists(output):  # somebody else was faster
            raise BagError(f"{plain(output)} exists already, not overwriting.") from error
        raise write_error(output, error) from error


def _give_free_name(file: Path, name: Path) -> None:
    """Give a file a name that nothing has; a rename would replace what another process has written meanwhile."""
    try:
        os.link(file, name)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        if name.exists():
            raise
        file.rename(name)
