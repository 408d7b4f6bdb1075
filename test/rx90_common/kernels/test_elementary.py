"""Lanes, and their exponential, sine, cosine and power: accurate, the same as of floats, on every processor."""

import ast
import math
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

from rx90_common.base.arrays import Array
from rx90_common.base.share import ROOT
from rx90_common.kernels import elementary
from rx90_common.kernels.elementary import (
    angles_of,
    arctangent,
    exponential,
    exponential_less_one_of,
    power,
    signed_power,
    sine_cosine,
)
from rx90_common.kernels.lanes import fma, load, select, store
from rx90_common.process.children import TIMEOUT

pytestmark = pytest.mark.slow


@numba.njit
def in_lanes(x: Array, out: Array) -> None:
    """Write exp(-|x|), sin(x), cos(x), |x|^e sign(x) and an angle, shape (5, 8 n), lanes eight at a time."""
    for i in range(0, x.size, 8):
        sine, cosine = sine_cosine(load(x[i:], 8))
        store(out[0, i:], exponential(load(-np.abs(x[i : i + 8]), 8)))
        store(out[1, i:], sine)
        store(out[2, i:], cosine)
        store(out[3, i:], signed_power(load(x[i:], 8), 0.5 + load(out[0, i:], 8)))
        for k in range(i, i + 8):
            out[4, k] = arctangent(x[k], x[(k * 7) % x.size])


@numba.njit
def one_by_one(x: Array, out: Array) -> None:
    for i in range(x.size):
        out[0, i] = exponential(-abs(x[i]))
        out[1, i], out[2, i] = sine_cosine(x[i])
        out[3, i] = signed_power(x[i], 0.5 + out[0, i])
        out[4, i] = arctangent(x[i], x[(i * 7) % x.size])


def samples() -> Array:
    rng = np.random.default_rng(7)
    turns = np.arange(-40, 40) * (math.pi / 4)
    beside = [np.nextafter(turns, -9e9), turns, np.nextafter(turns, 9e9)]
    spread = rng.choice([-1, 1], 100_000) * 10.0 ** rng.uniform(-12, 3, 100_000)
    x = np.concatenate([*beside, spread, rng.uniform(-7, 7, 100_000), [0.0, -0.0]])
    return x[: x.size // 8 * 8]


def test_the_constants_are_those_that_the_script_derives() -> None:
    """The script in tools/ gives every constant of the polynomials and of the reduction to the last bit."""
    script = ROOT / "tools" / "elementary_coefficients.py"
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, timeout=TIMEOUT, check=True)
    derived = {
        assignment.targets[0].id: ast.literal_eval(assignment.value)
        for assignment in ast.parse(done.stdout).body
        if isinstance(assignment, ast.Assign) and isinstance(assignment.targets[0], ast.Name)
    }
    assert derived.keys() == {"_LOG2_E", "_TWO_BY_PI", "_LN2", "_HALF_PI", "_ARCS", "_E", "_S", "_C", "_L", "_A"}
    assert derived == {name: getattr(elementary, name) for name in derived}


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="needs an extended precision to compare with")
def test_errors_stay_below_two_units_in_the_last_place() -> None:
    """Down to the smallest normal number exp is off by less than 1.2 ulp, to a thousand radians sin and cos by 1.6."""
    x = samples()
    got = np.empty((5, x.size))
    in_lanes(x, got)
    wide = x.astype(np.longdouble)
    want = np.array([np.exp(-np.abs(wide)), np.sin(wide), np.cos(wide)])
    normal = want[0] > 1e-307
    assert np.all(np.abs(got[0] - want[0])[normal] < 1.2 * np.spacing(got[0][normal]))
    assert np.all(got[0][~normal] < 1e-307)
    # Next to a zero of sine or cosine the rounding of the reduced angle counts, 1e-26 at most.
    assert np.all(np.abs(got[1:3] - want[1:]) < 1.6 * np.spacing(np.abs(got[1:3])) + 1e-26)


def test_values_that_must_be_exact() -> None:
    """The exponential of 0 and cos(0) are 1, sin(0) and exp of minus infinity are 0, NaN stays NaN."""
    x = np.array([0.0, -0.0, 1e4, math.inf, math.nan, 0.0, 0.0, 0.0])
    out = np.empty((5, 8))
    in_lanes(x, out)
    assert out[0, :4].tolist() == [1.0, 1.0, 0.0, 0.0]
    assert out[1, :2].tolist() == [0.0, 0.0]
    assert out[2, :2].tolist() == [1.0, 1.0]
    assert np.isnan(out[:4, 4]).all()


def test_lanes_and_floats_give_the_same_bits() -> None:
    """A number gives the same result in a lane as by itself."""
    x = samples()
    together, single = np.empty((2, 5, x.size))
    in_lanes(x, together)
    one_by_one(x, single)
    assert together.tobytes() == single.tobytes()


@numba.njit
def powers(base: Array, exponent: Array, out: Array) -> None:
    for i in range(0, base.size, 8):
        store(out[i:], power(load(base[i:], 8), load(exponent[i:], 8)))


