"""The random arms that the identification from excitation runs is measured with, and logs that are poor."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.excitation_coverage import Truth, truth_of
from benchmarks.excitation_runs import NOISE, NOTHING, Disturbances, FourierMotion, measured, write_run
from benchmarks.poor_logs import CONDITIONS, experiment
from benchmarks.random_arms import FrictionLaw, random_arm
from rx90_emulator.identification.arm import RigidArm
from rx90_emulator.identification.records import read_record
from rx90_emulator.identification.robot import arm_layout


def test_the_bristle_is_that_of_a_stiff_solver() -> None:
    """Along a motion with reversals the bristle's torque is that of an implicit solver within 0.1 %."""
    law = FrictionLaw((5.0, 4.0), 2.0, 0.7, 0.4, 0.1, 1.2, c0=2e4, c1=10.0)
    time = np.arange(0.0, 1.0, 2e-3)

    def velocity(t: float) -> np.float64:
        return np.float64(0.5 * np.sin(9.0 * t))

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        v = velocity(t)
        sliding = (5.0 if v >= 0.0 else 4.0) * (1.0 + 0.4 * np.exp(-((abs(v) / 0.1) ** 1.2)))
        return np.asarray(v - abs(v) * 2e4 / sliding * z)

    solved = solve_ivp(rate, (0.0, 1.0), [0.0], "LSODA", time, rtol=1e-7, atol=1e-12, max_step=1e-3).y
    v = velocity(time)  # type: ignore[arg-type]
    torque = 2e4 * solved[0] + 10.0 * np.array([rate(t, z)[0] for t, z in zip(time, solved.T, strict=True)])
    torque += 2.0 * np.abs(v) ** 0.7 * np.sign(v)
    assert law.torque(time, v, substeps=20) == pytest.approx(torque, abs=0.02)


@pytest.mark.parametrize("coupled", [True, False])
def test_a_run_is_the_robots_of_its_urdf(tmp_path: Path, coupled: bool) -> None:
    """Bag and URDF, read as those of any robot, give the torque of links, rotors and spring, and friction on top."""
    arm = random_arm(4, 3, coupled=coupled, stribeck=False)
    run = measured(arm, FourierMotion.random(arm, 1, periods=1), 100.0, 0, NOTHING)
    bag, urdf = write_run(run, arm, tmp_path)
    record = read_record(bag, arm_layout("joint_states", arm.names))
    read = RigidArm.from_urdf(urdf, coupling=arm.coupling, rotor_inertia=arm.rotor, spring=arm.spring)
    rest = record.torque - read.torque(*run.exact) - arm.offset
    inputs = run.exact[1] @ read.element_matrix.T
    friction = np.zeros_like(inputs)
    for k, law in enumerate(arm.friction):
        side = np.where(inputs[:, k] > 0.0, law.tau_c[0], -law.tau_c[1]) * (inputs[:, k] != 0.0)
        friction[:, k] = side + law.c2 * np.sign(inputs[:, k]) * np.abs(inputs[:, k]) ** law.alpha
    assert rest == pytest.approx(friction @ read.element_matrix, abs=1e-9)
    assert record.position == pytest.approx(run.exact[0], abs=1e-12)


def test_without_misfit_the_best_fitting_parameters_are_the_true_ones() -> None:
    """With friction of the model's own form the limit of many runs is the friction; load adds its mean to Coulomb's."""
    arm = random_arm(6, 2, coupled=True)
    laws = [FrictionLaw((law.coulomb, law.coulomb), law.c2, law.alpha, 0.4, 0.1) for law in arm.friction]
    arm = replace(arm, friction=tuple(laws), offset=np.array([0.3, -0.2]))

    def truth(disturbances: Disturbances) -> Truth:
        def offsets(*motion: np.ndarray) -> np.ndarray:
            bare = arm.frictionless(*motion) - arm.offset
            return np.concatenate([bare[:, :, None], np.broadcast_to(np.eye(2), (len(bare), 2, 2))], axis=2)

        return truth_of(arm, offsets, np.ones(2), disturbances, lambda seed: FourierMotion.random(arm, seed), 8)

    exact = truth(NOISE)
    assert exact.base == pytest.approx([1.0, 0.3, -0.2], abs=1e-5)
    for name, values in (("coulomb", exact.coulomb), ("c2", exact.viscous), ("alpha", exact.exponent)):
        assert values == pytest.approx([getattr(law, name) for law in laws], rel=1e-4)
    assert exact.rise == pytest.approx(0.4, rel=1e-3)
    growth = truth(Disturbances(load=0.05)).coulomb / exact.coulomb - 1.0
    assert ((growth > 0.01) & (growth < 0.09)).all()


@pytest.mark.parametrize("condition", CONDITIONS)
def test_a_poor_log_gives_intervals_that_hold_and_no_wrong_verdict(condition: str) -> None:
    """Of one arm nothing is refused but a negated torque, an unseen run is confirmed, and intervals hold."""
    outcome = experiment((2, condition))
    assert not outcome.wrong
    assert (condition == "negated torque") == (not outcome.held)
    if outcome.held:
        assert np.mean(outcome.held) >= (0.75 if condition == "dead joint" else 0.85)
