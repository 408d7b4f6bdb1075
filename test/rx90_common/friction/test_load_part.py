"""The load part: torques in closed form, and the torque that it follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from parted_joint import Seven, along, any_element, begin

from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.load import LoadPart

SETS = 20


def any_load(rng: np.random.Generator) -> LoadPart:
    """Return a load part with all its coefficients drawn."""
    return LoadPart(*rng.uniform(0.0, 0.5, 4), *rng.uniform(0.0, 0.01, 2), relax_time=10.0 ** rng.uniform(-3, -1))


def expected(element: FrictionElement, load: float, velocity: float) -> tuple[float, float]:
    """Return Coulomb and static torque by the equations of Bittencourt and Gunnarsson, and BAM's quadratic term."""
    part = element.load
    assert part is not None
    lifting = load * velocity >= 0
    k, s, m = (
        (part.driving, part.stribeck_driving, part.quadratic_driving)
        if lifting
        else (part.driven, part.stribeck_driven, part.quadratic_driven)
    )
    tau_c = element.tau_c_positive if velocity >= 0 else element.tau_c_negative
    tau_s = element.tau_s_positive if velocity >= 0 else element.tau_s_negative
    return tau_c + k * abs(load), tau_s + (k + s) * abs(load) + m * load**2


def test_steady_sliding_under_constant_load() -> None:
    """Lifting and lowering, both ways, from break-away on, the torque is that of the closed form (20 sets of values).

    The load's share of the static torque fades with its own velocity, or with the element's where it has none.
    """
    rng = np.random.default_rng(5)
    for _ in range(-(-SETS // 7)):
        own = 10.0 ** rng.uniform(-2, 0, 7) * [1, 1, 0, 1, 1, 0, 1]
        parts = [replace(any_load(rng), omega_s=float(speed)) for speed in own]
        elements = [any_element(rng, load=part) for part in parts]
        loads = rng.uniform(-200.0, 200.0, 7)
        for velocity in (0.3, -0.3, 0.004, -0.004, 1e-9, -1e-9):
            seven = Seven.of(elements)
            begin(seven.parts, seven.states, loads)
            motion = np.broadcast_to(np.array([np.zeros(7), np.full(7, velocity), loads]), (4, 3, 7))
            torque, _ = along(seven, motion, 1e4 / abs(velocity))  # a step is exact however long it is
            for i, element in enumerate(elements):
                bare = expected(element, 0.0, velocity)
                coulomb, static = expected(element, loads[i], velocity)
                of_load = static - coulomb - (bare[1] - bare[0])
                element_fades, load_fades = (
                    np.exp(-((abs(velocity) / speed) ** element.delta))
                    for speed in (element.omega_s, own[i] or element.omega_s)
                )
                viscous = float(element.viscous_torque(abs(velocity)))
                want = coulomb + (bare[1] - bare[0]) * element_fades + of_load * load_fades + viscous
                assert torque[-1, i] == pytest.approx(np.sign(velocity) * want, rel=1e-12)


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
            assert seven.states["load"][0] == pytest.approx(want, rel=1e-12, abs=1e-12)
