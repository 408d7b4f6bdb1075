"""The closed loop tick by tick: as the nodes do it, and written again from the equations."""

import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from own_model import by_model

import rx90_emulator as rx
from rx90_common.base.arrays import Array
from rx90_common.description.robot_files import PAPER
from rx90_controller.law import cs7b

NAMES = tuple(f"joint_{i}" for i in range(1, 7))
REST = np.zeros(6)

_WARM = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
from rx90_controller.law.parameters import MODEL_PARTS
from rx90_controller.trajectory import TrajectoryPoints
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup

def compiled():
    found = set()
    for each in gc.get_objects():
        try:
            if isinstance(each, Dispatcher):
                found |= {(each.py_func.__qualname__, id(each), signature) for signature in each.overloads}
        except ReferenceError:  # a proxy of something gone
            pass
    return found

by_model = {f"controller.feed_forward.{name}": True for name in MODEL_PARTS}
setup = with_parameters(Setup.load(), by_model)
plant, controller = setup.plant(), setup.cs7b()
plant.warm_up()
controller.warm_up()
plant.reset(np.zeros(6))
before = compiled()
assert before
names, rest = controller.joint_names, np.zeros(6)
controller.reset(plant.motor_states()[0])
for velocity, acceleration in ((False, False), (True, False), (True, True)):
    here = controller.trajectory.setpoints(controller.position_tick)[0, 0]
    rows = [here + 1e-3, here + 2e-3]
    points = TrajectoryPoints.create(
        names, names, [0.1, 0.2], rows, [rest if velocity else []] * 2, [rest if acceleration else []] * 2
    )
    controller.trajectory.accept(points, controller.position_tick, None)
    for tick in range(1000):
        if tick in (200, 240):
            controller.trajectory.set_speed_scaling(tick / 240, controller.position_tick)
        if tick == 300:
            controller.trajectory.halt(controller.position_tick)
        position, velocities, _ = plant.motor_states()
        plant.step(controller.step(position, velocities))
        plant.joint_states(), plant.friction_states(), controller.reference(), controller.tracking_error()
        controller.details()
    controller.skip(3)
plant.step(None)
plant.reset(rest)
print(sorted(name for name, _, _ in compiled() - before))
"""


@pytest.mark.slow
def test_everything_is_compiled_before_the_first_tick() -> None:
    """After the warm-up of plant and controller, motions at any speed, reset and brakes compile and load nothing."""
    run = subprocess.run([sys.executable, "-c", _WARM], capture_output=True, text=True, timeout=300, check=False)
    assert (run.stdout, run.stderr) == ("[]\n", "")


REQUESTS: dict[str, Callable[[cs7b.CS7B, Array, int], object]] = {
    "skip": lambda controller, _, count: controller.skip(count),
    "reset": lambda controller, motor, count: controller.reset(motor, count),
    "scale": lambda controller, _, count: controller.trajectory.set_speed_scaling(
        (count % 5) / 4.0, controller.position_tick
    ),
    "halt": lambda controller, _, __: controller.trajectory.halt(controller.position_tick),
}
"""What may come between two ticks, beside a trajectory, with the motors' positions and a number."""


@settings(max_examples=60)
@given(st.data())
def test_looking_ahead_changes_no_bit(shipped: rx.Setup, data: st.DataObject) -> None:
    """Whatever comes between two ticks, commands and set-points are those of a controller that samples each tick."""
    setup = data.draw(st.sampled_from([shipped, by_model(shipped)]))
    several, single = setup.cs7b(), setup.cs7b()
    both = (several, single)
    home = np.array([0.1, 0.3, 1.1, -0.2, 0.7, 0.3])
    motor = home * shipped.drives.gear
    for each in both:
        each.reset(motor)
    for _ in range(data.draw(st.integers(1, 10))):
        what = data.draw(st.sampled_from(["run", "run", "accept", *REQUESTS]))
        count = data.draw(st.integers(1, 400))
        if what == "accept":
            start = several.position_tick + data.draw(st.integers(0, 60))
            to = several.trajectory.setpoints(several.position_tick)[0, 0] + 1e-4 * count
            points = rx.TrajectoryPoints.create(NAMES, NAMES, [0.1 + 1e-3 * count], [to], [REST], [REST])
            for each in both:
                each.trajectory.accept(points, each.position_tick, start)
        elif what != "run":
            for each in both:
                REQUESTS[what](each, motor, count)
        else:
            ahead = ticks(several, motor, count)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(cs7b, "_LOOKAHEAD", 1)
                np.testing.assert_array_equal(ahead, ticks(single, motor, count))


