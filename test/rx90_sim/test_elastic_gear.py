"""One elastic gear with play: the mean torque of a step, its energy, and a joint against a stiff solver."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from elastic_arms import POSE, SOFT, contact_torque, elastic, floating, free, link_mass
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp

from rx90_emulator.loop.setup import Setup
from rx90_sim.elastic_gears import mean_torque
from rx90_sim.plant import Plant

Array = NDArray[np.float64]
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


@pytest.mark.parametrize("damping", [0.0, 1e-4])
def test_a_gear_gives_back_what_was_put_into_it(damping: float) -> None:
    """Over 10^4 random cycles of steps of any size the work put in is the spring's energy, and more with a damper."""
    rng, stiffness, half = np.random.default_rng(3), 1e4, 1e-3
    twists = np.cumsum(rng.normal(0.0, 10.0 ** rng.uniform(-6, -3, 40_000)))
    twists -= 6e-3 * np.round(twists / 6e-3)
    work, moved = 0.0, 0.0
    for begin, end in pairwise(twists):
        done = mean_torque(stiffness, damping * stiffness, half, begin, end - begin, STEP)[0] * (end - begin)
        work, moved = work + done, moved + abs(done)
    stored = [0.5 * stiffness * max(0.0, abs(t) - half) ** 2 for t in (twists[0], twists[-1])]
    turns = np.count_nonzero(np.diff(np.sign(np.diff(twists))))
    assert turns > 10_000
    surplus = work - (stored[1] - stored[0])
    assert surplus == pytest.approx(0.0, abs=1e-10 * moved) if damping == 0.0 else surplus > 0.1 * moved


def one_joint(shipped: Setup, rotor: float, gear: tuple[float, float, float], substeps: int) -> Plant:
    """Return a plant in which joint 1 alone moves, with an elastic gear (stiffness, damping, half the play)."""
    stiffness, damping, backlash = np.full(6, np.inf), np.zeros(6), np.zeros(6)
    stiffness[0], damping[0], backlash[0] = gear[0], gear[1], 2.0 * gear[2]
    setup = elastic(floating(shipped), stiffness, damping, backlash)
    heavy, ones = np.full(6, 1e12), np.ones(6)
    heavy[0] = rotor
    drives = dataclasses.replace(
        setup.drives, rotor_inertia=heavy, gear=ones, torque_constant=ones, peak_current=1e9 * ones,
        brake_stiffness=ones, brake_damping=ones,
    )  # fmt: skip
    return dataclasses.replace(setup, drives=drives).plant(substeps)


def test_all_gears_end_a_step_where_their_torques_lead(shipped: Setup) -> None:
    """Where all six knock against each other, with stiff dampers, each torque is the mean one along its twist's way."""
    rng, half, damping = np.random.default_rng(9), 2e-4, 5e-3 * SOFT
    setup = elastic(floating(shipped), SOFT, damping, 2.0 * half)
    plant = setup.plant()
    free(plant, POSE)
    gears, meetings = plant.state["transmission"][0], 0
    for k in range(600):
        if k % 5 == 0:
            command = rng.uniform(-1.0, 1.0, 6) * setup.drives.peak_torque
        before = gears["twist"].copy()
        plant.step(command)
        ways = gears["twist"] - before
        meetings += np.count_nonzero((np.abs(before) > half) != (np.abs(before + ways) > half))
        for i in range(6):
            want = mean_torque(SOFT[i], damping[i], half, before[i], ways[i], STEP)[0]
            assert gears["torque"][i] == pytest.approx(want, rel=1e-8, abs=1e-6)
    assert meetings > 100


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
    """Return the same of joint 1 of a plant."""
    state = free(plant, POSE)
    gears, command, rows = state["transmission"], np.zeros(6), []
    state["v"][0], gears["twist"][0], gears["rate"][0] = begin[1:]
    for push in pushes:
        command[0] = push
        for _ in range(ticks):
            plant.step(command)
        rows.append([state["q"][0] - POSE[0], state["v"][0], gears["twist"][0], gears["rate"][0]])
    return np.array(rows)
