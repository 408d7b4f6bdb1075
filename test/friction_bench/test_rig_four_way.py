"""The comparison of experiment, equation 3, multibody model and closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from friction_bench.experiment.four_way import (
    BLOCK,
    CLOSED,
    EXPERIMENT,
    MULTIBODY,
    integrate_equation_3,
    simulate_multibody,
)
from friction_bench.experiment.identification import evaluate
from friction_bench.experiment.job import run_ramp
from friction_bench.experiment.record import RampModel
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig, VirtualPort
from friction_bench.rig.plant import Shaft, turn
from friction_bench.rig.rig_file import Rig

MODELS = [
    RampModel(0.03, 6.4e-4, 1.3e-5, 0.02),
    RampModel(0.07, 8.0e-4, 6.3e-5, 0.05),
    RampModel(0.05, 0.02, 3e-3, 0.05),
]


@pytest.mark.parametrize("model", MODELS)
def test_models_and_closed_form_agree_to_a_tenth_of_a_per_cent(model: RampModel) -> None:
    """Equation 3 integrated, the joint in Pinocchio and the closed form differ by less than 0.1 %."""
    time = np.linspace(0.0, 3 * model.break_away_time + 10 * model.time_constant, 80)
    closed = model.velocity(time)
    allowed = 1e-3 * closed[-1]
    assert np.abs(integrate_equation_3(model, time) - closed).max() < allowed
    assert np.abs(simulate_multibody(model, 31.0, time) - closed).max() < allowed


@pytest.mark.parametrize("model", MODELS)
def test_closed_form_solves_equation_3(model: RampModel) -> None:
    """The closed form satisfies J w' = m t - f_v w - f_c, and its integral is the angle."""
    time = model.break_away_time + np.linspace(0.01, 5, 200)
    h = 1e-5
    slope = (model.velocity(time + h) - model.velocity(time - h)) / (2 * h)
    torque = model.slope * time - model.viscous * model.velocity(time) - model.coulomb
    assert model.inertia * slope == pytest.approx(torque, abs=1e-6 * model.slope * time[-1])
    speed = (model.angle(time + h) - model.angle(time - h)) / (2 * h)
    assert speed == pytest.approx(model.velocity(time), rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(("speed", "torque"), [(5.0, 0.1), (5.0, -0.1), (-3.0, 0.02), (0.0, 0.04), (0.0, 0.06)])
def test_emulated_shaft_is_the_solution_of_equation_3(speed: float, torque: float) -> None:
    """One exact slice equals a stiff solver with a smoothed sign, through a stop and a reversal."""
    inertia, coulomb, viscous, dt = 6e-5, 0.05, 8e-4, 0.02

    def derivative(_: float, y: np.ndarray) -> list[float]:
        return [y[1], (torque - viscous * y[1] - coulomb * np.tanh(y[1] / 1e-4)) / inertia]

    exact = solve_ivp(derivative, (0, dt), [0.0, speed], "Radau", rtol=1e-9, atol=1e-11).y[:, -1]
    assert turn(0.0, speed, torque, Shaft(inertia, coulomb, viscous), dt) == pytest.approx(exact, abs=3e-4)


def test_emulated_experiment_stays_within_the_sources_bands(rig: Rig) -> None:
    """Models against each other 0.1 %, experiment against multibody 7 % and against equation 3 10 %."""
    emulated = EmulatedRig(rig, 2)
    client = RigClient(VirtualPort(emulated), rig)
    client.connect()
    emulated.plant.load(True)
    records = [run_ramp(client, m, 0.16, True, "r") for _ in range(2) for m in (0.02, 0.05)]
    comparison = evaluate(records, rig).comparison
    assert comparison is not None
    worst = {frozenset((pair.first, pair.second)): pair for pair in comparison.pairs}
    assert len(worst) == 6
    for pair in ((BLOCK, MULTIBODY), (BLOCK, CLOSED), (MULTIBODY, CLOSED)):
        assert worst[frozenset(pair)].worst < 0.1
    assert worst[frozenset((EXPERIMENT, MULTIBODY))].worst < 7.0
    assert worst[frozenset((EXPERIMENT, BLOCK))].worst < 10.0
    assert all(pair.within for pair in comparison.pairs)
