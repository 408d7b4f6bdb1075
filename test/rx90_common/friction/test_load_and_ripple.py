"""The load part and the ripple: torques in closed form, the torque that is followed, and what parts do to energy."""

from collections.abc import Sequence

import numpy as np
import pytest
from parted_joint import GEAR, SPEED, Array, Seven, along, any_element, begin, steady

from rx90_common.friction.parts.curve import CurvePart
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.part import FrictionPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart

SETS = 20
NAMES = {LoadPart: "load", RipplePart: "ripple", ScatterPart: "scatter", TemperaturePart: "temperature"}
NAMES[CurvePart] = "curve"


def any_load(rng: np.random.Generator) -> LoadPart:
    shares = zip(
        LoadPart.model_fields, [0.0] * 3 + [*rng.uniform(0.0, 0.5, 4), *rng.uniform(0.0, 0.01, 2)], strict=False
    )
    values = {name: value for name, value in shares if name not in LoadPart.about_keys}
    return LoadPart(**values, relax_time=10.0 ** rng.uniform(-3, -1))


def test_steady_sliding_under_constant_load() -> None:
    """Lifting and lowering, both ways, from break-away on, the torque is that of the closed form."""
    rng = np.random.default_rng(5)
    for _ in range(-(-SETS // 7)):
        own = 10.0 ** rng.uniform(-2, 0, 7) * [1, 1, 0, 1, 1, 0, 1]
        parts = [any_load(rng).replaced(omega_s=float(speed)) for speed in own]
        elements = [any_element(rng, load=part) for part in parts]
        loads = rng.uniform(-200.0, 200.0, 7)
        for velocity in (0.3, -0.3, 0.004, -0.004, 1e-9, -1e-9):
            seven = Seven.of(elements)
            begin(seven.parts, seven.states, loads)
            motion = np.broadcast_to(np.array([np.zeros(7), np.full(7, velocity), loads]), (4, 3, 7))
            torque, _ = along(seven, motion, 1e4 / abs(velocity))  # a step is exact however long it is
            want = [steady(element, velocity, float(load)) for element, load in zip(elements, loads, strict=True)]
            assert torque[-1] == pytest.approx(want, rel=1e-12)


def test_a_held_joint_keeps_every_bit_under_load() -> None:
    """At rest the torque of the bristle stays to the last bit, whatever load goes up and down at the joint."""
    rng = np.random.default_rng(2)
    seven = Seven.of([any_element(rng, load=any_load(rng)) for _ in range(7)])
    seven.z[:] = rng.uniform(-1e-5, 1e-5, 7)
    before = seven.z.copy()
    motion = np.zeros((500, 3, 7))
    motion[:, 2] = 100.0 * rng.standard_normal((500, 7))
    torque, _ = along(seven, motion, 2.5e-4)
    assert np.array_equal(seven.z, before)
    assert np.array_equal(torque, np.broadcast_to(seven.elements["c0"][0] * before, (500, 7)))


def test_the_load_follows_exactly() -> None:
    """A held torque is followed as 1 - exp(-t / relax_time), in one step or in many (20 sets of values)."""
    rng = np.random.default_rng(3)
    for _ in range(-(-SETS // 7)):
        elements = [any_element(rng, load=any_load(rng)) for _ in range(7)]
        relax = np.array([element.load.relax_time for element in elements if element.load])
        start, held = rng.uniform(-50.0, 50.0, (2, 7))
        duration = 10.0 ** rng.uniform(-3, -1)
        for parts in (1, 16):
            seven = Seven.of(elements)
            begin(seven.parts, seven.states, start)
            along(seven, np.broadcast_to(np.array([0.0 * held, 0.0 * held, held]), (parts, 3, 7)), duration / parts)
            want = held + (start - held) * np.exp(-duration / relax)
            assert seven.states["load"]["torque"][0] == pytest.approx(want, rel=1e-12, abs=1e-12)


def any_ripple(rng: np.random.Generator) -> RipplePart:
    values: dict[str, Sequence[float]] = {}
    for angle in ("joint", "motor"):
        terms = int(rng.integers(1, 5))
        values[f"{angle}_harmonic"] = tuple(rng.choice([1.0, 2.0, 3.0, 31.5], terms).tolist())
        values[f"{angle}_amplitude"] = tuple((0.45 * rng.dirichlet(np.ones(terms))).tolist())
        values[f"{angle}_phase"] = tuple(rng.uniform(-np.pi, np.pi, terms).tolist()) if rng.random() < 0.7 else ()
    return RipplePart(**values)  # type: ignore[arg-type]


def test_sliding_torque_along_the_angles() -> None:
    """At constant velocity Coulomb and Stribeck friction are (1 + series) (1 + a held random walk) times as large."""
    rng = np.random.default_rng(5)
    for _ in range(8):
        elements = [
            any_element(rng, ripple=any_ripple(rng), scatter=ScatterPart(deviation=0.1, correlation_time=1.0))
            for _ in range(7)
        ]
        seven = Seven.of(elements)
        seven.parts["scatter"]["decay"], seven.parts["scatter"]["kick"] = 1.0, 0.0
        walk = seven.states["scatter"]["factor"][0]
        assert np.abs(walk - 1.0).max() > 0.05
        velocity = rng.choice([-1.0, 1.0], 7) * rng.uniform(0.01, 1.0, 7)
        # A long way inside each angle: the bristle has settled there before the angle is the next one.
        angle = np.repeat(rng.uniform(-3.0, 3.0, (6, 7)), 3, axis=0)
        motion = np.stack([angle, np.broadcast_to(velocity, angle.shape), 0.0 * angle], axis=1)
        torque, _ = along(seven, motion, 1e3)
        for i, element in enumerate(elements):
            part = element.ripple
            series = np.zeros(len(angle))
            for (_, harmonic, amplitude, phases), turns in zip(part.series, (1.0, GEAR[i]), strict=True):
                phase = phases or np.zeros(len(harmonic))
                for h, a, p in zip(harmonic, amplitude, phase, strict=True):
                    series += a * np.cos(h * turns * angle[:, i] + p)
            sign = np.sign(velocity[i])
            dry = sign * (1 + series) * walk[i] * element.sliding_torque(velocity[i])
            want = dry + element.viscous_torque(velocity[i])
            assert torque[2::3, i] == pytest.approx(want[2::3], rel=1e-9)


LOAD = LoadPart(
    driving=0.2, driven=0.4, stribeck_driving=0.2, stribeck_driven=0.1, quadratic_driving=0.005, quadratic_driven=0.002
)
RIPPLE = RipplePart(
    joint_harmonic=(1.0, 3.0),
    joint_amplitude=(0.3, 0.2),
    joint_phase=(0.5, 1.0),
    motor_harmonic=(2.0,),
    motor_amplitude=(0.45,),
)
SCATTER = ScatterPart(deviation=0.2, correlation_time=0.05)
WARM = TemperaturePart(
    reference=40.0,
    lowest=20.0,
    highest=90.0,
    start=70.0,
    ambient=20.0,
    capacity=1e-3,
    resistance=50.0,
    viscous_scale=20.0,
    viscous_floor=0.3,
    speed_slope=0.02,
    static_slope=-0.015,
)
CURVE = CurvePart.model_validate(
    {"velocity": [0.0, 0.01, 0.03, 0.1, 0.5, 2.0], "torque": [32.0, 30.0, 27.0, 25.5, 25.0, 25.5]}
)
CYCLES, STEPS, ROUNDS = 50, 40, 30  # times seven elements: 10,500 cycles


def cycles(rng: np.random.Generator) -> tuple[Array, float]:
    """Return closed motions from presliding to full speed under loads that jump, (n, 3, 7), and their step, s."""
    amplitude = 10.0 ** rng.uniform(-5, -1, (CYCLES, 1, 7))
    phase = 2.0 * np.pi * (np.arange(STEPS + 1) / STEPS)[None, :, None]
    way = amplitude * (np.sin(phase) + rng.uniform(-1, 1, (CYCLES, 1, 7)) * (np.cos(rng.integers(2, 5) * phase) - 1.0))
    angle = rng.uniform(-3.0, 3.0, (CYCLES, 1, 7)) + 0.5 * (way[:, 1:] + way[:, :-1])
    loads = 50.0 * rng.standard_normal((CYCLES, STEPS, 7))
    step = np.abs(np.diff(way, axis=1)).max() / SPEED * 10.0 ** rng.uniform(0, 2)
    motion = (angle, np.diff(way, axis=1) / step, loads)
    return np.stack([part.reshape(-1, 7) for part in motion], axis=1), float(step)


@pytest.mark.parametrize(
    "parts",
    [(LOAD,), (RIPPLE,), (SCATTER,), (WARM,), (CURVE,), (LOAD, RIPPLE, SCATTER, WARM)],
    ids=["load", "ripple", "scatter", "temperature", "curve", "together"],
)
def test_no_part_creates_energy(parts: tuple[FrictionPart, ...]) -> None:
    """In every step of 10,500 random cycles the storage c0 z^2 / 2 grows by the work that goes in, less the heat."""
    rng = np.random.default_rng(8)
    for _ in range(ROUNDS):
        element = any_element(rng, **{NAMES[type(part)]: part for part in parts})
        seven = Seven.of([element.replaced(c1=0.0), *[element] * 6], seed=3)
        motion, step = cycles(rng)
        before = 0.5 * seven.elements["c0"][0] * seven.z**2
        torque, stored = along(seven, motion, step)
        given = torque * motion[:, 1] * step
        gained = np.diff(stored, axis=0, prepend=before[None]) - given
        assert (gained / seven.elements["tau_c"][0, 0]).max() < 1e-12  # J over Nm
        if WARM in parts:
            assert seven.states["temperature"]["heat"][0] == pytest.approx(-gained.sum(axis=0), rel=1e-9)