def ticks(controller: cs7b.CS7B, motor: Array, count: int) -> Array:
    """Run ticks with motors at rest; return torques, set-points, their velocities and feed-forward, (count, 4, 6)."""
    return np.array([np.array([controller.step(motor, REST), *controller.reference()]) for _ in range(count)])


TICKS, RATIO, T = 1200, 4, 250e-6
START = np.array([0.3, -0.6, 1.1, 0.4, -0.8, 0.5])
GOAL = START + np.array([0.05, 0.03, -0.04, 0.06, 0.05, -0.07])
SECONDS = 0.2  # of the quintic; the rest is at rest, presliding
N = np.eye(6)
N[5, 4] = 1.0
E = np.vstack([np.eye(6), [0, 0, 0, 0, 1, 1]])


def limit(x: Array, bound: Array | float) -> Array:
    return np.minimum(np.maximum(x, -bound), bound)


def set_points(k: int) -> tuple[Array, Array]:
    """Return place and velocity of the rest-to-rest quintic from START to GOAL at position tick k."""
    s = min(k * RATIO * T / SECONDS, 1.0)
    way = GOAL - START
    return (START + way * (10 * s**3 - 15 * s**4 + 6 * s**5), way * (30 * s**2 - 60 * s**3 + 30 * s**4) / SECONDS)


class Controller:
    """Position, velocity and current loop of docs/explanation/closed_loop.md, or the paper's to the letter."""

    def __init__(self, setup: rx.Setup, literal: bool) -> None:
        self.literal = literal
        self.c, self.n = setup.controller, setup.drives.gear
        self.kt, self.peak = setup.drives.torque_constant, setup.drives.peak_current
        self.integral, self.current, self.sign = np.zeros(6), np.zeros(6), np.zeros(6)
        self.held, self.rate = np.zeros(6), np.zeros(6)

    def position_loop(self, k: int, theta: Array) -> None:
        c, n = self.c, self.n
        r, dr = (n * (N @ x) for x in set_points(k))
        ddr = (n * (N @ set_points(k + 1)[1]) - dr) / (RATIO * T)
        e = r - theta
        advanced = limit(self.integral + c.inertia / n**2 * c.servo.ki * RATIO * T * e, c.servo.integrator_limit / n)
        self.integral = np.where(e * self.sign > 0, self.integral, advanced)
        pi = c.inertia / n**2 * c.servo.kv * c.servo.kp * e + self.integral
        ramp = np.sign(dr / n) if self.literal else limit(dr / (n * c.feed_forward.coulomb_velocity), 1.0)
        coulomb = c.feed_forward.coulomb_torque / n * ramp
        a = c.viscous_exponent
        viscous = c.feed_forward.viscous_friction / np.abs(n) ** (1 + a) * np.sign(dr) * np.abs(dr) ** a
        forward = c.inertia / n**2 * ddr + coulomb + viscous
        self.held, self.rate = pi + forward, np.zeros(6) if self.literal else dr

    def velocity_loop(self, w: Array) -> Array:
        c = self.c
        wanted = (self.held + c.inertia / self.n**2 * c.servo.kv * (self.rate - w)) / self.kt
        self.sign = np.where(np.abs(wanted) > self.peak, np.sign(wanted), 0.0)
        gain = 1 - np.exp(-2 * np.pi * c.current_loop.bandwidth * T)
        self.current = self.current + limit(
            gain * (limit(wanted, self.peak) - self.current), np.array(c.current_loop.slew_rate) * T
        )
        return self.kt * self.current