@pytest.mark.skipif(np.finfo(np.longdouble).nmant < 63, reason="needs an extended precision to compare with")
def test_power_and_arc_tangent_are_accurate() -> None:
    """Powers up to the fourth are off by less than 1.7 ulp, angles by less than 2, exp(x) - 1 by less than 4."""
    rng = np.random.default_rng(5)
    base = np.concatenate([10.0 ** rng.uniform(-12, 6, 40_000), rng.uniform(0.5, 2.0, 40_000)])
    exponent, out = rng.uniform(0.05, 4.0, base.size), np.empty(base.size)
    powers(base, exponent, out)
    assert np.all(np.abs(out - base.astype(np.longdouble) ** exponent) < 1.7 * np.spacing(out))
    y, x = rng.choice([-1, 1], (2, 80_000)) * 10.0 ** rng.uniform(-3, 3, (2, 80_000))
    angle = angles_of(y, x)
    wide = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    assert np.all(np.abs(angle - wide) < 2.0 * np.spacing(np.abs(angle)))
    small = rng.choice([-1, 1], 2000) * 10.0 ** rng.uniform(-12, 0, 2000)
    grown = np.array([exponential_less_one_of(value) for value in small])
    assert np.all(np.abs(grown - np.expm1(small.astype(np.longdouble))) < 4.0 * np.spacing(np.abs(grown)))


def test_angles_on_the_axes() -> None:
    """On the axes, at the origin and with signed zeros the angle is that of C's atan2; NaN stays NaN."""
    y = np.array([0.0, 0.0, -0.0, 1.0, -1.0, 0.0, -0.0, 2.0, -2.0])
    x = np.array([0.0, -1.0, -1.0, 0.0, 0.0, 1.0, 1.0, 2.0, -2.0])
    assert angles_of(y, x).tobytes() == np.arctan2(y, x).tobytes()
    assert np.isnan(angles_of(math.nan, [1.0, -1.0, math.nan])).all()


def test_power() -> None:
    """Exponents 1 and 2 are exact, others right to some ulp, also mixed in one set of lanes, from 0 to infinity."""
    base = np.array([0.0, 0.3, 1.7, 0.0, 0.3, 1.7, 1e300, 1.0])
    for exponent in (np.ones(8), np.full(8, 2.0), np.array([1.0, 1.0, 2.0, 0.5, 2.7, 0.01, 50.0, 3.0])):
        out = np.empty(8)
        powers(base, exponent, out)
        plain = (exponent == 1.0) | (exponent == 2.0)
        with np.errstate(over="ignore"):
            assert out == pytest.approx(base**exponent, rel=1e-15, abs=0.0)
            assert np.array_equal(out[plain], np.where(exponent == 1.0, base, base * base)[plain])


def test_a_signed_power() -> None:
    """It has the sign of its base and the power of its size; exponent 1 keeps every bit, beside others too."""

    @numba.njit
    def compute(x: Array, exponent: Array, out: Array) -> None:
        store(out[0], signed_power(load(x, 7), load(exponent, 7)))
        store(out[1], signed_power(x[1], load(exponent, 7)))

    x = np.array([0.0, -0.3, 1.7, -0.0, -5e-324, -1.7, 1e300])
    for exponent in (np.ones(7), np.array([0.6, 0.6, 1.5, 1.0, 1.0, 2.0, 0.3])):
        out = np.empty((2, 7))
        compute(x, exponent, out)
        assert out == pytest.approx(np.sign([x, [-0.3] * 7]) * np.abs([x, [-0.3] * 7]) ** exponent, rel=1e-15, abs=0.0)
        assert out[0, exponent == 1.0].tobytes() == x[exponent == 1.0].tobytes()


def test_a_processor_without_vector_and_fma_instructions_gives_the_same_bits(tmp_path: Path) -> None:
    """Compiled for the oldest processor of the kind, in a process of its own, every bit is the same."""
    if os.environ.get("NUMBA_CPU_NAME"):
        pytest.skip("already compiled for a chosen processor")
    x = samples()
    here = np.empty((5, x.size))
    in_lanes(x, here)
    np.save(tmp_path / "x.npy", x)
    code = (
        "import sys, numpy as np; sys.path[:0] = sys.argv[2:]; from test_elementary import in_lanes; "
        "x = np.load(sys.argv[1] + '/x.npy'); out = np.empty((5, x.size)); in_lanes(x, out); "
        "np.save(sys.argv[1] + '/out.npy', out)"
    )
    folders = [str(tmp_path), str(Path(__file__).parent), str(Path(__file__).parents[3])]
    plain = {**os.environ, "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    subprocess.run([sys.executable, "-c", code, *folders], check=True, env=plain, timeout=TIMEOUT)
    assert np.load(tmp_path / "out.npy").tobytes() == here.tobytes()


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


def test_lanes_of_different_number_do_not_mix() -> None:
    """Six lanes and seven are refused together when the kernel is compiled."""

    @numba.njit
    def compute(a: Array, out: Array) -> None:
        store(out, load(a, 6) + load(a, 7))

    with pytest.raises(TypingError):
        compute(np.ones(7), np.empty(7))


def test_the_example_runs(tmp_path: Path) -> None:
    """What the page's example asserts about its own kernels holds."""
    page = (ROOT / "docs/explanation/kernels.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    example = tmp_path / "example.py"
    example.write_text(code)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path)}
    subprocess.run([sys.executable, str(example)], env=environment, timeout=TIMEOUT, check=True)
