"""The cache of compiled kernels never serves stale code, and compilation is announced."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numba
import pytest
from processes import TIMEOUT, files_up_to, wait_until

from rx90_common.base.share import PACKAGES, ROOT, importers_of, with_imports
from rx90_common.kernels import compiled
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.elementary import exponential, exponential_of

ANNOUNCED = r"program: compiling the numerical kernels, .*\n"
ANNOUNCE = "from rx90_common.kernels import announce_compilation\nannounce_compilation('program')\n"
SLOW_KERNEL = """
import os, pathlib, time
import numba
from numba.core.event import RecordingListener, register
from rx90_common.kernels.compiled import kernel

class Begun(RecordingListener):
    def on_start(self, event):
        super().on_start(event)
        pathlib.Path(os.environ["BEGUN"]).touch()
        if os.environ["THEN"] == "hang":
            time.sleep(600.0)
        if os.environ["THEN"] == "slow":
            while not pathlib.Path("there").exists():
                time.sleep(0.01)
            time.sleep(3.0)  # in which the other process, which is there, comes from its call to the cache

begun = Begun()
register("numba:compile", begun)

@kernel
def one_more(x):
    return x + 1.0

def compiled():
    return sum(record.is_start for _, record in begun.buffer)
"""
FOUR_WEEKS = 28 * 24 * 3600.0


def start(program: str, folder: Path, **variables: str) -> subprocess.Popen[str]:
    """Start a program that finds modules in the folder, and has its cache beside it."""
    path = os.pathsep.join([str(folder), str(ROOT)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder.parent / "cache"), "PYTHONPATH": path, **variables}
    words, pipe = [sys.executable, "-c", program], subprocess.PIPE
    return subprocess.Popen(words, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True)


def said(running: subprocess.Popen[str]) -> tuple[str, str]:
    """Return standard output and error of a program once it has ended well."""
    out, err = running.communicate(timeout=TIMEOUT)
    assert running.returncode == 0, err
    return out, err


def test_all_that_a_kernel_reads_decides_on_the_cache() -> None:
    """The cache folder depends on each file that defines a kernel, also far from the others, and on what it imports."""
    files = {str(file.relative_to(ROOT)) for file in with_imports(importers_of("rx90_common.kernels"))}
    defining = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if re.search(r"^@(kernel$|inlined$|c_function)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert {"rx90_sim/plant_step.py", "rx90_common/description/coupling.py"} <= defining
    assert defining <= files
    assert "rx90_common/friction/element.py" in files  # holds the type of a record, and no kernel
    assert "rx90_sim/node/simulation.py" not in files


def test_an_inlined_function_is_called_by_kernels_alone() -> None:
    """From Python it is a plain error, not a jump to a wrapper that was never compiled."""
    with pytest.raises(TypeError, match="exponential is compiled into its callers; accepted: a call from a kernel"):
        exponential(1.0)


def copy_sources(folder: Path) -> Path:
    """Copy the sources of the ground into a folder, with times of their own; return the folder."""
    shutil.copytree(ROOT / "rx90_common", folder / "rx90_common", ignore=shutil.ignore_patterns("__pycache__"))
    for file in folder.rglob("*.py"):
        os.utime(file)
    return folder


def test_copies_of_the_same_sources_share_compiled_code(tmp_path: Path) -> None:
    """A second clone compiles nothing; another processor, and a change in a function that a kernel calls, do.

    That holds for kernels and for the codec, whose functions are compiled when it is imported. A program says once that
    it compiles, whatever else is in the cache; with its kernels there, nothing.
    """
    kernels = "from rx90_common.kernels.elementary import {0}\nprint({0}(0.0))\n"
    exponential, other = kernels.format("exponential_of"), kernels.format("exponential_less_one_of")
    codec = "from rx90_common.exchange import arrivals, cdr\nprint('imported', file=sys.stderr)\n"
    one, two = copy_sources(tmp_path / "one"), copy_sources(tmp_path / "two")
    out, err = said(start(f"import sys\n{ANNOUNCE}{codec}{exponential}", one))
    assert out == "1.0\n"
    assert re.fullmatch(f"{ANNOUNCED}imported\n", err)
    there = f"import sys\n{ANNOUNCE}{codec}{exponential}print('computed', file=sys.stderr)\n{other}"
    assert re.fullmatch(f"imported\ncomputed\n{ANNOUNCED}", said(start(there, two))[1])
    assert re.fullmatch(ANNOUNCED, said(start(ANNOUNCE + exponential, two, NUMBA_CPU_NAME="generic"))[1])
    called = two / "rx90_common/kernels/elementary.py"
    text = called.read_text(encoding="utf-8")
    assert "1.0 + _grown(r)" in text
    called.write_text(text.replace("1.0 + _grown(r)", "2.0 + _grown(r)"), encoding="utf-8")
    out, err = said(start(ANNOUNCE + exponential, two))
    assert out == "2.0\n"
    assert re.fullmatch(ANNOUNCED, err)


def test_code_of_two_processes_at_once_is_not_mixed_up(tmp_path: Path) -> None:
    """Where two processes save code of a function for two signatures at once, none finds the other's as its own."""
    first, second, reader = (compiled._CodeFiles(str(tmp_path), "function", "stamp") for _ in range(3))
    # The second one, which has seen the index empty as well, saves between the first one's index and its code.
    save_code = first._save_data
    second._load_index = dict

    def save_late(*arguments: Any) -> None:
        second.save("float", "code for floats")
        save_code(*arguments)

    first._save_data = save_late
    first.save("array", "code for arrays")
    assert reader.load("float") == "code for floats"
    assert reader.load("array") in {None, "code for arrays"}


