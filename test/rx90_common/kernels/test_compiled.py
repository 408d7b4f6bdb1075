"""The cache of compiled kernels never serves stale code, and compilation is announced."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from rx90_common.base.sources import PACKAGES, ROOT, importers_of, with_imports


def run(program: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run a program that finds modules, and has its cache, in the folder."""
    path = os.pathsep.join([str(folder), str(ROOT)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=120, check=True
    )


def test_all_that_a_kernel_reads_decides_on_the_cache() -> None:
    """The cache folder depends on each file that defines a kernel, also far from the others, and on what it imports."""
    files = {str(file.relative_to(ROOT)) for file in with_imports(importers_of("rx90_common.kernels"))}
    defining = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if re.search(r"^@(kernel$|inlined$|c_function)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert {"rx90_sim/plant_step.py", "rx90_common/description/wrist.py"} <= defining
    assert defining <= files
    assert "rx90_common/friction/element.py" in files  # holds the type of a record, and no kernel
    assert "rx90_sim/node/simulation.py" not in files


def test_compilation_at_import_is_announced_too(tmp_path: Path) -> None:
    """The codec's functions, compiled when it is imported, are announced, and are in the cache for the next start."""
    program = (
        "from rx90_common.kernels.announcement import announce_compilation\n"
        "announce_compilation('program')\n"
        "import rx90_common.exchange.frame, rx90_common.exchange.arrivals\n"
    )
    said = [run(program, tmp_path).stderr for _ in range(2)]
    assert re.fullmatch(r"program: compiling the numerical kernels, .*\n", said[0])
    assert said[1] == ""


def test_compilation_is_announced_once_and_only_when_it_happens(tmp_path: Path) -> None:
    """A program says once that it compiles, whatever else is in the cache; with its kernels there, nothing."""
    kernels = "from rx90_common.kernels.compiled import kernel\n\n" + "".join(
        f"@kernel\ndef {name}(x):\n    return x + 1.0\n\n\n" for name in ("first", "second")
    )
    (tmp_path / "their_kernels.py").write_text(kernels)
    # The codec's own functions are compiled, and in the cache, when it is imported.
    program = (
        "import rx90_common.exchange.joint_state_cdr\n"
        "from rx90_common.kernels.announcement import announce_compilation\n"
        "announce_compilation('program')\n"
        "import their_kernels\n"
        "print(their_kernels.first(1.0), their_kernels.second(1.0))\n"
    )
    said = []
    for _ in range(2):
        done = run(program, tmp_path)
        assert done.stdout == "2.0 2.0\n"
        said.append(done.stderr)
    assert re.fullmatch(r"program: compiling the numerical kernels, .*\n", said[0])
    assert said[1] == ""
