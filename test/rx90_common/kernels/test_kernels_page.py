"""The example of docs/explanation/kernels.md works as it stands."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mypy import api

from rx90_common.base.sources import ROOT

PAGE = ROOT / "docs/explanation/kernels.md"


@pytest.fixture
def example(tmp_path: Path) -> Path:
    """Return a file that holds the page's code."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    file = tmp_path / "example.py"
    file.write_text(code)
    return file


def test_the_example_runs(example: Path) -> None:
    """What the example asserts about its own kernels holds."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(example.parent)}
    done = subprocess.run(
        [sys.executable, str(example)], env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_the_example_is_typed(example: Path) -> None:
    """The strict check finds nothing in it."""
    options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
    assert api.run([*options, str(example)])[0].startswith("Success")