def test_of_two_processes_one_compiles_and_the_other_waits(tmp_path: Path) -> None:
    """Two processes that need a kernel at once: one compiles it, the other runs the same code, and no lock is left.

    One whose compilation fails, and one that is killed over it, leave their turn to the next.
    """
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "slow_kernel.py").write_text(SLOW_KERNEL, encoding="utf-8")
    program = (
        "import os, slow_kernel, pathlib\nif not os.environ['THEN']:\n    pathlib.Path('there').touch()\n"
        "print(slow_kernel.one_more(1.0), slow_kernel.compiled())"
    )
    begun = tmp_path / "begun"
    killed = start(program, folder, BEGUN=str(begun), THEN="hang")
    wait_until(begun.exists, "a compilation")
    killed.kill()
    killed.communicate()
    begun.unlink()
    first = start(program, folder, BEGUN=str(begun), THEN="slow")
    wait_until(begun.exists, "the next one")
    second = start(program, folder, BEGUN=str(begun), THEN="")
    assert [said(one)[0] for one in (first, second)] == ["2.0 1\n", "2.0 0\n"]
    assert not list((tmp_path / "cache").rglob("*.lock"))


@pytest.fixture
def one_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a kernel that is compiled into a cache of its own."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))

    @kernel
    def one_more(x: float) -> float:
        return x + 1.0

    return one_more


def test_a_compilation_that_fails_leaves_its_turn(tmp_path: Path, one_more: Any) -> None:
    """A kernel that cannot be compiled for its arguments leaves no lock, and is compiled for others."""
    with pytest.raises(numba.TypingError):
        one_more("one")
    assert not list((tmp_path / "cache").rglob("*.lock"))
    assert one_more(1.0) == 2.0


def test_kernels_run_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, one_more: Any) -> None:
    """On a full disk a kernel is compiled and runs; a folder that cannot be made leaves it to numba to find another."""
    with files_up_to(0):
        assert one_more(1.0) == 2.0
    assert not [file for file in (tmp_path / "cache").rglob("*") if file.is_file()]

    ours: Any = exponential_of
    place = ours.py_func, ours.py_func.__code__.co_filename
    assert compiled._Locator.from_function(*place) is not None
    monkeypatch.setattr(numba.config, "CACHE_DIR", f"{os.devnull}/cache")
    assert compiled._Locator.from_function(*place) is None


def test_code_of_sources_long_gone_is_removed(tmp_path: Path) -> None:
    """A new folder removes those of other sources that nobody used for four weeks, and nothing else."""
    ages = {"0123456789abcdef": 1.01, "1123456789abcdef": 1.01, "2123456789abcdef": 0.99, "others": 2.0}
    for name, age in ages.items():
        (tmp_path / name / "module").mkdir(parents=True)
        os.utime(tmp_path / name, (0.0, time.time() - age * FOUR_WEEKS))
    compiled.prepare(tmp_path / "1123456789abcdef")  # is used
    compiled.prepare(tmp_path / "3123456789abcdef")
    left = {"1123456789abcdef", "2123456789abcdef", "3123456789abcdef", "others"}
    assert {folder.name for folder in tmp_path.iterdir()} == left
