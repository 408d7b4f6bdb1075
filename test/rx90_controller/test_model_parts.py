"""Friction parts in the controller's model: load, ripple, temperature, other bristles, and scatter by its mean."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from own_model import by_model, with_friction
from scipy.integrate import solve_ivp

import rx90_emulator as rx
from rx90_common.description.drives import Windings, coupling_matrix, element_matrix
from rx90_common.description.rigid_torque import rigid_torque
from rx90_common.friction import FrictionElement
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_controller.law.cs7b import CS7B
from rx90_controller.law.loops import position_loop
from rx90_controller.law.model import ArmModel, ModelTemperatures
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
INPUTS = element_matrix()
HERE = np.array([0.3, -0.4, 1.5, 0.4, 0.8, -0.5])
VELOCITY = np.array([0.05, -0.04, 0.06, -0.05, 0.07, 0.03])
WARM = rx.TemperaturePart(40.0, 15.0, 90.0, 22.0, 21.0, 1e9, 0.4, 20.7, 0.4, 0.01, 0.02)


def parted(setup: Setup, path: Path, **parts: Any) -> tuple[CS7B, tuple[FrictionElement, ...]]:
    """Return a controller whose friction model alone is on, each element with these parts, and the elements."""
    elements = tuple(dataclasses.replace(element, **parts) for element in setup.friction.elements)
    by_friction = by_model(setup, inverse_dynamics=False)
    plain = dataclasses.replace(by_friction.controller.feed_forward, acceleration=False)
    alone = dataclasses.replace(by_friction, controller=dataclasses.replace(by_friction.controller, feed_forward=plain))
    return with_friction(alone, elements, path / "friction.yaml").cs7b(), elements


def moved(controller: CS7B, ticks: int, velocity: Array, start: Array = HERE) -> Array:
    """Return what is fed forward at the joints after position ticks at a velocity, Nm, shape (ticks, 6)."""
    zero, torque = np.zeros(6), np.empty((ticks, 6))
    period = controller.rates.position_period
    for k in range(ticks):
        setpoint = np.array([start + k * period * velocity, velocity, zero])
        position_loop(controller.law, controller.state, setpoint, zero, zero)
        torque[k] = controller.reference()[2]
    return torque


def test_load_ripple_and_temperature_are_those_of_the_set_point(shipped: Setup, tmp_path: Path) -> None:
    """In steady motion it is the sliding torque of angle, temperature and load, which Pinocchio tells."""
    ripple = {"joint_harmonic": (3.0,), "joint_amplitude": (0.2,), "joint_phase": (0.4,)}
    load = rx.LoadPart(0.06, 0.11, 0.03, 0.05)
    ticks = 1500
    controller, elements = parted(shipped, tmp_path, load=load, ripple=rx.RipplePart(**ripple), temperature=WARM)
    got = moved(controller, ticks, VELOCITY)[-1]
    late = controller.law["model"]["lead"][0]
    there = HERE + ((ticks - 1) * shipped.rates.position_period + late) * VELOCITY
    # Without acceleration the rotors take nothing: what is transmitted is the weight, the spring's share included.
    weight = rigid_torque(
        shipped.robot.model, shipped.drives.rotor_matrix, shipped.drives.spring_torque,
        there[None], VELOCITY[None], np.zeros((1, 6)),
    )[0]  # fmt: skip
    transmitted = np.array([*weight[:4], weight[4] - weight[5], weight[5], weight[5]])
    want = []
    for element, v, q, size in zip(elements, INPUTS @ VELOCITY, INPUTS @ there, transmitted, strict=True):
        driving, sign = size * v >= 0.0, "positive" if v >= 0.0 else "negative"
        cooler = WARM.start - WARM.reference
        wave = 1.0 + 0.2 * math.cos(3.0 * q + 0.4)
        coulomb, static = getattr(element, f"tau_c_{sign}"), getattr(element, f"tau_s_{sign}")
        static = wave * (coulomb + (static - coulomb) * (1.0 + 0.02 * cooler))
        share = load.driving if driving else load.driven
        rise = static - wave * coulomb + abs(size) * (load.stribeck_driving if driving else load.stribeck_driven)
        stribeck = math.exp(-((abs(v) / (element.omega_s * (1.0 + 0.01 * cooler))) ** element.delta))
        viscous = element.c2 * (0.4 + 0.6 * math.exp(-cooler / 20.7)) * v
        want.append(math.copysign(wave * coulomb + share * abs(size) + rise * stribeck, v) + viscous)
    assert got == pytest.approx(INPUTS.T @ np.array(want), rel=2e-3)
    assert np.abs(transmitted).max() > 20.0


def test_the_model_warms_by_its_friction_and_its_motors(shipped: Setup, tmp_path: Path) -> None:
    """Its temperatures are those of SciPy's solution with the friction and the motors' torques of a steady motion."""
    part = dataclasses.replace(WARM, capacity=2.0, resistance=3.0, static_slope=0.0, speed_slope=0.0)
    winding = Windings(np.full(6, 1.3), np.full(6, 1.0), np.full(6, 50.0), derating=100.0, limit=130.0)
    setup = shipped
    controller, elements = parted(setup, tmp_path, temperature=part)
    assert setup.controller.model is not None
    model = ArmModel(setup.controller.model.constants.arm, elements, dataclasses.replace(setup.drives, winding=winding))
    model.fill(controller.law["model"][0], setup.rates.position_period)
    ticks, drives = 4000, setup.drives
    velocity = 6.0 * VELOCITY
    moved(controller, ticks, velocity, HERE - 0.5 * velocity)
    got = ModelTemperatures(controller.law, controller.state).now
    period, speed = setup.rates.position_period, INPUTS @ velocity
    viscous = np.array([element.c2 for element in elements]) * speed
    dry = np.array([element.sliding_torque(v) for element, v in zip(elements, speed, strict=True)]) * np.sign(speed)

    def rates(t: float, warm: Array) -> Array:
        torque = dry + viscous * (0.4 + 0.6 * np.exp(-(warm - part.reference) / part.viscous_scale))
        there = HERE + (t - 0.5) * velocity
        joints = rigid_torque(
            setup.robot.model, drives.rotor_matrix, drives.spring_torque, there[None], velocity[None], np.zeros((1, 6))
        )[0]
        motor = np.linalg.solve(coupling_matrix().T, joints + INPUTS.T @ torque) / drives.gear
        heat = 1.3 * (motor / drives.torque_constant) ** 2
        inflow = torque * speed + np.array([*heat[:5], 0.0, heat[5]])
        return np.asarray((inflow - (warm - part.ambient) / part.resistance) / part.capacity)

    solved = solve_ivp(rates, (0.0, ticks * period), np.full(7, part.start), rtol=1e-8, atol=1e-8)
    # The bristles' way to sliding is the rest of the difference.
    assert np.abs(got - solved.y[:, -1]).max() < 5e-3 * np.ptp(solved.y[:, -1])
    assert np.ptp(solved.y[:, -1]) > 2.0


def test_without_torque_the_model_cools_and_remembers(shipped: Setup, tmp_path: Path) -> None:
    """Behind a release, skipped time and a switch off it goes on from an exponential; behind a reset from the start."""
    part = dataclasses.replace(WARM, capacity=0.5, resistance=2.0)
    controller, _ = parted(shipped, tmp_path, temperature=part)
    rest, period = np.zeros(6), shipped.rates.position_period
    believed = ModelTemperatures(controller.law, controller.state)
    controller.reset(rest)
    moved(controller, 500, 6.0 * VELOCITY)
    hot = believed.now - part.ambient
    assert hot.min() > 0.5
    assert hot.max() > 5.0
    controller.release(rest, 4 * 300)
    controller.skip(200)
    for tick in range(controller.tick, controller.tick + 4 * 100):
        controller.release(rest, tick + 1)
    want = part.ambient + hot * math.exp(-600 * period / (part.capacity * part.resistance))
    assert believed.now == pytest.approx(want, rel=1e-9)
    # The next tick of the position loop goes on from there; at rest friction heats nothing.
    moved(controller, 1, rest)
    assert believed.now == pytest.approx(part.ambient + (want - part.ambient) * math.exp(-2.0 * 0.5e-3), rel=1e-6)
    controller.reset(rest)
    moved(controller, 1, rest)
    gain = -math.expm1(-period / (part.capacity * part.resistance))
    assert believed.now == pytest.approx(part.start + gain * (part.ambient - part.start), rel=1e-12)


KINDS: dict[str, Callable[[FrictionElement], Any]] = {
    "elasto_plastic": lambda _: ElastoPlastic(0.7),
    "maxwell_slip": lambda element: MaxwellSlip((0.5, 0.3, 0.2), (0.2, 0.3, 0.5), 20.0 * element.tau_c_positive),
}


def test_at_rest_parts_move_nothing(shipped: Setup, tmp_path: Path) -> None:
    """Once the set-points rest, load and temperature go on changing, and what is fed forward keeps its bits."""
    load, part = rx.LoadPart(0.2, 0.3, relax_time=0.1), dataclasses.replace(WARM, capacity=0.5)
    for name, kind in KINDS.items():
        elements = [
            dataclasses.replace(e, load=load, temperature=part, bristles=kind(e)) for e in shipped.friction.elements
        ]
        setup = with_friction(by_model(shipped, inverse_dynamics=False), elements, tmp_path / f"{name}.yaml")
        controller = setup.cs7b()
        moved(controller, 30, VELOCITY)
        before = controller.state["model"]["friction"]["parts"].copy()
        torque = moved(controller, 200, np.zeros(6), HERE + 0.3)
        after = controller.state["model"]["friction"]["parts"]
        assert np.array_equal(torque[1:], np.tile(torque[1], (199, 1))), name
        assert np.abs(after["load"] - before["load"]).max() > 1.0
        assert np.abs(after["temperature"]["temperature"] - before["temperature"]["temperature"]).min() > 0.01


def test_scatter_counts_with_its_mean(shipped: Setup, tmp_path: Path) -> None:
    """A model of friction that scatters feeds forward the bits of one that does not."""
    files = tmp_path / "scatter", tmp_path / "none"
    for each in files:
        each.mkdir()
    scattered, _ = parted(shipped, files[0], scatter=rx.ScatterPart(0.05, 0.1), load=rx.LoadPart(0.1, 0.1))
    plain, _ = parted(shipped, files[1], load=rx.LoadPart(0.1, 0.1))
    assert np.array_equal(moved(scattered, 300, VELOCITY), moved(plain, 300, VELOCITY))
