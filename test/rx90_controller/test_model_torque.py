"""The feed-forward by a model of arm and friction, without parts and with them."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from full_friction import TEMPERATURE
from own_model import by_model, with_friction
from parted_joint import steady
from scipy.integrate import solve_ivp

from rx90_common.base.arrays import Array
from rx90_common.description.coupling import RX_WRIST
from rx90_common.description.drives import COLD
from rx90_common.friction import FrictionElement
from rx90_common.friction.compiled_elements import prescribed_torque
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.rigid_torque import rigid_torque
from rx90_controller.law.cs7b import CS7B, law_reset, law_state_dtype, position_loop
from rx90_controller.law.model import ArmModel
from rx90_emulator.loop.closed_loop import run_ticks
from rx90_emulator.loop.result import empty_series
from rx90_emulator.loop.setup import Setup

INPUTS = RX_WRIST.element_matrix


def lead(setup: Setup) -> float:
    """Return how much later than its set-point a torque acts in the mean, s: held, and behind the current loop."""
    rates = setup.rates
    gain = 1.0 - math.exp(-2.0 * math.pi * setup.controller.current_loop.bandwidth * rates.period)
    shares = gain * (1.0 - gain) ** np.arange(200)  # of the answer to a pulse
    return 0.5 * rates.position_period + rates.period * float(np.arange(200) @ shares)


def without_acceleration(setup: Setup) -> Setup:
    feed_forward = setup.controller.feed_forward.replaced(acceleration=False)
    return dataclasses.replace(setup, controller=setup.controller.replaced(feed_forward=feed_forward))


def friction_alone(setup: Setup) -> Setup:
    return without_acceleration(by_model(setup, inverse_dynamics=False))


def fed_forward(setup: Setup, setpoints: Array) -> Array:
    """Return what a controller that begins at rest feeds forward at the joints, Nm, shape (n, 6)."""
    law = setup.controller.record(setup.robot, setup.drives, setup.rates)
    state = np.zeros(1, law_state_dtype(RX_WRIST.size))
    law_reset(state)
    torque = np.empty((len(setpoints), 6))
    for k, setpoint in enumerate(setpoints):
        position_loop(law, state, setpoint, np.zeros(6), np.zeros(6))
        torque[k] = RX_WRIST.turns.T @ (setup.drives.gear * state["feed_forward"][0])
    return torque


def moving(setup: Setup, velocity: Array) -> Array:
    """Return set-points of these velocities, rad/s, shape (n, 6), that do not accelerate in their ticks."""
    setpoints = np.zeros((len(velocity), 3, 6))
    setpoints[:, 1] = velocity
    setpoints[:, 0] = np.cumsum(velocity, axis=0) * setup.rates.position_period
    return setpoints


@pytest.mark.parametrize("robot", ["shipped", "tx40"])
def test_the_inverse_dynamics_are_those_of_the_model(request: pytest.FixtureRequest, robot: str) -> None:
    """At 50 set-points: Pinocchio's torque with tool, rotors, coupling and spring, where the set-point will be."""
    setup: Setup = request.getfixturevalue(robot)
    rng, late = np.random.default_rng(13), lead(setup)
    low, high = setup.robot.lower, setup.robot.upper
    q, v = rng.uniform(low, high, (50, 6)), rng.uniform(-1.0, 1.0, (50, 6)) * setup.robot.max_velocity
    a = rng.uniform(-20.0, 20.0, (50, 6))
    got = fed_forward(by_model(setup, friction_model=False), np.stack([q, v, a], axis=1))
    friction = fed_forward(without_acceleration(setup), np.stack([q, v, a], axis=1))
    drives, model = setup.drives, setup.robot.model
    at = (q + late * (v + 0.5 * late * a), v + late * a, a)
    want = rigid_torque(model, drives.rotor_matrix, drives.spring_torque, *at)
    assert np.abs(got - friction - want).max() < 1e-12 * np.abs(want).max()


