"""The plant against solvers: the paper's equations, the stiff reference, other bristles."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle, MaxwellSlipOracle, swing
from signed_element import ELEMENT as SIGNED

from benchmarks.accuracy import compare, full_speed, run_plant, scaled, without_rounding
from benchmarks.hybrid_reference import StiffPlant, Work, hybrid_reference
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

POSE = np.array([0.4, 0.9, -0.6, 0.5, 0.3, -0.3])


def test_energy_is_kept_without_friction_to_second_order(
    shipped: Setup, frictionless: FrictionSet, arm_oracle: Any
) -> None:
    """A free arm keeps its energy, spring and rotors included; the error falls fourfold per halving."""
    setup = dataclasses.replace(shipped, friction=frictionless)
    drift, counts = [], np.array([1, 2, 4, 8])
    for substeps in counts:
        plant = setup.plant(int(substeps))
        plant.reset(POSE)
        start = arm_oracle.energy(POSE, np.zeros(6))
        worst = 0.0
        for k in range(1600):
            plant.step(np.zeros(6))
            if k % 16 == 15:
                q, v, _ = plant.joint_states()
                worst = max(worst, abs(arm_oracle.energy(q, v) - start))
        drift.append(worst)
        assert np.all(q > setup.robot.lower + 0.1)
        assert np.all(q < setup.robot.upper - 0.1)
    _, v, _ = plant.joint_states()
    kinetic = 0.5 * v @ arm_oracle.mass_and_bias(q, v)[0] @ v
    assert kinetic > 10.0
    assert -np.polyfit(np.log(counts), np.log(drift), 1)[0] == pytest.approx(2.0, abs=0.25)
    assert drift[0] < 1e-3 * kinetic


BENT = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])


@pytest.fixture(scope="module")
def work() -> Work:
    """Return the reference line up to where the arm has come to speed."""
    return Work.load()._replace(duration=1.2)


def test_the_solver_solves_the_paper_s_equations(shipped: Setup, arm_oracle: Any) -> None:
    """Under switched torques it gives what Radau gives for Pinocchio's arm and the equations of the paper."""
    plant = shipped.plant()
    plant.reset(BENT)
    stiff = StiffPlant(shipped, plant)
    want = stiff.y.copy()
    for torque in ([1.2, -0.8, 0.9, 0.3, -0.2, 0.2], [-1.4, 1.0, -0.3, -0.2, 0.3, 0.1]):
        motor = np.array(torque)
        want = arm_oracle.integrate(want, motor, 20 * shipped.rates.period, 1e-10)
        for _ in range(20):
            stiff.step(motor)
    assert np.abs(want[6:12]).max() > 1e-2
    assert stiff.y == pytest.approx(want, abs=1e-8)


def test_second_order_in_the_closed_loop(work: Work) -> None:
    """Without the encoders' rounding the tip's error falls fourfold per halving of the step, from below 0.2 µm."""
    fine = work._replace(setup=without_rounding(work.setup))
    exact = hybrid_reference(fine.setup, work.points, work.start, work.duration)
    assert np.abs(exact.v).max() > 0.1
    misses = [compare(work.setup, run_plant(fine, work.start, n), exact) for n in (1, 2, 4)]
    for errors in zip(*((m.tip, m.joints.max(), m.bristles.max()) for m in misses), strict=True):
        assert -np.polyfit(np.log([1, 2, 4]), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.2)
    assert misses[0].tip < 0.2e-6


def test_shipped_encoders_move_the_tip_by_a_count_at_most(work: Work) -> None:
    """With the encoders' rounding the tip stays within the micrometre or so that one encoder count is worth."""
    reference = hybrid_reference(work.setup, work.points, work.start, work.duration)
    assert compare(work.setup, run_plant(work, work.start, 1), reference).tip < 1.5e-6


@pytest.mark.parametrize(("stiffening", "rate"), [(1.0, 5.0), (100.0, 500.0)])
def test_full_joint_speed_is_stable(shipped: Setup, stiffening: float, rate: float) -> None:
    """Coasting from full joint speed, bristles many times faster than the tick, the step follows the solver."""
    found = full_speed(scaled(shipped, c0=stiffening))
    assert found.rate > rate
    assert found.joints < 1e-5
    assert found.torque < 1e-4


ELEMENT = SIGNED.replaced(tau_s={"positive": 28.0, "negative": 36.0})
STIFF, SOFT = ElastoPlastic(break_away=0.8), ElastoPlastic(break_away=0.2)
BLOCKS = MaxwellSlip(stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=2000.0)


def force(t: float) -> float:
    """Return a force that makes a mass reverse, stick and slip, Nm."""
    return 45.0 * math.sin(60.0 * t) + 6.0 * math.sin(171.0 * t)


def test_mixed_kinds_in_one_plant(masses: Callable[..., Plant]) -> None:
    """Four joints with four kinds follow solvers with located events; a reset plant does it again to the last bit."""
    elements = [ELEMENT.replaced(bristles=kind) for kind in (STIFF, BLOCKS, None, SOFT)]
    plant, end = masses(elements, 1.5, 16_000), 0.1
    seen = []
    for _ in range(2):
        for k in range(round(end * 16_000)):
            plant.step(np.full(6, force((k + 0.5) / 16_000)) * [1, 1, 1, 1, 0, 0])
        seen.append(np.concatenate([*plant.joint_states()[:2], *plant.friction_states()]))
        plant.reset(np.zeros(6))
    assert seen[0].tolist() == seen[1].tolist()
    position, velocity, z, _, torque = np.split(seen[0], [6, 12, 19, 26])
    for joint, kind in ((0, STIFF), (1, BLOCKS), (3, SOFT)):
        if isinstance(kind, ElastoPlastic):
            oracle: ElastoPlasticOracle | MaxwellSlipOracle = ElastoPlasticOracle(ELEMENT, kind.break_away)
        else:
            oracle = MaxwellSlipOracle(ELEMENT, np.array(kind.stiffness), np.array(kind.share), kind.attraction)
        x, v, turns = swing(oracle, 1.5, force, end, 0.0, 1.0)
        assert turns >= 1
        assert position[joint] == pytest.approx(x, abs=2e-6)
        assert velocity[joint] == pytest.approx(v, abs=1e-4)
        if isinstance(oracle, ElastoPlasticOracle):
            assert torque[joint] == pytest.approx(oracle.torque(z[joint], v), abs=0.1)
    assert len({round(float(x), 6) for x in position[:4]}) == 4  # no two kinds move alike


def test_a_kind_and_another_part_go_together(masses: Callable[..., Plant]) -> None:
    """With a walk too slow to be seen an elasto-plastic joint moves as it does without."""
    alone = ELEMENT.replaced(bristles=STIFF)
    both = alone.replaced(scatter=ScatterPart(deviation=1e-9, correlation_time=100.0))
    plant = masses([alone, both], 1.5)
    for k in range(400):
        plant.step(np.full(6, force((k + 0.5) / 4000)) * [1, 1, 0, 0, 0, 0])
    position = plant.joint_states()[0]
    assert position[0] == pytest.approx(position[1], rel=1e-6)
    assert position[0] != position[1]
