"""A bag's metadata.yaml: which files it has, and how many messages of what."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from rx90_common.bags.files.contents import full_type
from rx90_common.base.config import load_yaml
from rx90_common.base.errors import BagError, ConfigError
from rx90_common.base.quoting import plain

FILE = "metadata.yaml"

EFFORT_UNIT = "rx90_emulator effort unit of "
"""Begins the key in rosbag2's custom_data that says in which unit the efforts of a topic are."""
_MOST_MESSAGES = 1 << 62


@dataclass(frozen=True)
class BagMetadata:
    """What metadata.yaml says; quality of service and times are not looked at.

    Attributes:
        files: names of the storage files, in their order.
        counts: messages by topic name and type, without those that have none.
        total: messages in all.
        effort_units: of topics whose efforts are not in the unit that their names say.
    """

    files: tuple[str, ...]
    counts: Counter[tuple[str, str]]
    total: int
    effort_units: dict[str, str]


def read_metadata(folder: Path) -> BagMetadata:
    """Read the metadata.yaml of a folder.

    Raises:
        BagError: naming folder, key, value and what is accepted.
    """
    try:
        root = load_yaml(folder / FILE, "the metadata of a rosbag2 folder").section("rosbag2_bagfile_information")
        counts: Counter[tuple[str, str]] = Counter()
        for topic in root.sections("topics_with_message_count"):
            about = topic.section("topic_metadata")
            count = topic.integer("message_count", 0, _MOST_MESSAGES)
            if count:
                counts[about.text("name"), full_type(about.text("type"))] += count
        files = tuple(PurePosixPath(file).name for file in root.texts("relative_file_paths"))
        custom = root.content.get("custom_data")
        units = {
            str(key).removeprefix(EFFORT_UNIT): plain(value)
            for key, value in (custom.items() if isinstance(custom, dict) else ())
            if str(key).startswith(EFFORT_UNIT)
        }
        return BagMetadata(files, counts, root.integer("message_count", 0, _MOST_MESSAGES), units)
    except ConfigError as error:
        raise BagError(f"{plain(folder)}: {str(error).removeprefix(f'{plain(folder)}/')}") from error


def check_counts(path: Path, metadata: BagMetadata, held: Counter[tuple[str, str]]) -> None:
    """Compare the metadata with what the storage files hold.

    Raises:
        BagError: naming the first topic that differs.
    """
    remedy = "'ros2 bag reindex' writes it anew, and each storage file can be read by its own path"
    for key in sorted(metadata.counts.keys() | held.keys()):
        if metadata.counts[key] != held[key]:
            topic, msgtype = map(plain, key)
            raise BagError(
                f"{plain(path)}: {FILE} says {metadata.counts[key]} messages of {topic} ({msgtype}), "
                f"the storage holds {held[key]}; {remedy}"
            )
    if metadata.total != metadata.counts.total():
        raise BagError(
            f"{plain(path)}: {FILE} says {metadata.total} messages in all, "
            f"its topics add up to {metadata.counts.total()}; {remedy}"
        )
