"""The cache of compiled kernels never serves stale code, and compilation is announced."""

import os
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numba
import pytest
from numba.core.registry import CPUDispatcher
from processes import TIMEOUT, files_up_to

from rx90_common.base.share import ROOT
from rx90_common.kernels.compiled import kernel
from rx90_common.kernels.sources import files_with_kernels, module_file

pytestmark = pytest.mark.slow

ANNOUNCED = r"program: compiling the numerical kernels, .*\n"
ANNOUNCE = "from rx90_common.kernels import announce_compilation\nannounce_compilation('program')\n"


def start(program: str, folder: Path, **variables: str) -> subprocess.Popen[str]:
    path = os.pathsep.join([str(folder), str(ROOT)])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder.parent / "cache"), "PYTHONPATH": path, **variables}
    words, pipe = [sys.executable, "-c", program], subprocess.PIPE
    return subprocess.Popen(words, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True)


def said(running: subprocess.Popen[str]) -> tuple[str, str]:
    out, err = running.communicate(timeout=TIMEOUT)
    assert running.returncode == 0, err
    return out, err


def copy_sources(folder: Path) -> Path:
    shutil.copytree(ROOT / "rx90_common", folder / "rx90_common", ignore=shutil.ignore_patterns("__pycache__"))
    for file in folder.rglob("*.py"):
        os.utime(file)
    return folder


def test_copies_of_the_same_sources_share_compiled_code(tmp_path: Path) -> None:
    """A second clone compiles nothing, whatever its models; another processor or function that a kernel calls does."""
    kernels = "from rx90_common.kernels.elementary import {0}\nprint({0}(0.0))\n"
    exponential, other = kernels.format("exponential_of"), kernels.format("exponential_less_one_of")
    callback = "from rx90_common.exchange import arrivals\nprint('imported', file=sys.stderr)\narrivals._count()\n"
    one, two = copy_sources(tmp_path / "one"), copy_sources(tmp_path / "two")
    out, err = said(start(f"import sys\n{ANNOUNCE}{callback}{exponential}", one))
    assert out == "1.0\n"
    assert re.fullmatch(f"imported\n{ANNOUNCED}", err)
    with (two / "rx90_common/base/models.py").open("a", encoding="utf-8") as declarations:
        declarations.write("# Changed.\n")
    there = f"import sys\n{ANNOUNCE}{callback}{exponential}print('computed', file=sys.stderr)\n{other}"
    assert re.fullmatch(f"imported\ncomputed\n{ANNOUNCED}", said(start(there, two))[1])
    assert re.fullmatch(ANNOUNCED, said(start(ANNOUNCE + exponential, two, NUMBA_CPU_NAME="generic"))[1])
    called = two / "rx90_common/kernels/elementary.py"
    text = called.read_text(encoding="utf-8")
    assert "1.0 + _grown(r)" in text
    called.write_text(text.replace("1.0 + _grown(r)", "2.0 + _grown(r)"), encoding="utf-8")
    out, err = said(start(ANNOUNCE + exponential, two))
    assert out == "2.0\n"
    assert re.fullmatch(ANNOUNCED, err)


def test_what_kernels_take_from_elsewhere_is_in_the_name_of_the_cache() -> None:
    """Classes and functions that compiled code names come from files whose change compiles it again."""
    files = files_with_kernels()
    for file in files:
        module = import_module(".".join(file.relative_to(ROOT).with_suffix("").parts))
        for function in vars(module).values():
            if isinstance(function, CPUDispatcher):
                for name in function.py_func.__code__.co_names:
                    place = getattr(function.py_func.__globals__.get(name), "__module__", None)
                    assert place is None or module_file(place) in {None, *files}, (function, name)


def test_kernels_run_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a full disk a kernel is compiled and runs."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))

    @kernel
    def one_more(x: float) -> float:
        return x + 1.0

    with files_up_to(0):
        assert one_more(1.0) == 2.0
    assert not [file for file in (tmp_path / "cache").rglob("*") if file.is_file()]
