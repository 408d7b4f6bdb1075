"""Values that were identified among those of a file's block: each key says where its value comes from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

_ABOUT = ("provenance", "source")
_REST = "others"
"""Stands for the keys that are not named."""


class Identified(NamedTuple):
    """A value to write: plain data, the provenance of it, and the sentence that names its source."""

    value: Any
    provenance: str
    source: str


def marked(block: Mapping[str, Any], new: Mapping[str, Identified]) -> dict[str, Any]:
    """Return a block with new values; where not all keys have one `provenance` or `source`, these name the keys."""
    content = {key: value for key, value in block.items() if key not in (*_ABOUT, "note")}
    content |= {key: one.value for key, one in new.items()}
    about = {}
    for word in _ABOUT:
        given = block.get(word)
        each = {key: given.get(key, given.get(_REST)) if isinstance(given, dict) else given for key in content}
        each |= {key: getattr(one, word) for key, one in new.items()}
        if any(value is not None for value in each.values()):
            about[word] = _named(each)
    note = {"note": block["note"]} if "note" in block else {}
    return about | note | content


def _named(each: Mapping[str, str | None]) -> str | dict[str, str] | None:
    """Return what all keys have, or a mapping; what most of several keys have stands under `others`."""
    (most, count), *rest = Counter(each.values()).most_common()
    if not rest:
        return most
    said = {key: value for key, value in each.items() if value is not None}
    if most is None or len(said) < len(each) or count == rest[0][1]:
        return said
    return {**{key: value for key, value in said.items() if value != most}, _REST: most}