def test_the_bristles_of_the_model_are_the_plant_s(shipped: Setup) -> None:
    """Through reversals: the torque of the plant's own law at the velocities of when it acts in the mean."""
    setup = friction_alone(shipped)
    period = shipped.rates.position_period
    ticks, turn = np.arange(600), 2.0 * math.pi / period / (100.0 + 40.0 * np.arange(6))
    angle = turn * period * ticks[:, None]
    velocity, acceleration = 0.05 * np.sin(angle), 0.05 * turn * np.cos(angle)
    setpoints = moving(shipped, velocity)
    setpoints[:, 2] = acceleration
    got = fed_forward(setup, setpoints)
    there = velocity + lead(shipped) * acceleration
    want = prescribed_torque(shipped.friction.elements, there @ INPUTS.T, np.full(len(ticks), period)) @ INPUTS
    assert np.abs(got - want).max() < 1e-9


def test_a_reset_begins_with_undeflected_bristles(shipped: Setup) -> None:
    """After motion and a reset, a resting controller feeds nothing forward for friction; without the reset it does."""
    controller = by_model(shipped, inverse_dynamics=False).cs7b()
    here = np.zeros(6)
    controller.reset(here)
    for setpoint in moving(shipped, np.full((50, 6), 0.05)):
        position_loop(controller.law, controller.state, setpoint, here, here)
    controller.step(here, here)
    assert np.all(np.abs(controller.reference()[2]) > 0.5)
    controller.reset(here)
    controller.step(here, here)
    assert np.array_equal(controller.reference()[2], np.zeros(6))


def test_a_friction_model_that_was_off_begins_undeflected(shipped: Setup) -> None:
    """Switched on again where the set-points rest, it feeds nothing forward; left on, it holds what it had."""
    off, on = (
        setup.controller.record(setup.robot, setup.drives, setup.rates)
        for setup in (shipped, by_model(shipped, inverse_dynamics=False))
    )
    setpoints, here = moving(shipped, np.full((50, 6), 0.05)), np.zeros(6)
    rest = setpoints[-1] * np.array([[1.0], [0.0], [0.0]])
    for between, left in ((on, True), (off, False)):
        state = np.zeros(1, law_state_dtype(RX_WRIST.size))
        law_reset(state)
        for law, setpoint in (*((on, one) for one in setpoints), (between, rest), (on, rest)):
            position_loop(law, state, setpoint, here, here)
        assert state["feed_forward"][0].any() == left


