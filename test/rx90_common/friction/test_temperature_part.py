"""The temperature part: its law in closed form, and its thermal node against analytic answers and a solver."""

from typing import Any

import numpy as np
import pytest
from parted_joint import Array, Seven, along, any_element, steady
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.temperature import TemperaturePart

SETS = 50
BATCHES = -(-SETS // 7)


def any_warmth(rng: np.random.Generator, **values: Any) -> TemperaturePart:
    reference, resistance = rng.uniform(30, 50), 10.0 ** rng.uniform(-2, 0)
    drawn = {
        "reference": reference, "lowest": 20.0, "highest": 190.0, "start": rng.uniform(20, 60), "ambient": 20.0,
        "capacity": rng.uniform(50, 200) / resistance, "resistance": resistance, "viscous_scale": rng.uniform(10, 40),
        "viscous_floor": rng.uniform(0, 1), "speed_slope": rng.uniform(-0.005, 0.03),
        "static_slope": rng.uniform(-0.005, 0.03),
    }  # fmt: skip
    return TemperaturePart(**(drawn | values))


def sliding(velocity: Array | float, steps: int) -> Array:
    still = np.zeros(7)
    return np.broadcast_to(np.array([still, still + velocity, still]), (steps, 3, 7))


def test_steady_sliding_at_a_temperature() -> None:
    """Cold and warm, slow and fast, both ways, the torque is that of the closed form (50 sets of values)."""
    rng = np.random.default_rng(1)
    for _ in range(BATCHES):
        elements = [any_element(rng, temperature=any_warmth(rng, capacity=1e9, resistance=1e6)) for _ in range(7)]
        for velocity in (0.3, -0.3, 0.004, -0.004):
            torque, _ = along(Seven.of(elements), sliding(velocity, 2), 10.0)
            want = [steady(e, velocity, warm=e.temperature.start) for e in elements if e.temperature]
            assert torque[-1] == pytest.approx(want, rel=1e-9)


def test_the_reference_temperature_has_the_paper_s_bits() -> None:
    """At T = reference an element with the part takes every step as one without any does, to the last bit."""
    rng = np.random.default_rng(2)
    warmth = [any_warmth(rng, start=40.0, reference=40.0, ambient=40.0) for _ in range(7)]
    elements = [any_element(rng, temperature=each) for each in warmth]
    bare = Seven.of([element.without_parts() for element in elements])
    seven = Seven.of(elements)
    seven.parts["temperature"]["gain"] = 0.0  # so that it stays there
    motion = np.zeros((400, 3, 7))
    motion[:, 1] = 0.2 * rng.standard_normal((400, 7))
    for got, want in zip(along(seven, motion, 2.5e-4), along(bare, motion, 2.5e-4), strict=True):
        assert np.array_equal(got, want)


def test_friction_that_warms_itself_against_a_solver() -> None:
    """At constant velocity friction and temperature go as the coupled equation has them (SciPy, 50 sets, 1e-6 K)."""
    rng, duration = np.random.default_rng(4), 60.0
    for _ in range(BATCHES):
        elements = [any_element(rng, temperature=any_warmth(rng), c0=1e12) for _ in range(7)]
        velocity = np.array([rng.uniform(0.02, 60.0 / e.tau_s.positive) for e in elements]).clip(max=2.0)
        ends = []
        for steps in (3000, 6000):
            seven = Seven.of(elements, duration / steps)
            along(seven, sliding(velocity, steps), duration / steps)
            ends.append(np.array(seven.states["temperature"]["temperature"][0]))
        coarse, fine = ends
        start = np.array([e.temperature.start for e in elements if e.temperature])
        want = _solved(elements, velocity, duration)
        assert np.abs(want - start).max() > 1.0
        assert fine == pytest.approx(want, abs=1e-2)
        assert 2.0 * fine - coarse == pytest.approx(want, abs=1e-6)  # a tick is held: its error halves with it


def _solved(elements: list[FrictionElement], velocity: Array, duration: float) -> Array:
    parts = [e.temperature for e in elements if e.temperature]

    def rates(_: float, now: Array) -> Array:
        each = zip(elements, parts, now, velocity, strict=True)
        return np.array([
            (steady(e, v, warm=t) * v - (t - part.ambient) / part.resistance) / part.capacity for e, part, t, v in each
        ])  # fmt: skip

    start = np.array([part.start for part in parts])
    return np.asarray(solve_ivp(rates, (0.0, duration), start, "DOP853", rtol=1e-11, atol=1e-11).y[:, -1])


@pytest.mark.parametrize(("speed_slope", "static_slope"), [(-0.004, -0.003), (0.02, 0.015)])
def test_passive_at_every_temperature(speed_slope: float, static_slope: float) -> None:
    """passive_damping is the least over temperatures of that of an element with the friction of the temperature."""
    rng = np.random.default_rng(6)
    for _ in range(10):
        part = any_warmth(rng, speed_slope=speed_slope, static_slope=static_slope)
        element = any_element(rng, temperature=part, delta=1.0)
        found, top = [], element.omega_s  # up to where static friction still counts
        for above in np.linspace(part.lowest, part.highest, 5) - part.reference:
            rise = 1 + part.static_slope * above
            static = {
                f"tau_s_{sign}": element.parameters[f"tau_c_{sign}"]
                + rise * (element.parameters[f"tau_s_{sign}"] - element.parameters[f"tau_c_{sign}"])
                for sign in ("positive", "negative")
            }
            speed = element.omega_s * (1 + part.speed_slope * above)
            bare = element.replaced(temperature=None).with_parameters({**static, "omega_s": speed})
            found.append(bare.passive_damping(top))
        assert element.passive_damping(top) == pytest.approx(min(found), rel=1e-9)
        assert min(found) < (1.0 - 1e-5) * max(found)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"start": 19.0}, r"start is 19\.0; accepted: from lowest to highest.*\[20, 190\]"),
        ({"lowest": 190.0, "start": 190.0}, "lowest is 190.0; accepted: below highest = 190"),
        ({"static_slope": -0.01, "reference": 40.0}, "static_slope is -0.01; .* at 190 °C; this leaves -0.5 times"),
        ({"speed_slope": 0.06, "reference": 40.0}, "speed_slope is 0.06; .* at 20 °C; this leaves -0.2 times"),
    ],
)
def test_a_law_that_does_not_hold_is_refused(values: dict[str, float], said: str) -> None:
    """Temperatures outside of the law's range, and a range in which it does not hold, are refused by name and value."""
    with pytest.raises(ValidationError, match=said):
        any_warmth(np.random.default_rng(0), **values)
