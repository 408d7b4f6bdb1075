"""The emulated rig's mechanics against a stiff solver: shaft, joint with bristles, and the motor's supply."""

import math
from typing import Any

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle
from lugre_oracle import LuGreOracle
from scipy.integrate import solve_ivp

from friction_bench.rig.plant import RigPlant, Shaft, turn
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.arrays import Array
from rx90_common.base.share import config_path
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip


@pytest.fixture(scope="module")
def lugre_rig() -> Rig:
    rig = load_rig(config_path("rig/gm8224_lugre.yaml"))
    return rig.replaced(
        emulation={"amplifier": {"gain_error": 0.0, "torque_noise": 0.0}, "motor_friction": {"coulomb": 0.0}}
    )


def by_solver(shaft: Shaft, state: Array, torque: float, duration: float) -> Array:
    """Return angle and speed of J w' = torque - f_v w - f_c sgn w after a time, from one stop to the next."""
    left = duration
    while left > 1e-12:
        sign = math.copysign(1.0, state[1]) if state[1] else math.copysign(1.0, torque)
        if state[1] == 0.0 and abs(torque) <= shaft.coulomb:
            return state

        def motion(_: float, y: Array, s: float = sign) -> list[float]:
            return [y[1], (torque - s * shaft.coulomb - shaft.viscous * y[1]) / shaft.inertia]

        def stops(_: float, y: Array, s: float = sign) -> float:
            return s * y[1] + 1e-12

        stops.terminal, stops.direction = True, -1.0
        solved = solve_ivp(motion, (0.0, left), state, events=stops, rtol=1e-10, atol=1e-12, max_step=1e-3)
        state = solved.y[:, -1].copy()
        if solved.status == 1:
            state[1] = 0.0
        left -= float(solved.t[-1])
    return state


def test_a_shaft_turns_as_scipy_integrates_it() -> None:
    """Under torques of both signs a shaft slides, stops, rests, and slides the other way as equations 1 and 2 say."""
    shaft = Shaft(6e-5, 0.05, 1e-3)
    angle, speed, state = 0.0, 0.0, np.zeros(2)
    found, expected = [], []
    for torque in (0.08, -0.08, -0.01, 0.09):
        for _ in range(20):
            angle, speed = turn(angle, speed, torque, shaft, 3e-3)
            state = by_solver(shaft, state, torque, 3e-3)
            found.append((angle, speed))
            expected.append(state.tolist())
    assert np.array(found) == pytest.approx(np.array(expected), rel=1e-6, abs=1e-6)
    speeds = np.array(found)[:, 1]
    assert speeds.max() > 10.0
    assert speeds.min() < -5.0
    assert (speeds == 0.0).any()


def test_back_emf_limits_the_torque(rig: Rig) -> None:
    """At 500 rad/s 24 V leave (24 - 22.5) / 2.6 A; a torque is never below zero."""
    plant = RigPlant(rig.replaced(emulation={"amplifier": {"gain_error": 0.0, "torque_noise": 0.0}}), 0)
    assert plant.motor_torque(0.15, 1e-3) == 0.15
    plant.speed = 500.0
    assert plant.motor_torque(0.15, 1e-3) == pytest.approx((24.0 - 0.045 * 500.0) / 2.6 * 0.045)
    plant.speed = 600.0
    assert plant.motor_torque(0.15, 1e-3) == 0.0


@pytest.mark.parametrize("bristles", [None, ElastoPlastic(break_away=0.5)], ids=["LuGre", "elasto-plastic"])
def test_the_rigs_joint_moves_as_scipy_integrates_it(lugre_rig: Rig, bristles: ElastoPlastic | None) -> None:
    """Under a torque in steps the joint moves as equations 17 to 19 say, with other bristles, too."""
    changes: dict[str, Any] = {"c1": 20.0}  # critical damping: no oscillation whose phase the splitting of steps shifts
    if bristles is not None:
        changes["bristles"] = bristles
    rig = lugre_rig.replaced(emulation={"joint_friction": {"lugre": lugre_rig.emulation.joint.replaced(**changes)}})
    joint = rig.emulation.joint
    plant = RigPlant(rig, 0)
    plant.load(True)
    of_motor = rig.emulation.motor_friction.viscous * rig.gear.ratio * rig.joint_scale
    inertia = rig.emulation.load_inertia + rig.emulation.joint_inertia
    inertia += rig.emulation.motor.rotor_inertia * rig.gear.ratio * rig.joint_scale

    whole = joint.replaced(c2=joint.c2 + of_motor)
    lugre, elasto_plastic = LuGreOracle((whole,)), ElastoPlasticOracle(whole, 0.5)

    def motion(_: float, state: Array, torque: float) -> list[float]:
        _, v, z = state
        if bristles is None:
            z_dot, friction = (float(values[0]) for values in lugre.rates(state[2:], state[1:2]))
        else:
            z_dot, friction = elasto_plastic.rate(z, v), elasto_plastic.torque(z, v)
        return [v, (torque * rig.joint_scale - friction) / inertia, z_dot]

    state, found, expected = np.zeros(3), [], []
    for torque in (0.018, 0.036, 0.012, 0.042, 0.0):  # Nm at the motor
        for _ in range(80):
            plant.advance(torque, 1e-3)
        found.append(plant.angle / rig.gear.ratio)
        solved = solve_ivp(motion, (0.0, 0.08), state, args=(torque,), rtol=1e-9, atol=1e-13, max_step=1e-3)
        state = solved.y[:, -1]
        expected.append(float(state[0]))
    assert found == pytest.approx(expected, rel=5e-3, abs=2e-7)


def test_a_joint_put_on_again_begins_anew(lugre_rig: Rig) -> None:
    """Taking the joint off and on forgets the deflections: the same torques give the same motion to the last bit."""
    joint = lugre_rig.emulation.joint.replaced(
        bristles=MaxwellSlip(stiffness=(0.6, 0.4), share=(0.2, 0.8), attraction=500.0)
    )
    plant, paths = RigPlant(lugre_rig.replaced(emulation={"joint_friction": {"lugre": joint}}), 1), []
    for _ in range(2):
        plant.load(True)
        plant.angle = 0.0
        paths.append([])
        for _ in range(50):
            plant.advance(0.02, 1e-3)
            paths[-1].append((plant.angle, plant.speed, plant.bristle))
    assert paths[0] == paths[1]
    assert paths[0][-1][2] > 0.0
