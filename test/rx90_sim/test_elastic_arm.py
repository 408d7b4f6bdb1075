"""Elastic gears: one joint against closed forms and solvers, and the whole arm."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from elastic_arms import (
    INPUTS,
    POSE,
    SOFT,
    WRIST,
    contact_torque,
    elastic,
    floating,
    free,
    link_mass,
    random_cycles,
    snapshot,
    solved,
)
from scipy import linalg
from scipy.integrate import quad, solve_ivp

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.description.drives import LINK, MOTOR
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_emulator.loop.setup import Setup
from rx90_sim.elastic_gears import mean_torque
from rx90_sim.plant import Plant

COUNTS = np.array([1, 2, 4])


@pytest.mark.parametrize("side", [MOTOR, LINK])
@pytest.mark.parametrize("damping", [0.0, 2e-4])
def test_second_order_for_the_whole_arm(shipped: Setup, side: str, damping: float) -> None:
    """Under torques that jump, links, twists and bristles converge with order 2 to a stiff solver's answer."""
    setup = elastic(shipped, SOFT, damping * SOFT, 0.0, side)
    rng = np.random.default_rng(1)
    pieces = [part * setup.drives.peak_torque for part in rng.uniform(-0.5, 0.5, (2, 6))]
    ticks, errors = 40, []
    start = snapshot(prepared(setup, 2))
    want = solved(setup, start, pieces, ticks * setup.rates.period)
    counts = COUNTS if side == MOTOR else 2 * COUNTS  # friction on links has their inertia alone
    for substeps in counts:
        plant, got = prepared(setup, int(substeps)), []
        for motor in pieces:
            for _ in range(ticks):
                plant.step(motor)
            got.append(snapshot(plant))
        miss = np.abs(np.array(got) - want)
        errors.append([miss[:, rows].max() for rows in np.split(np.arange(31), [6, 12, 18, 24])])
    orders = -np.polyfit(np.log(COUNTS), np.log(np.array(errors)), 1)[0]
    assert orders == pytest.approx(np.full(5, 2.0), abs=0.25)
    assert np.all(np.array(errors[0]) < [1e-4, 1e-2, 1e-4, 2e-2, 1e-5])  # rad, rad/s, rad, rad/s, rad


def prepared(setup: Setup, substeps: int) -> Plant:
    plant = setup.plant(substeps)
    plant.reset(POSE)
    return plant


@pytest.mark.parametrize("pose", [POSE, [-1.0, 0.2, -0.5, 1.4, -0.8, 0.2]])
@pytest.mark.parametrize("locked", [True, False])
def test_eigenfrequencies_are_those_of_mass_and_stiffness(shipped: Setup, pose: Array, locked: bool) -> None:
    """Small motions have the frequencies of the eigenvalue problem, motors held or free, as the step maps them."""
    setup = elastic(floating(shipped), SOFT)
    mass, stiffness = link_mass(setup, np.array(pose)), np.diag(SOFT)
    if locked:
        setup = dataclasses.replace(
            setup, drives=setup.drives.replaced(transmission={"rotor_inertia": np.full(6, 1e12)})
        )
        squares = linalg.eigh(WRIST.T @ stiffness @ WRIST, mass, eigvals_only=True)
    else:
        coupled = stiffness @ WRIST
        both = np.block([[WRIST.T @ coupled, -coupled.T], [-coupled, stiffness]])
        inertia = linalg.block_diag(mass, np.diag(setup.drives.rotor_inertia))
        squares = linalg.eigh(both, inertia, eigvals_only=True)[6:]  # before them six motions of links with motors
    values = np.linalg.eigvals(step_matrix(setup, np.array(pose)))
    period = setup.rates.period
    found = np.sort(np.angle(values[np.angle(values) > 1e-3])) / period
    assert found == pytest.approx(2.0 / period * np.arctan(0.5 * period * np.sqrt(squares)), rel=1e-9)
    assert found == pytest.approx(np.sqrt(squares), rel=3e-3)
    assert np.abs(values) == pytest.approx(1.0, abs=1e-8)


