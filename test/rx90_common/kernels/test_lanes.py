"""Lanes: operations, memory, refusals, and the example and the types that the page on kernels has."""

from __future__ import annotations

import operator
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError
from numpy.typing import NDArray

from rx90_common.base.share import ROOT
from rx90_common.kernels.lanes import (
    absolute,
    any_lane,
    append,
    delay,
    first,
    fma,
    lane,
    load,
    prefix_sum,
    select,
    store,
    suffix_sum,
)

pytestmark = pytest.mark.slow

Array = NDArray[np.float64]
RNG = np.random.default_rng(5)
A, B = RNG.normal(size=(2, 7)) * 10.0 ** RNG.integers(-5, 5, (2, 7))


@pytest.mark.parametrize("symbol", [operator.add, operator.sub, operator.mul, operator.truediv])
def test_arithmetic_is_numpy_s_lane_by_lane(symbol: Callable[[Any, Any], Any]) -> None:
    """Lanes with lanes, and with a number on either side, give the bits that numpy gives."""

    @numba.njit
    def compute(a: Array, b: Array, out: Array) -> None:
        x, y = load(a, 7), load(b, 7)
        store(out[0], symbol(x, y))
        store(out[1], symbol(x, 3))
        store(out[2], symbol(0.1, y))
        store(out[3], -x)

    out = np.empty((4, 7))
    compute(A, B, out)
    assert np.array_equal(out, [symbol(A, B), symbol(A, 3.0), symbol(0.1, B), -A])


@pytest.mark.parametrize("symbol", [operator.eq, operator.lt, operator.le, operator.gt, operator.ge])
def test_comparisons_choose_lane_by_lane(symbol: Callable[[Any, Any], Any]) -> None:
    """A comparison is numpy's, false for NaN, and `select` follows it."""
    a = np.array([1.0, 2.0, 3.0, np.nan, -0.0, 0.0, np.inf])
    b = np.array([1.0, 3.0, 2.0, np.nan, 0.0, 1.0, np.inf])

    @numba.njit
    def compute(a: Array, b: Array, out: Array) -> None:
        store(out, select(symbol(load(a, 7), load(b, 7)), 1.0, load(a, 7)))

    out = np.empty(7)
    compute(a, b, out)
    assert np.array_equal(out, np.where(symbol(a, b), 1.0, a), equal_nan=True)


def test_a_product_and_a_sum_are_rounded_once() -> None:
    """`fma` keeps what the product alone would lose, in lanes as in floats."""

    @numba.njit
    def compute(x: Array, out: Array) -> float:
        store(out, fma(load(x, 6), load(x, 6), -1.0))
        return float(fma(x[0], x[0], -1.0))

    small = 2.0**-30
    out = np.empty(6)
    single = compute(np.full(6, 1.0 + small), out)
    exact = 2.0 * small + small * small
    assert (1.0 + small) * (1.0 + small) - 1.0 != exact
    assert single == exact
    assert np.array_equal(out, np.full(6, exact))


@pytest.mark.parametrize("width", [1, 2, 3, 4, 5, 6, 7, 8, 9])
def test_reading_and_writing_stay_within_the_lanes(width: int) -> None:
    """Reading and writing n lanes leaves the numbers beside them as they were."""

    @numba.njit
    def copy(a: Array, b: Array) -> None:
        store(b[1:], load(a[1:], width))

    source, target = np.arange(12.0), np.full(12, -1.0)
    copy(source, target)
    want = np.full(12, -1.0)
    want[1 : width + 1] = source[1 : width + 1]
    assert np.array_equal(target, want)


def test_lanes_change_places() -> None:
    """Appending, cutting, delaying and reading single lanes do what their names say."""

    @numba.njit
    def compute(a: Array, out: Array) -> None:
        x = load(a, 6)
        store(out[0], append(x, 9.0))
        store(out[1], first(x, 4))
        store(out[2], delay(x, 9.0))
        for i in range(6):
            out[3, i] = lane(x, 5 - i)
        store(out[4], absolute(x))

    a, out = -np.arange(1.0, 7.0), np.zeros((5, 7))
    compute(a, out)
    assert out[0].tolist() == [*a, 9.0]
    assert out[1].tolist() == [*a[:4], 0.0, 0.0, 0.0]
    assert out[2].tolist() == [9.0, *a[:5], 0.0]
    assert out[3].tolist() == [*a[::-1], 0.0]
    assert out[4].tolist() == [*-a, 0.0]


@pytest.mark.parametrize("width", [3, 6, 8])
def test_sums_over_lanes(width: int) -> None:
    """Sums from the first lane and to the last one are the cumulative sums, exact for whole numbers."""

    @numba.njit
    def compute(a: Array, out: Array) -> None:
        store(out[0], prefix_sum(load(a, width)))
        store(out[1], suffix_sum(load(a, width)))

    a, out = RNG.integers(-100, 100, width).astype(float), np.empty((2, width))
    compute(a, out)
    assert np.array_equal(out, [np.cumsum(a), np.cumsum(a[::-1])[::-1]])


def test_any_lane_sees_each_lane_and_nothing_beside_them() -> None:
    """One true lane is enough, wherever it is; what the register holds beyond the lanes does not count."""

    @numba.njit
    def compute(a: Array) -> bool:
        return bool(any_lane(1.0 / load(a, 6) < 1.0))

    assert not compute(np.full(6, 0.5))
    for i in range(6):
        a = np.full(6, 0.5)
        a[i] = 2.0
        assert compute(a)


def test_lanes_of_different_number_do_not_mix() -> None:
    """Six lanes and seven are refused together when the kernel is compiled."""

    @numba.njit
    def compute(a: Array, out: Array) -> None:
        store(out, load(a, 6) + load(a, 7))

    with pytest.raises(TypingError):
        compute(np.ones(7), np.empty(7))


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
