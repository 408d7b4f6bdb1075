"""Arms with elastic gears for tests, and their equations once more, independent of the product."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from lugre_oracle import LuGreOracle
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp

from benchmarks.hybrid_reference import negligible_element
from rx90_common.base.arrays import Array
from rx90_common.description.drives import MOTOR
from rx90_common.friction import FrictionSet
from rx90_common.rigid_torque import rigid_torque
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

WRIST = np.eye(6)
WRIST[5, 4] = 1.0  # what the drives turn for turns of the joints: drive 6 turns with joints 5 and 6
INPUTS = np.vstack([np.eye(6), WRIST[5]])  # input velocities of the seven friction elements for joint velocities
SOFT = np.array([1.5e5, 1.5e5, 5e4, 1e4, 6e3, 2e3])
"""Stiffnesses, Nm/rad, that put the shipped arm's frequencies between 14 and 110 Hz."""
POSE = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])


def elastic(
    setup: Setup, stiffness: ArrayLike, damping: ArrayLike = 0.0, backlash: ArrayLike = 0.0, side: str = MOTOR
) -> Setup:
    given = {"stiffness": stiffness, "damping": damping, "backlash": backlash}
    values = {name: np.broadcast_to(np.asarray(value, float), 6) for name, value in given.items()}
    return dataclasses.replace(setup, drives=setup.drives.replaced(elasticity={**values, "friction": side}))


def floating(setup: Setup) -> Setup:
    """Return a setup without gravity, springs and friction, whose joints have no ends to speak of."""
    far = np.full(6, 1e6)
    robot = dataclasses.replace(
        setup.robot, chain=setup.robot.chain._replace(gravity=np.zeros(3)), lower=-far, upper=far, max_velocity=far
    )
    friction = FrictionSet(setup.friction.names, (negligible_element(),) * 7)
    drives = setup.drives.replaced(spring={"torque": np.zeros(6)})
    return dataclasses.replace(setup, robot=robot, drives=drives, friction=friction)


def link_mass(setup: Setup, q: Array) -> Array:
    """Return the mass matrix of the links without rotors, by Pinocchio, kg m^2."""
    upper = np.triu(pin.crba(setup.robot.model, setup.robot.model.createData(), q))
    return np.asarray(upper + np.triu(upper, 1).T)


def free(plant: Plant, q: Array) -> Any:
    plant.reset(q)
    plant.step(np.zeros(6))  # opens the brakes
    plant.reset(q)
    state = plant.state[0]
    state["brakes_closed"] = 0
    return state


def snapshot(plant: Plant) -> Array:
    """Return (q, v, twist, twist's rate, z), shape (31,)."""
    state = plant.state[0]
    gears = state["transmission"]
    return np.concatenate([state["q"], state["v"], gears["twist"], gears["rate"], state["z"]])


def contact_torque(twist: ArrayLike, rate: ArrayLike, stiffness: ArrayLike, damping: ArrayLike, half: ArrayLike) -> Any:
    """Return the transmitted torque by its definition, for numbers or arrays."""
    twist, half = np.asarray(twist), np.asarray(half)
    depth = np.abs(twist) - half
    push = np.maximum(0.0, np.asarray(stiffness) * depth + np.asarray(damping) * rate * np.sign(twist))
    return np.where(half == 0, stiffness * twist + damping * np.asarray(rate), np.sign(twist) * push * (depth > 0))


def energy(setup: Setup, state: Any) -> float:
    """Return kinetic and potential energy of links, rotors and springs, J."""
    elasticity, model = setup.drives.elasticity, setup.robot.model
    q, v, gears = state["q"].copy(), state["v"].copy(), state["transmission"]
    depth = np.maximum(0.0, np.abs(gears["twist"]) - 0.5 * np.array(elasticity.backlash))
    rotors = WRIST @ v + gears["rate"]
    weighs = setup.robot.chain.gravity.any()
    gravity = pin.computePotentialEnergy(model, model.createData(), q) if weighs else 0.0
    gravity -= setup.drives.spring_torque @ np.cos(q)
    springs = np.where(elasticity.elastic, elasticity.stiffness, 0.0) @ depth**2
    return float(0.5 * (v @ link_mass(setup, q) @ v + setup.drives.rotor_inertia @ rotors**2 + springs) + gravity)


def solved(setup: Setup, start: Array, motor: Sequence[Array], duration: float) -> Array:
    """Return snapshots after each of the motor torques, Nm, was held for `duration`, by LSODA, shape (n, 31)."""
    elasticity, lugre = setup.drives.elasticity, LuGreOracle(setup.friction.elements)
    on_links = elasticity.friction != MOTOR
    to_joints = np.linalg.inv(WRIST)

    def rates(_: float, y: Array, drive: Array) -> Array:
        q, v, twist, rate, z = y[:6], y[6:12], y[12:18], y[18:24], y[24:]
        states = (np.tile(x, (7, 1)) for x in (q, v))
        torque = rigid_torque(
            setup.robot.model, np.zeros((6, 6)), setup.drives.spring_torque, *states, np.eye(7, 6, -1)
        )
        passed = contact_torque(
            twist, rate, elasticity.stiffness, elasticity.damping, 0.5 * np.array(elasticity.backlash)
        )
        z_dot, friction = lugre.rates(z, INPUTS @ (v if on_links else v + to_joints @ rate))
        friction = INPUTS.T @ friction
        links = np.linalg.solve((torque[1:] - torque[0]).T, WRIST.T @ passed - torque[0] - friction * on_links)
        rotors = (drive - passed - to_joints.T @ friction * (not on_links)) / setup.drives.rotor_inertia
        return np.concatenate([v, links, rate, rotors - WRIST @ links, z_dot])

    found = []
    for one in motor:
        result = solve_ivp(
            rates, (0.0, duration), start, "LSODA", rtol=1e-9, atol=1e-11, args=(setup.drives.gear * one,)
        )
        assert result.success
        start = result.y[:, -1]
        found.append(start)
    return np.array(found)


def random_cycles(setup: Setup, seed: int, ticks: int, potential: Callable[[Array], float]) -> tuple[float, float]:
    """Return the energy that 10^4 cycles create, and what the motors move, J, in a potential of their angles."""
    plant, rng, peak = setup.plant(), np.random.default_rng(seed), setup.drives.peak_torque
    state, gear = free(plant, POSE), setup.drives.gear
    gears = state["transmission"]
    last = WRIST @ state["q"] + gears["twist"]
    start, work, moved = energy(setup, state) + potential(gear * last), 0.0, 0.0
    for _ in range(10_000):
        wanted = rng.uniform(-1.0, 1.0, 6)
        for _ in range(ticks):
            plant.step((wanted - 0.3 * (WRIST @ state["v"] + gears["rate"])) * peak)  # or the arm would spin up
            turned = WRIST @ state["q"] + gears["twist"]
            done = plant.motor_states()[2] * gear * (turned - last)
            work, moved, last = work + done.sum(), moved + np.abs(done).sum(), turned
    return energy(setup, state) + potential(gear * last) - start - work, moved
