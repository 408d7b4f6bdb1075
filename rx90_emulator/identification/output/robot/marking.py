"""Values that were identified among those of a file's block: each key says where its value comes from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

_ABOUT = ("provenance", "source", "note")


class Identified(NamedTuple):
    """A value to write: plain data, the provenance of it, and the sentence that names its source."""

    value: Any
    provenance: str
    source: str


def marked(block: Mapping[str, Any], new: Mapping[str, Identified]) -> dict[str, Any]:
    """Return a block with new values; `provenance` and `source` name every key where they differ from key to key."""
    content = {key: value for key, value in block.items() if key not in _ABOUT}
    content |= {key: one.value for key, one in new.items()}
    about = {}
    for word in _ABOUT[:2]:
        given = block.get(word)
        each = {key: given.get(key) if isinstance(given, dict) else given for key in content}
        each |= {key: getattr(one, word) for key, one in new.items()}
        different = list(dict.fromkeys(each.values()))
        said = {key: value for key, value in each.items() if value is not None}
        if said:
            about[word] = different[0] if len(different) == 1 else said
    if "note" in block:
        about["note"] = block["note"]
    return about | content
