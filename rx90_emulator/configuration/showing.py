"""What a setup comes to, as a table for people or as JSON for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from rx90_common.base.quoting import one_line
from rx90_emulator.configuration.origins import ASSUMED, ShownValue

_WIDEST = 64  # characters; a longer value moves the rest of its line to the right


def values_table(values: Sequence[ShownValue]) -> str:
    """Return a line for each value, and below them the sources by their numbers."""
    sources: dict[str, int] = {}
    rows = [("value", "", "", "from", "")]
    for one in values:
        mark = one.provenance.upper() if one.provenance == ASSUMED else one.provenance
        if one.source:
            mark += f" [{sources.setdefault(one.source, len(sources) + 1)}]"
        rows.append((one.name, _text(one.value), one.unit, one.origin, mark.strip()))
    widths = [max(len(row[k]) for row in rows if len(row[k]) <= _WIDEST) for k in range(4)]
    lines = ["  ".join((*(part.ljust(width) for part, width in zip(row, widths, strict=False)), row[4])).rstrip()
             for row in rows]  # fmt: skip
    assumed = sum(one.provenance == ASSUMED for one in values)
    lines += ["", f"{assumed} of {len(values)} values are assumed"]
    lines += [f"[{number}] {' '.join(source.split())}" for source, number in sources.items()]
    return "\n".join(one_line(line) for line in lines)


def values_json(values: Sequence[ShownValue]) -> str:
    """Return a list of objects, one for each value."""
    content = [{**one._asdict(), "value": _plain(one.value), "assumed": one.provenance == ASSUMED} for one in values]
    return json.dumps(content, indent=1, ensure_ascii=False)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else str(value)


def _plain(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    return "inf" if value == math.inf else value