class Arm:
    """Drives, friction, arm, resolvers of docs/explanation/closed_loop.md, or the paper's constant c1; no end stops."""

    def __init__(self, setup: rx.Setup, literal: bool) -> None:
        self.literal = literal
        self.model, drives = setup.robot.model, setup.drives
        self.data = self.model.createData()
        self.n, self.peak, self.k = drives.gear, drives.torque_constant * drives.peak_current, drives.spring_torque
        self.rotors = np.diag(drives.rotor_inertia)
        self.rotors[4, 4] += drives.rotor_inertia[5]
        self.rotors[4, 5] = self.rotors[5, 4] = drives.rotor_inertia[5]
        self.elements = setup.friction.elements
        self.count = 2 * np.pi / drives.encoder_counts
        self.p = np.exp(-2 * np.pi * drives.velocity_bandwidth * T)
        self.q, self.v, self.z, self.a, self.d = START.copy(), np.zeros(6), np.zeros(7), np.zeros(6), np.zeros(6)
        self.mass, _ = self.mass_and_bias(self.q, self.v)
        self.y, self.w = self.n * (N @ self.q), np.zeros(6)
        self.theta = self.count * np.round(self.y / self.count)

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        upper = np.triu(pin.crba(self.model, self.data, q))
        bias = pin.nonLinearEffects(self.model, self.data, q, v).copy()
        bias += self.k * np.sin(q)
        return upper + np.triu(upper, 1).T + self.rotors, bias

    def friction(self, v: Array) -> Array:
        torques = np.empty(7)
        for i, (e, speed) in enumerate(zip(self.elements, v, strict=True)):
            coulomb, static = (
                (e.tau_c.positive, e.tau_s.positive) if speed >= 0 else (e.tau_c.negative, e.tau_s.negative)
            )
            g = coulomb + (static - coulomb) * np.exp(-((abs(speed) / e.omega_s) ** e.delta))
            x = T * e.c0 * abs(speed) / g
            # Below, the quotients cancel; their Taylor series are exact to rounding.
            phi = -np.expm1(-x) / x if x > 1e-4 else 1 - x / 2 + x * x / 6
            psi = (1 - phi) / x if x > 1e-4 else 0.5 - x / 6 + x * x / 24
            rate = speed - e.c0 * abs(speed) * self.z[i] / g
            damping = e.c1 if self.literal else e.c1 * np.exp(-((speed / e.omega_d) ** 2))
            torques[i] = e.c0 * (self.z[i] + T * rate * psi) + damping * rate * phi
            torques[i] += e.c2 * speed * max(abs(speed), 1e-3) ** (e.alpha - 1)
            self.z[i] += T * rate * phi
        return torques

    def step(self, u: Array) -> None:
        before, self.d = self.d, N.T @ (self.n * limit(u, self.peak))
        a = self.a + np.linalg.solve(self.mass, self.d - before)
        v_m, q_m = self.v + T / 2 * a, self.q + T / 2 * (self.v + T / 4 * a)
        torque = self.d - E.T @ self.friction(E @ v_m)
        self.mass, bias = self.mass_and_bias(q_m, v_m)
        self.a = np.linalg.solve(self.mass, torque - bias)
        self.q = self.q + T * (self.v + T / 2 * self.a)
        self.v = self.v + T * self.a
        angle, guess = self.n * (N @ self.q), self.y + T * self.w
        self.y = guess + (1 - self.p**2) * (angle - guess)
        self.w = self.w + (1 - self.p) ** 2 / T * (angle - guess)
        self.theta = self.count * np.round(angle / self.count)


EXPONENTS = {
    "friction.joint_1.alpha": 0.6,
    "friction.joint_2.alpha": 0.8,
    "friction.joint_5_6.alpha": 1.3,
    "controller.viscous_exponent[0]": 0.6,
    "controller.viscous_exponent[1]": 0.9,
    "controller.viscous_exponent[5]": 1.2,
}


@pytest.mark.filterwarnings("ignore:.*not passive")
@pytest.mark.parametrize(
    ("changes", "literal"),
    [({}, False), (EXPONENTS, False), ({}, True)],
    ids=["as shipped", "viscous exponents", "the paper"],
)
def test_the_page_suffices_to_write_the_loop_again(shipped: rx.Setup, changes: dict[str, float], literal: bool) -> None:
    """Joints, bristles and motor torques of a move and the rest after it agree to rounding; so do the paper's."""
    setup = rx.with_parameters(shipped, changes)
    points = rx.TrajectoryPoints(np.array([0.0, SECONDS]), np.array([START, GOAL]), np.zeros((2, 6)), np.zeros((2, 6)))
    ours = rx.simulate(rx.load_setup(robot=PAPER) if literal else setup, points, START, TICKS * T, record_fast=True)
    arm, controller = Arm(setup, literal), Controller(setup, literal)
    joints, bristles, motors = [], [], []
    for k in range(TICKS):
        if k % RATIO == 0:
            joints.append([arm.q, arm.v])
            bristles.append(arm.z.copy())
            controller.position_loop(k // RATIO, arm.theta)
        motors.append(controller.velocity_loop(arm.w))
        arm.step(motors[-1])
    assert np.ptp(ours.slow.joint_states[:, 0], axis=0).min() > 0.02
    assert ours.slow.joint_states[:, :2] == pytest.approx(np.array(joints), abs=1e-10)
    assert ours.slow.friction_states[:, 0] == pytest.approx(np.array(bristles), abs=1e-11)
    assert ours.fast.motor_commands == pytest.approx(np.array(motors), abs=1e-6)
