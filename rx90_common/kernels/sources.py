"""The source files that decide on compiled code."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

from rx90_common.base.share import PACKAGES, ROOT, project_files

_CONSTANTS = re.compile(
    r"^from (\S+) import \(?\s*(?:\w+(?: as \w+)?,\s+)*[A-Z][A-Z0-9_]*\b", re.MULTILINE
)
"""An import of a constant, whose name is in capitals."""


@cache
def module_file(name: str) -> Path | None:
    """Return the file of a module of this project, None for any other name."""
    parts = name.split(".")
    if parts[0] not in PACKAGES:
        return None
    path = ROOT.joinpath(*parts)
    return next(
        (file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None
    )


def files_with_kernels() -> list[Path]:
    """Return the source files that decide on compiled code, sorted.

    They are those of kernels, which import `rx90_common.kernels.compiled`, and those from which these import constants.
    Others, such as the models of files, have no part in it.
    """
    importing = re.compile(r"^from rx90_common\.kernels\.compiled ", re.MULTILINE)
    todo = [file for file in project_files() if importing.search(file.read_text(encoding="utf-8"))]
    todo += (ROOT / "rx90_common/kernels").glob("*.py")
    files: set[Path] = set()
    while todo:
        file = todo.pop()
        if file not in files:
            files.add(file)
            sources = map(module_file, _CONSTANTS.findall(file.read_text(encoding="utf-8")))
            todo.extend(source for source in sources if source is not None)
    return sorted(files)
