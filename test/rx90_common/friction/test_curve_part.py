"""The part `curve`: the sliding torque of a table, against SciPy's PCHIP and a solution of equations 17 and 18."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from parted_joint import Seven, along, any_element
from pydantic import ValidationError
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.base.models import model_text
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.curve import CurvePart, CurveTable
from rx90_emulator.loop.parameters import Catalogue
from rx90_emulator.loop.setup import Setup

STRIBECK = {"velocity": [0.0, 0.01, 0.03, 0.1, 0.5, 2.0], "torque": [32.0, 30.0, 27.0, 25.5, 25.0, 25.5]}
OTHER = {"velocity": [0.02, 0.2, 1.0], "torque": [20.0, 18.0, 18.0]}


CURVE = CurvePart.model_validate({"positive": STRIBECK, "negative": OTHER})


def any_table(rng: np.random.Generator, points: int) -> CurveTable:
    velocity = np.cumsum(rng.uniform(0.01, 0.3, points))
    torque = 10.0 ** rng.uniform(0.5, 1.5, points)
    torque[0] = 40.0  # it falls from there: the line before it rises towards rest
    torque[-1] = torque[-2] + rng.choice([0.0, 5.0])
    return CurveTable(velocity=velocity.tolist(), torque=torque.tolist())


def pchip(table: CurveTable, speed: Array) -> Array:
    velocity = np.array(table.velocity)
    interpolant = PchipInterpolator(velocity, table.torque)
    inside = np.clip(speed, velocity[0], velocity[-1])
    return np.asarray(interpolant(inside) + interpolant.derivative()(inside) * (speed - inside))


@pytest.mark.parametrize("points", [2, 3, 5, 64])
def test_the_torque_is_scipy_s_pchip_and_straight_beyond_the_points(points: int) -> None:
    """In Python and in the compiled step, between the points, before the first and beyond the last one."""
    rng = np.random.default_rng(points)
    tables = [any_table(rng, points) for _ in range(7)]
    part = CurvePart.model_validate({"positive": tables[0], "negative": tables[1]})
    speed = np.linspace(0.0, 1.5 * tables[0].velocity[-1], 401)
    zero = np.zeros_like(speed)
    assert part.sliding_torque(speed, zero) == pytest.approx(pchip(tables[0], speed), rel=1e-12)
    assert part.sliding_torque(-speed[1:], zero[1:]) == pytest.approx(pchip(tables[1], speed[1:]), rel=1e-12)
    growth = np.diff(pchip(tables[0], speed)) / np.diff(speed)
    assert part.steepest >= (1.0 - 1e-9) * growth.max()
    elements = [any_element(rng, curve=CurvePart.model_validate(table)) for table in tables]
    for velocity in (1e-4, 0.013, -0.2, 3.0, -25.0):
        torque, _ = along(Seven.of(elements), np.broadcast_to(velocity, (3, 3, 7)) * [[0.0], [1.0], [0.0]], 1e6)
        for i, element in enumerate(elements):
            want = pchip(tables[i], np.array([abs(velocity)]))[0] + element.viscous_torque(abs(velocity))
            assert torque[-1, i] == pytest.approx(np.sign(velocity) * want, rel=1e-9)
            assert element.steady_torque(velocity) == pytest.approx(np.sign(velocity) * want, rel=1e-12)


def test_a_motion_is_the_solution_of_the_equations() -> None:
    """Through reversals the torque is that of equations 17 and 18 with the table's g, by a stiff solver."""
    element = FrictionElement(
        tau_c=1.0, tau_s=1.0, omega_s=1.0, delta=1.0, c0=2e4, c1=20.0, c2=3.0, omega_d=1.0, curve=CURVE
    )

    def velocity(t: float) -> float:
        return 0.4 * np.sin(7.0 * t) + 0.02 * np.cos(50.0 * t)

    def rate(t: float, z: Array) -> Array:
        v = velocity(t)
        table, sign = (STRIBECK, 1.0) if v >= 0.0 else (OTHER, -1.0)
        torque = pchip(CurveTable.model_validate(table), np.array([sign * v]))
        return v - abs(v) * element.c0 / torque * z

    step = 1e-4
    times = step * np.arange(1, 12001)
    solution = solve_ivp(rate, (0.0, times[-1]), [0.0], "LSODA", t_eval=times, rtol=1e-9, atol=1e-12, max_step=1e-3)
    middle = np.array([velocity(t - 0.5 * step) for t in times])
    motion = np.zeros((len(times), 3, 7))
    motion[:, 1] = middle[:, None]
    seven = Seven.of([element] * 7)
    torque, _ = along(seven, motion, step)
    z = solution.y[0]
    between = 0.5 * (z[1:] + z[:-1])
    v = middle[1:]
    want = element.c0 * between + element.damping(v) * np.diff(z) / step + element.c2 * v
    error = np.abs(torque[1:, 0] - want)
    assert error.max() < 0.02 * 32.0
    assert np.sqrt(np.mean(error**2)) < 1e-3 * 32.0


