"""mypy tells lanes, masks, arrays and floats apart."""

from __future__ import annotations

from pathlib import Path

from mypy import api

from rx90_common.base.sources import ROOT

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


def test_kernels_that_mix_things_up_are_refused(tmp_path: Path) -> None:
    """The strict check finds each line that takes an array for lanes, lanes for a float, or a mask for a number."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(ROOT / ".mypy_cache")]
    report, trouble, _ = api.run([*options, str(tmp_path / "kernels.py")])
    assert not trouble
    found = {int(line.split(":")[1]) for line in report.splitlines() if "kernels.py:" in line and ": error:" in line}
    wrong = {number for number, line in enumerate(KERNELS.splitlines(), 1) if line.endswith("# wrong")}
    assert found == wrong, report
