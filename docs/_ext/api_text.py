"""Makes reStructuredText of docstrings that are written for `help()`: code in back ticks, bars, the overview."""

from __future__ import annotations

import re
from typing import Any

from sphinx.application import Sphinx

_GROUP = re.compile(r"^(\w[\w ]*?) {2,}(\S.*)$|^(Series and bags|Identification) (\S.*)$")


def _overview(lines: list[str]) -> list[str]:
    """Return the module's docstring with its example as code, and its groups of names as a list of links."""
    found: list[str] = []
    code = False
    for line in lines:
        group = _GROUP.match(line)
        code = code and (line.startswith("    ") or not line)
        if group:
            names = group[2] or group[4]
            found += [f"- **{group[1] or group[3]}**: {_linked(names)}"]
        elif line.startswith("    ") and not code and found[-1].startswith(("- **", "  ")):
            found += [f"  {_linked(line.strip())}"]
        elif line.startswith("    ") and not code:
            code = True
            found += ["::", "", line]
        else:
            found.append(line)
    return found


def _linked(text: str) -> str:
    import rx90_emulator

    return re.sub(
        r"\w+",
        lambda word: f":obj:`{word[0]}`" if word[0] in rx90_emulator.__all__ else word[0],
        text,
    )


def _rewrite(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:  # noqa: ARG001 - Sphinx hands them over
    if what == "module":
        lines[:] = _overview(lines)
        return
    code = False
    for k, line in enumerate(lines):
        code = line.startswith("    ") and (code or (k > 0 and not lines[k - 1].strip()))
        lines[k] = line.replace("|", "\\|")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect it; before napoleon, which reads the sections."""
    app.connect("autodoc-process-docstring", _rewrite, priority=100)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