def step_matrix(setup: Setup, pose: Array) -> Array:
    """Return the step's derivative by (q, v, twist, rate) at rest, shape (24, 24)."""
    plant, small, columns = setup.plant(), 1e-6, []
    for k in range(24):
        ends = []
        for sign in (1.0, -1.0):
            state = free(plant, pose)
            gears = state["transmission"]
            holder, name = ((state, "q"), (state, "v"), (gears, "twist"), (gears, "rate"))[k // 6]
            holder[name][k % 6] += sign * small
            plant.step(np.zeros(6))
            ends.append(snapshot(plant)[:24])
        columns.append((ends[0] - ends[1]) / (2.0 * small))
    return np.array(columns).T


@pytest.mark.parametrize("damping", [2e-5, 2e-4])
def test_an_infinite_stiffness_is_the_rigid_plant(shipped: Setup, damping: float) -> None:
    """The way of stiff gears nears that of rigid ones by the inverse of the stiffness, however far above the tick."""
    rigid = way(shipped)
    powers = np.arange(3, 10, 2)
    miss = [np.abs(way(elastic(shipped, SOFT * 10.0**k, damping * SOFT * 10.0**k)) - rigid).max() for k in powers]
    assert np.polyfit(powers, np.log10(miss), 1)[0] == pytest.approx(-1.0, abs=0.05)
    assert miss[-1] < 1e-10  # rad


@pytest.mark.parametrize("side", [MOTOR, LINK])
def test_load_is_what_the_link_gets_whichever_side_friction_is_on(shipped: Setup, side: str) -> None:
    """With friction by load, too, stiff gears move as rigid ones do, be the friction before the gear or behind it."""
    elements = tuple(one.replaced(load=LoadPart(driving=0.3, driven=0.2)) for one in shipped.friction.elements)
    setup = dataclasses.replace(shipped, friction=dataclasses.replace(shipped.friction, elements=elements))
    rigid = way(setup, 2)
    assert np.abs(rigid - way(shipped, 2)).max() > 1e-3  # rad
    miss = [np.abs(way(elastic(setup, SOFT * k, 2e-4 * SOFT * k, 0.0, side), 2) - rigid).max() for k in (1e5, 1e7)]
    assert miss[1] < 0.03 * miss[0] < 1e-8


def test_rigid_and_elastic_gears_share_an_arm(shipped: Setup) -> None:
    """Drives without elasticity beside others move as in the rigid plant: all but one, and that one very stiff."""
    rigid = way(shipped)
    for drive in range(6):
        stiffness = np.full(6, np.inf)
        stiffness[drive] = 1e15
        damping = np.where(np.isinf(stiffness), 0.0, 2e11)
        assert np.abs(way(elastic(shipped, stiffness, damping)) - rigid).max() < 1e-10


def way(setup: Setup, substeps: int = 1) -> Array:
    """Return the joints' way under random torques, rad, shape (200, 6)."""
    plant, rng, rows = prepared(setup, substeps), np.random.default_rng(5), []
    for k in range(200):
        if k % 50 == 0:
            motor = rng.uniform(-0.4, 0.4, 6) * setup.drives.peak_torque
        plant.step(motor)
        rows.append(plant.joint_states()[0].copy())
    return np.array(rows)


@pytest.mark.parametrize("backlash", [0.0, 1e-3])
@pytest.mark.parametrize("side", [MOTOR, LINK])
def test_the_arm_begins_at_rest_in_its_gears(shipped: Setup, backlash: float, side: str) -> None:
    """After a reset nothing moves in any pose: the motors are there, and each gear carries its weight by its twist."""
    setup = elastic(shipped, SOFT, 2e-4 * SOFT, backlash, side)
    plant, rng = setup.plant(), np.random.default_rng(8)
    for _ in range(10):
        pose = rng.uniform(shipped.robot.lower, shipped.robot.upper)
        plant.reset(pose)
        links = plant.joint_states()[0].copy()
        twist = plant.state["transmission"]["twist"][0].copy()
        for _ in range(100):
            plant.step(None)
        assert np.abs(plant.joint_states()[0] - links).max() < 1e-11
        weight = np.linalg.solve(WRIST.T, plant.state["bias"][0])
        half = 0.5 * np.array(setup.drives.elasticity.backlash)
        assert contact_torque(twist, np.zeros(6), SOFT, 0.0, half) == pytest.approx(weight, abs=1e-9)
        encoders = plant.motor_states()[0]
        count = 2.0 * np.pi / setup.drives.encoder_counts
        assert np.all(np.abs(encoders - setup.drives.gear * (WRIST @ pose)) <= 0.5 * count + 1e-9)
        assert links == pytest.approx(pose - np.linalg.solve(WRIST, twist), abs=1e-12)


@pytest.mark.parametrize("side", [MOTOR, LINK])
def test_brakes_hold_the_motors_and_stops_the_links(shipped: Setup, side: str) -> None:
    """With motors held by brakes the links go on to ring; a link driven against its stop leaves its motor behind."""
    setup = elastic(shipped, SOFT, 2e-4 * SOFT, 0.0, side)
    plant = setup.plant()
    plant.reset(np.zeros(6))
    weight = plant.state["transmission"]["twist"][0].copy()
    plant.state["v"][0, 0] = 0.5
    plant.state["transmission"]["rate"][0, 0] = -0.5  # the motors rest
    twists, motors = [], []
    for _ in range(400):
        plant.step(None)
        twists.append(plant.state["transmission"]["twist"][0, 0] - weight[0])
        motors.append(plant.motor_states()[0][0] / setup.drives.gear[0])
    assert np.ptp(twists) > 1e-3
    assert np.ptp(motors) < 0.1 * np.ptp(twists)

    upper = np.full(6, 10.0)
    upper[0] = 0.0
    stop = dataclasses.replace(floating(setup), robot=dataclasses.replace(floating(setup).robot, upper=upper))
    plant = stop.plant()
    state = free(plant, np.zeros(6))
    push = np.zeros(6)
    push[0] = 2.0
    for _ in range(16000):
        plant.step(push)
    torque = push[0] * setup.drives.gear[0]
    assert state["q"][0] == pytest.approx(torque / setup.drives.end_stops.stiffness[0], rel=0.02)
    assert state["transmission"]["twist"][0] == pytest.approx(torque / SOFT[0], rel=0.02)


def test_friction_brakes_the_side_that_the_file_names(shipped: Setup) -> None:
    """Friction states show the velocity of the side on which the friction acts, motor 6's for the seventh element."""
    for side in (MOTOR, LINK):
        plant = elastic(shipped, SOFT, 0.0, 0.0, side).plant()
        state = free(plant, POSE)
        state["v"] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
        state["transmission"]["rate"] = [0.01, 0.02, 0.03, 0.04, 0.05, 0.06]
        rotors = WRIST @ state["v"] + (state["transmission"]["rate"] if side == MOTOR else 0.0)
        joints = np.linalg.solve(WRIST, rotors)
        assert plant.friction_states()[1] == pytest.approx([*joints, rotors[5]])


@pytest.mark.parametrize("side", [MOTOR, LINK])
def test_a_ripple_goes_by_the_angle_of_that_side(shipped: Setup, side: str) -> None:
    """In a step with twisted gears the sliding torque is that of the motors' angles, or of the links'."""
    ripple = RipplePart(joint_harmonic=(500.0,), joint_amplitude=(0.5,))
    element = FrictionElement(tau_c=10.0, tau_s=10.0, omega_s=0.05, delta=1.0, c0=1e2, c1=0.0, c2=0.0, ripple=ripple)
    setup = elastic(floating(shipped), SOFT, 0.0, 0.0, side)
    setup = dataclasses.replace(setup, friction=FrictionSet(setup.friction.names, (element,) * 7))
    plant = setup.plant(1)
    plant.constants["friction"]["c0"] = 1e12  # settled as soon as it moves
    state = free(plant, POSE)
    twist = 1e-3 * np.arange(1.0, 7.0)
    state["v"], state["transmission"]["twist"] = 0.3, twist
    plant.step(np.zeros(6))
    joints = POSE + 0.3 * 0.5 * setup.rates.period + (np.linalg.solve(WRIST, twist) if side == MOTOR else 0.0)
    want = 10.0 * (1.0 + 0.5 * np.cos(500.0 * (INPUTS @ joints)))
    assert plant.state["parts"]["friction"][0] == pytest.approx(want, rel=0.02)


@pytest.mark.parametrize("damping", [0.0, 1e-4])
def test_ten_thousand_random_cycles_create_no_energy(shipped: Setup, damping: float) -> None:
    """Over 10^4 random cycles the motors' work is what the arm gains, to 10^-6; dampers only take of it."""
    setup = elastic(floating(shipped), SOFT, damping * SOFT, 2e-3)
    created, moved = random_cycles(setup, 11, 6, lambda _: 0.0)
    assert moved > 1e3  # J, to and fro
    assert created < 1e-6 * moved
    assert -created < 1e-6 * moved if damping == 0.0 else -created > 1e-3 * moved


def test_a_light_rotor_is_refused_where_it_would_have_no_inertia(shipped: Setup) -> None:
    """An elastic drive needs a rotor with inertia; a rigid one does not."""
    drives = shipped.drives.replaced(transmission={"rotor_inertia": shipped.drives.rotor_inertia * [1, 1, 0, 1, 1, 1]})
    setup = dataclasses.replace(shipped, drives=drives)
    with pytest.raises(ConfigError, match=r"rotor_inertia\[2\] is 0.0; accepted: a number > 0 where .* elastic"):
        elastic(setup, SOFT)
    elastic(setup, np.where(np.arange(6) == 2, np.inf, SOFT)).plant()


STEP = 250e-6


def test_the_mean_torque_is_that_along_the_way() -> None:
    """A step's torque is the average of its definition along the way, at the mean rate; the slope is its derivative."""
    rng = np.random.default_rng(2)
    for _ in range(60):
        stiffness, half = 10.0 ** rng.uniform(2, 6), 10.0 ** rng.uniform(-4, -2)
        damping = stiffness * rng.choice([0.0, 1e-4, 1e-3])
        twist, way = rng.uniform(-2.0, 2.0, 2) * half * [1.0, 2.0]
        # Where the definition jumps: flanks that meet, and those that part as soon as the damper would pull.
        lift = half - damping * way / STEP / stiffness
        edges = [(side * place - twist) / way for side in (1, -1) for place in (half, lift)]
        want, _ = quad(
            lambda s, twist=twist, way=way, k=stiffness, d=damping, half=half: float(
                contact_torque(twist + s * way, way / STEP, k, d, half)
            ),
            0.0, 1.0, points=[e for e in edges if 0.0 < e < 1.0] or None, limit=200,
        )  # fmt: skip
        torque, slope = mean_torque(stiffness, damping, half, twist, way, STEP)
        assert torque == pytest.approx(want, rel=1e-6, abs=1e-6 * stiffness * half)
        small = 1e-6 * half
        ahead, behind = (mean_torque(stiffness, damping, half, twist, way + d, STEP)[0] for d in (small, -small))
        scale = 0.5 * stiffness + damping / STEP
        assert slope == pytest.approx((ahead - behind) / (2.0 * small), rel=1e-4, abs=1e-4 * scale)


def one_joint(shipped: Setup, rotor: float, gear: tuple[float, float, float], substeps: int) -> Plant:
    """Return a plant in which joint 1 alone moves, with an elastic gear (stiffness, damping, half the play)."""
    stiffness, damping, backlash = np.full(6, np.inf), np.zeros(6), np.zeros(6)
    stiffness[0], damping[0], backlash[0] = gear[0], gear[1], 2.0 * gear[2]
    setup = elastic(floating(shipped), stiffness, damping, backlash)
    heavy, ones = np.full(6, 1e12), np.ones(6)
    heavy[0] = rotor
    drives = setup.drives.replaced(
        transmission={"rotor_inertia": heavy, "gear": ones},
        motor={"torque_constant": ones, "peak_current": 1e9 * ones},
        brake={"stiffness": ones, "damping": ones},
    )
    return dataclasses.replace(setup, drives=drives).plant(substeps)


def test_a_joint_with_play_against_a_stiff_solver(shipped: Setup) -> None:
    """Rotor, spring, damper, play and link of 50 seeded sets converge with order 2 to LSODA, through all impacts."""
    link, rng, ticks, errors = link_mass(shipped, POSE)[0, 0], np.random.default_rng(7), 100, []
    for case in range(50):
        rotor = 10.0 ** rng.uniform(-0.5, 1.0)
        reduced = rotor * link / (rotor + link)
        speed = 2.0 * np.pi * 10.0 ** rng.uniform(0.7, 1.7)  # 5 to 50 Hz
        stiffness = reduced * speed**2
        damping = 0.0 if case % 3 == 0 else 2.0 * rng.uniform(0.01, 0.3) * reduced * speed
        pushes = 10.0 * rng.uniform(-1.0, 1.0, 4)
        size = 10.0 / stiffness
        half = size * 10.0 ** rng.uniform(-1.0, 0.5)
        begin = np.array([0.0, 0.0, rng.uniform(-1.0, 1.0) * half, rng.uniform(0.5, 1.0) * size * speed])
        gear = (stiffness, damping, half)
        want = two_masses(begin, pushes, (rotor, link), gear, ticks * STEP)
        scale = np.array([1.0, speed, 1.0, speed]) * (size + half)
        miss = []
        for substeps in (1, 4):
            plant = one_joint(shipped, rotor, gear, substeps)
            miss.append(np.abs((driven(plant, begin, pushes, ticks) - want) / scale).max())
        errors.append(miss)
    once, often = np.array(errors).T
    assert np.median(np.log(once / often) / np.log(4)) == pytest.approx(2.0, abs=0.05)
    assert np.median(once) < 1e-3
    assert once.max() < 0.02  # of spring and play; such sets fly through their play several times
    assert often.max() < 0.002


def two_masses(begin: Array, pushes: Array, inertia: Any, gear: Any, duration: float) -> Array:
    """Return link position and velocity, twist and rate after each push, by LSODA, shape (n, 4)."""
    rotor, link = inertia

    def rates(_: float, y: Array, push: float) -> list[float]:
        torque = float(contact_torque(y[2], y[3], *gear))
        return [y[1], torque / link, y[3], (push - torque) / rotor - torque / link]

    rows = []
    for push in pushes:
        result = solve_ivp(rates, (0.0, duration), begin, "LSODA", rtol=1e-10, atol=1e-12, max_step=1e-3, args=(push,))
        assert result.success
        begin = result.y[:, -1]
        rows.append(begin)
    return np.array(rows)


def driven(plant: Plant, begin: Array, pushes: Array, ticks: int) -> Array:
    state = free(plant, POSE)
    gears, command, rows = state["transmission"], np.zeros(6), []
    state["v"][0], gears["twist"][0], gears["rate"][0] = begin[1:]
    for push in pushes:
        command[0] = push
        for _ in range(ticks):
            plant.step(command)
        rows.append([state["q"][0] - POSE[0], state["v"][0], gears["twist"][0], gears["rate"][0]])
    return np.array(rows)
