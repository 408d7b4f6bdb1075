"""The example of docs/explanation/kernels.md works as it stands, and types tell what kernels are made of apart."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from mypy import api

from rx90_common.base.share import ROOT

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


KERNELS = '''
"""Kernels that are right, and lines that are not, each marked."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rx90_common.friction.bristle import bristle_step
from rx90_common.kernels.elementary import exponential
from rx90_common.kernels.lanes import Lanes, Mask, Number, any_lane, fma, lane, load, select, store, suffix_sum


def right(x: Number, y: Number) -> Number:
    return select(x < 0.0, exponential(-x), fma(2.0 * x, y, 1.0 - x / y))


def also_right(a: NDArray[np.float64], element: Any, step: float) -> float:
    x = load(a, 6)
    store(a, suffix_sum(right(x, 0.5 * x)))
    torque: float = bristle_step(element, 0.0, 1.0, step)[1]
    return lane(x, 2) + right(torque, 1.0) if any_lane(x > 1.0) else torque


def mixed_up(x: Lanes, y: float, a: NDArray[np.float64], mask: Mask, element: Any) -> float:
    x + a  # wrong
    x + mask  # wrong
    right(a, y)  # wrong
    store(a, a)  # wrong
    store(a, x < y)  # wrong
    load(x, 6)  # wrong
    select(x, x, y)  # wrong
    any_lane(x)  # wrong
    bristle_step(element, x, x, x)  # wrong
    y = x  # wrong
    return exponential(x)  # wrong
'''


def test_the_types_tell_lanes_masks_arrays_and_floats_apart(example: Path) -> None:
    """The strict check finds nothing in the example, and in KERNELS each line that mixes them up, and no other."""
    (kernels := example.with_name("kernels.py")).write_text(KERNELS)
    options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
    report, trouble, _ = api.run([*options, str(kernels), str(example)])
    assert not trouble
    found = {
        (Path(line.split(":")[0]).name, int(line.split(":")[1])) for line in report.splitlines() if ": error:" in line
    }
    wrong = {("kernels.py", n) for n, line in enumerate(KERNELS.splitlines(), 1) if line.endswith("# wrong")}
    assert found == wrong, report
