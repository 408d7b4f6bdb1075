"""Make a bag from logs in columns: CSV, or separated by blanks, with a file that says what the columns hold.

In memory are 8 bytes for each number, and as many again for the series that the bag is written from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from rx90_common.bags.log_series import ReadLog, read_logs
from rx90_common.bags.mapping import LogMapping
from rx90_common.bags.writing import write_joint_states
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import plain

Progress = Callable[[int, int], None]


def _silent(_done: int, _total: int) -> None:
    """Report nothing."""


def exported_logs(folder: Path) -> list[tuple[Path, LogMapping]]:
    """Return the CSV files of a folder with the mapping files of the same names beside them, as an export writes them.

    Raises:
        BagError: if there is none, or one without a mapping.
        ConfigError: for a mapping that is not acceptable.
    """
    logs = sorted(folder.glob("*.csv"))
    if not logs:
        raise BagError(
            f"{plain(folder)}: no CSV file in it; accepted: a folder that rx90_bag export has written, as CSV"
        )
    for log in logs:
        if not log.with_suffix(".yaml").is_file():
            raise BagError(
                f"{plain(log)}: no {plain(log.with_suffix('.yaml').name)} beside it, which says what it holds"
            )
    pairs = [(log, LogMapping.load(log.with_suffix(".yaml"))) for log in logs]
    for _, mapping in pairs:
        if not mapping.exact:
            raise BagError(
                f"{plain(mapping.file)}: exact is not true; accepted in a folder: what rx90_bag export has written"
            )
    return pairs


def import_logs(
    logs: Sequence[tuple[Sequence[Path], LogMapping]],
    bag: Path,
    *,
    skip_corrupt: bool = False,
    storage: str = "mcap",
    progress: Progress = _silent,
) -> list[ReadLog]:
    """Write a bag with the joint states and temperatures that logs in columns hold.

    Args:
        logs: files with what their columns hold; of several files of one mapping the rows belong together, one by one.
        bag: folder to make; must not exist.
        skip_corrupt: whether rows that are damaged are left out; otherwise they are refused.
        storage: "mcap" or "sqlite3".
        progress: called with the numbers of bytes that are read and that there are.

    Raises:
        BagError: if a log cannot be read, does not fit its mapping or holds damaged rows, or a topic comes twice.
        BagWriteError: if the bag cannot be written.
    """
    total = sum(path.stat().st_size for paths, _ in logs for path in paths if path.is_file())
    done = 0

    def more(count: int) -> None:
        nonlocal done
        done = min(done + count, total)
        progress(done, total)

    read = [read_logs(paths, mapping, more, skip_corrupt=skip_corrupt) for paths, mapping in logs]
    write_joint_states(bag, [series for _, found in read for series in found], storage=storage)
    return [done_with for done_with, _ in read]
