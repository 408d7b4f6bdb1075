"""The cache of compiled kernels never serves stale code."""

from __future__ import annotations

import re
from pathlib import Path

from rx90_common import compiled


def test_every_room_with_a_kernel_decides_on_the_cache() -> None:
    """A change in any file that defines a kernel, or is called by one, gives another cache folder."""
    root = Path(compiled.__file__).resolve().parent.parent
    rooms = {
        path.relative_to(root).parts[0]
        for path in root.glob("*/**/*.py")
        if re.search(r"^@(kernel|inlined)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert {"rx90_sim", "rx90_description"} <= rooms
    assert rooms - {"test", "benchmarks"} <= set(compiled._ROOMS)