def held(setup: Setup, other: Setup, ticks: int) -> tuple[Array, Any]:
    """Return how far a held pose goes under another controller's constants, rad, (n, 6), and the state."""
    plant, controller = setup.plant(), setup.cs7b()
    pose = np.array([0.1, 0.5, 1.2, 0.2, 0.9, 0.3])
    plant.reset(pose)
    controller.reset(plant.motor_states()[0])
    setpoints = controller.trajectory.setpoints(0, ticks // 2)
    fast, slow = empty_series(2 * ticks, 4, record_fast=False, arm=RX_WRIST.size)
    for first, law in ((0, controller.law), (ticks, other.cs7b().law)):
        run_ticks(plant.constants, plant.state, law, controller.state, setpoints, 4, 4000, first, ticks, fast, slow)
    moved = slow.joint_states[:, 0] - slow.joint_states[ticks // 4, 0]
    return moved[ticks // 4 :], controller.state[0]


def test_switching_it_on_and_off_does_not_move_the_arm(shipped: Setup) -> None:
    """The integrators hand the weight over to the model and take it back, and the arm stays within the counts' play."""
    on = by_model(shipped)
    for before, after, carried in ((shipped, on, False), (on, shipped, True)):
        (still, _), (moved, state) = held(before, before, 8000), held(before, after, 8000)
        assert np.abs(moved).max() < 1.2 * np.abs(still).max() + 1e-6
        assert (np.abs(state["integrator"] * shipped.drives.gear)[1] > 20.0) == carried


def test_integrators_hand_over_no_more_than_they_may_hold(shipped: Setup) -> None:
    """Where the model brings more than an integrator's limit, the integrator stays at it; after a reset at 0."""
    off, on = (
        setup.controller.record(setup.robot, setup.drives, setup.rates)
        for setup in (shipped, by_model(shipped, friction_model=False))
    )
    state, here = np.zeros(1, law_state_dtype(RX_WRIST.size)), np.zeros(6)
    law_reset(state)
    rest = np.zeros((3, 6))
    rest[0, 1] = 1.0  # the upper arm leans forward
    for law in (off, on):
        law["integrator_limit"] = 1e-3
        position_loop(law, state, rest, here, here)
    weight = state["feed_forward"][0]
    assert np.abs(weight).max() > 0.01
    assert state["integrator"][0] == pytest.approx(-np.clip(weight, -1e-3, 1e-3))
    law_reset(state)
    position_loop(on, state, rest, shipped.drives.gear * (RX_WRIST.turns @ rest[0]), here)
    assert not state["integrator"].any()


HERE = np.array([0.3, -0.4, 1.5, 0.4, 0.8, -0.5])
VELOCITY = np.array([0.05, -0.04, 0.06, -0.05, 0.07, 0.03])
WARM = TEMPERATURE.replaced(start=22.0, ambient=21.0, capacity=1e9, resistance=0.4)


def parted(setup: Setup, path: Path, **parts: Any) -> tuple[CS7B, tuple[FrictionElement, ...]]:
    elements = tuple(element.replaced(**parts) for element in setup.friction.elements)
    return with_friction(friction_alone(setup), elements, path / "friction.yaml").cs7b(), elements


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
    load = LoadPart(driving=0.06, driven=0.11, stribeck_driving=0.03, stribeck_driven=0.05)
    ticks = 1500
    controller, elements = parted(shipped, tmp_path, load=load, ripple=RipplePart(**ripple), temperature=WARM)
    got = moved(controller, ticks, VELOCITY)[-1]
    late = controller.law["model"]["lead"][0]
    there = HERE + ((ticks - 1) * shipped.rates.position_period + late) * VELOCITY
    # Without acceleration the rotors take nothing: what is transmitted is the weight, the spring's share included.
    weight = rigid_torque(
        shipped.robot.model, shipped.drives.rotor_matrix, shipped.drives.spring_torque,
        there[None], VELOCITY[None], np.zeros((1, 6)),
    )[0]  # fmt: skip
    transmitted = np.array([*weight[:4], weight[4] - weight[5], weight[5], weight[5]])
    want = [
        steady(element, v, size, WARM.start, wave=1.0 + 0.2 * math.cos(3.0 * q + 0.4))
        for element, v, q, size in zip(elements, INPUTS @ VELOCITY, INPUTS @ there, transmitted, strict=True)
    ]
    assert got == pytest.approx(INPUTS.T @ np.array(want), rel=2e-3)
    assert np.abs(transmitted).max() > 20.0


def temperatures(controller: CS7B) -> Array:
    """Return a view of what the model believes of the joints, degrees Celsius, shape (7,)."""
    view: Array = controller.state["model"]["friction"]["parts"]["temperature"]["temperature"][0]
    return view


def test_the_model_warms_by_its_friction_and_its_motors(shipped: Setup, tmp_path: Path) -> None:
    """Its temperatures are those of SciPy's solution with the friction and the motors' torques of a steady motion."""
    part = WARM.replaced(capacity=2.0, resistance=3.0, static_slope=0.0, speed_slope=0.0)
    six = {"resistance": np.full(6, 1.3), "thermal_resistance": np.ones(6), "heat_capacity": np.full(6, 50.0)}
    winding = COLD.replaced(**six, derating=100.0, limit=130.0)
    controller, elements = parted(shipped, tmp_path, temperature=part)
    model = ArmModel(shipped.controller.model.constants.arm, elements, shipped.drives.replaced(winding=winding))
    model.fill(controller.law["model"][0], shipped.rates.position_period)
    ticks, drives = 4000, shipped.drives
    velocity = 6.0 * VELOCITY
    moved(controller, ticks, velocity, HERE - 0.5 * velocity)
    got = temperatures(controller)
    period, speed = shipped.rates.position_period, INPUTS @ velocity
    viscous = np.array([element.c2 for element in elements]) * speed
    dry = np.array([element.sliding_torque(v) for element, v in zip(elements, speed, strict=True)]) * np.sign(speed)

    def rates(t: float, warm: Array) -> Array:
        torque = dry + viscous * (0.3 + 0.7 * np.exp(-(warm - part.reference) / part.viscous_scale))
        there = HERE + (t - 0.5) * velocity
        states = (there[None], velocity[None], np.zeros((1, 6)))
        joints = rigid_torque(shipped.robot.model, drives.rotor_matrix, drives.spring_torque, *states)[0]
        motor = np.linalg.solve(RX_WRIST.turns.T, joints + INPUTS.T @ torque) / drives.gear
        heat = 1.3 * (motor / drives.torque_constant) ** 2
        inflow = torque * speed + np.array([*heat[:5], 0.0, heat[5]])
        return np.asarray((inflow - (warm - part.ambient) / part.resistance) / part.capacity)

    solved = solve_ivp(rates, (0.0, ticks * period), np.full(7, part.start), rtol=1e-8, atol=1e-8)
    # The bristles' way to sliding is the rest of the difference.
    assert np.abs(got - solved.y[:, -1]).max() < 5e-3 * np.ptp(solved.y[:, -1])
    assert np.ptp(solved.y[:, -1]) > 2.0


def test_without_torque_the_model_cools_and_remembers(shipped: Setup, tmp_path: Path) -> None:
    """Behind a release, skipped time and a switch off it goes on from an exponential; behind a reset from the start."""
    part = WARM.replaced(capacity=0.5, resistance=2.0)
    controller, _ = parted(shipped, tmp_path, temperature=part)
    rest, period = np.zeros(6), shipped.rates.position_period
    believed = temperatures(controller)
    controller.reset(rest)
    moved(controller, 500, 6.0 * VELOCITY)
    hot = believed - part.ambient
    assert hot.min() > 0.5
    assert hot.max() > 5.0
    controller.release(rest, 4 * 300)
    controller.skip(200)
    for tick in range(controller.tick, controller.tick + 4 * 100):
        controller.release(rest, tick + 1)
    want = part.ambient + hot * math.exp(-600 * period / (part.capacity * part.resistance))
    assert believed == pytest.approx(want, rel=1e-9)
    # The next tick of the position loop goes on from there; at rest friction heats nothing.
    moved(controller, 1, rest)
    assert believed == pytest.approx(part.ambient + (want - part.ambient) * math.exp(-2.0 * 0.5e-3), rel=1e-6)
    controller.reset(rest)
    moved(controller, 1, rest)
    gain = -math.expm1(-period / (part.capacity * part.resistance))
    assert believed == pytest.approx(part.start + gain * (part.ambient - part.start), rel=1e-12)


KINDS: dict[str, Callable[[FrictionElement], Any]] = {
    "elasto_plastic": lambda _: ElastoPlastic(break_away=0.7),
    "maxwell_slip": lambda element: MaxwellSlip(
        stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=20.0 * element.tau_c.positive
    ),
}


def test_at_rest_parts_move_nothing(shipped: Setup, tmp_path: Path) -> None:
    """Once the set-points rest, load and temperature go on changing, and what is fed forward keeps its bits."""
    load, part = LoadPart(driving=0.2, driven=0.3, relax_time=0.1), WARM.replaced(capacity=0.5)
    for name, kind in KINDS.items():
        elements = [e.replaced(load=load, temperature=part, bristles=kind(e)) for e in shipped.friction.elements]
        setup = with_friction(by_model(shipped, inverse_dynamics=False), elements, tmp_path / f"{name}.yaml")
        controller = setup.cs7b()
        moved(controller, 30, VELOCITY)
        before = controller.state["model"]["friction"]["parts"].copy()
        torque = moved(controller, 200, np.zeros(6), HERE + 0.3)
        after = controller.state["model"]["friction"]["parts"]
        assert np.array_equal(torque[1:], np.tile(torque[1], (199, 1))), name
        assert np.abs(after["load"]["torque"] - before["load"]["torque"]).max() > 1.0
        assert np.abs(after["temperature"]["temperature"] - before["temperature"]["temperature"]).min() > 0.01


def test_scatter_counts_with_its_mean(shipped: Setup, tmp_path: Path) -> None:
    """A model of friction that scatters feeds forward the bits of one that does not."""
    load, scatter = LoadPart(driving=0.1, driven=0.1), ScatterPart(deviation=0.05, correlation_time=0.1)
    (tmp_path / "plain").mkdir()  # of its own: constants of a file are kept
    scattered, _ = parted(shipped, tmp_path, scatter=scatter, load=load)
    plain, _ = parted(shipped, tmp_path / "plain", load=load)
    assert np.array_equal(moved(scattered, 300, VELOCITY), moved(plain, 300, VELOCITY))