def test_elements_without_a_curve_keep_their_bits_beside_one() -> None:
    """A curve of one element changes nothing of the others."""
    rng = np.random.default_rng(2)
    elements = [any_element(rng) for _ in range(7)]
    motion = np.zeros((500, 3, 7))
    motion[:, 1] = rng.normal(size=(500, 7))
    plain, _ = along(Seven.of(elements), motion, 2.5e-4)
    beside, _ = along(Seven.of([elements[0].replaced(curve=CURVE), *elements[1:]]), motion, 2.5e-4)
    assert np.array_equal(plain[:, 1:], beside[:, 1:])
    assert not np.array_equal(plain[:, 0], beside[:, 0])


def test_a_file_has_one_table_or_one_for_each_sign() -> None:
    """Both come back as they were written, one table for both signs as one."""
    bristle = {"c0": 1e4, "c1": 0.0, "c2": 0.0}
    for block in (STRIBECK, {"positive": STRIBECK, "negative": OTHER}):
        file = FrictionFile.of({"joint": {**bristle, "curve": block}})
        assert file.elements.model_dump(mode="json", exclude_defaults=True)["joint"]["curve"] == block
        assert model_text(file).count("velocity:") == (1 if block is STRIBECK else 2)

    torque = file.elements["joint"].tau_s
    assert (torque.positive, torque.negative) == (32.0, pytest.approx(pchip(CurveTable(**OTHER), np.zeros(1))[0]))
    with pytest.raises(ConfigError, match=r"joint\.omega_s is missing"):
        FrictionFile.of({"joint": {**bristle, "curve": STRIBECK, "load": {"driving": 0.1, "driven": 0.1}}})
    with pytest.raises(ConfigError, match=r"joint\.tau_c is missing"):
        FrictionFile.of({"joint": bristle})


def test_a_sweep_s_paths_reach_the_points(shipped: Setup) -> None:
    """Each point has a path, and a star stands for all of them, so that a factor scales the whole curve."""
    elements = tuple(element.replaced(curve=CURVE) for element in shipped.friction.elements)
    setup = replace(shipped, friction=replace(shipped.friction, elements=elements))
    assert rx.parameters(setup)["friction.joint_2.curve.positive.torque[1]"] == (30.0, "Nm")
    catalogue = Catalogue(setup)
    places = catalogue.places("friction.joint_2.curve.*.torque[*]")
    assert len(places) == 6 + 3
    halves = {place.path: 0.5 * catalogue.value(place.leaves[0]) for place in places}
    halved = rx.with_parameters(setup, halves).friction["joint_2"]
    speeds = np.linspace(-3.0, 3.0, 41)
    assert halved.sliding_torque(speeds) == pytest.approx(0.5 * elements[1].sliding_torque(speeds))
    assert setup.plant().constants["parts"]["curve"]["used"] == 1


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"velocity": [0.0, 0.1, 0.1], "torque": [3.0, 2.0, 2.0]}, "velocity is .*; accepted: numbers each above"),
        ({"velocity": [0.0, 0.1], "torque": [3.0, 2.0, 2.0]}, "torque is .*; accepted: 2 numbers, as many as velocity"),
        ({"velocity": [0.0, 0.1], "torque": [3.0, 2.0]}, "torque is .*; accepted: numbers that do not fall at the end"),
        ({"velocity": [1.0, 2.0], "torque": [1.0, 3.0]}, "torque is .*; accepted: numbers whose line before the first"),
    ],
)
def test_a_table_that_could_give_no_friction_is_refused(table: dict[str, Any], words: str) -> None:
    """Points that are out of order, of another number, and curves that would end at 0 at some speed."""
    with pytest.raises(ValidationError, match=re.compile(words)):
        CurveTable.model_validate(table)
