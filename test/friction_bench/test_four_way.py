"""The source's three models of a ramp: each makes of Coulomb friction what its program does, and slides alike."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

from friction_bench.experiment.four_way import (
    BLOCK,
    CLOSED,
    EXPERIMENT,
    MULTIBODY,
    SETTLED,
    STICTION,
    block_diagram,
    compare,
    simulate_multibody,
)
from friction_bench.experiment.record import RampModel, RampRecord

RATIO = 31.0
NO_LOAD = RampModel(0.1462, 0.0368, 1.3e-5, 0.61)
MODELS = [NO_LOAD, RampModel(0.03, 6.4e-4, 1.3e-5, 0.02), RampModel(0.05, 0.02, 3e-3, 0.05)]


@pytest.mark.parametrize("model", MODELS)
def test_models_slide_as_the_closed_form(model: RampModel) -> None:
    """From twelve time constants after break-away on they differ by less than 0.2 %; before it, by more than 0.01 %."""
    start = 0.5
    release = start + model.break_away_time
    settled = max(SETTLED, 12 * model.time_constant)
    time = np.linspace(0.0, release + 3 * settled, 400)
    closed = model.velocity(time - start)
    slides = time > release + settled
    for found in (block_diagram(model, start, time).velocity, simulate_multibody(model, start, RATIO, time)):
        difference = np.abs(found - closed) / closed[-1]
        assert difference[slides].max() < 2e-3
        assert difference[time < release].max() > 1e-4
        assert np.all(found[time <= start] == 0.0)


def test_sign_block_gives_three_values_and_switches_on_with_the_first_motion() -> None:
    """Friction is 0 until the ramp starts, then f_c of both signs in turn until break-away, then +f_c alone."""
    model, start = NO_LOAD, 0.1
    sensor = block_diagram(model, start, np.arange(0.0, 0.6, 1e-4))
    drive = model.slope * np.maximum(sensor.time - start, 0.0)
    sign = (drive - model.viscous * sensor.velocity - sensor.reaction) / model.coulomb
    released = start + model.break_away_time
    assert np.abs(sign[sensor.time <= start]).max() == 0.0
    assert np.abs(np.abs(sign[sensor.time > start + 2e-4]) - 1.0).max() < 0.02  # a reading lies up to half a step off
    stuck = sign[(sensor.time > start + 1e-3) & (sensor.time < released - 0.05)]
    assert {round(float(one)) for one in stuck} == {-1, 1}
    assert sign[sensor.time > released + 0.02].min() > 0.98


def test_sensor_gives_what_belongs_together() -> None:
    """Reaction torque is J q'' (equation 1); position is the integral of velocity, and its end the closed form's."""
    model = MODELS[2]
    time = np.linspace(0.0, 3.0, 3001)
    sensor = block_diagram(model, 0.0, time)
    assert sensor.reaction == pytest.approx(model.inertia * sensor.acceleration, rel=1e-12, abs=1e-15)
    integral = np.cumsum((sensor.velocity[1:] + sensor.velocity[:-1]) / 2 * np.diff(time))
    assert sensor.position[1:] == pytest.approx(integral, abs=1e-3)
    assert sensor.position[-1] == pytest.approx(model.angle(3.0), rel=2e-3)
    assert sensor.acceleration[-1] == pytest.approx(model.slope / model.viscous, rel=0.01)


def test_multibody_model_creeps_as_its_friction_asks() -> None:
    """Before break-away the joint turns at the velocity at which smooth and viscous friction hold the torque."""
    model, friction = NO_LOAD, CubicHermiteSpline([-STICTION, STICTION], [-1.0, 1.0], [0.0, 0.0])
    time = np.array([0.05, 0.1, 0.15, 0.2])
    found = simulate_multibody(model, 0.0, RATIO, time)
    for t, motor in zip(time, found, strict=True):

        def balance(joint: float, drive: float = model.slope * float(t)) -> float:
            return float(drive - model.viscous * joint * RATIO - model.coulomb * friction(joint))

        assert motor / RATIO == pytest.approx(brentq(balance, 0.0, STICTION), rel=0.02)


def test_comparison_has_the_experiment_and_the_source_s_own_input() -> None:
    """Four velocities under the ramp, three under slope 1; a closed form read by an encoder differs by counts alone."""
    model, step = RampModel(0.2297, 0.0321, 6.3e-5, 0.55), np.pi / 252
    time = np.arange(0.0, 3.0, 0.02)
    record = RampRecord(time, np.floor(model.angle(time) / step + 0.5) * step, model.slope, step)
    found = compare(record, model, RATIO)
    pairs = {(pair.first, pair.second): pair for pair in found.pairs}
    assert list(found.velocities) == [EXPERIMENT, BLOCK, MULTIBODY, CLOSED]
    assert pairs[EXPERIMENT, CLOSED].sliding < 100 * step / 0.1 / found.velocities[CLOSED][-1]
    assert pairs[BLOCK, MULTIBODY].worst > 1.0
    assert pairs[BLOCK, MULTIBODY].sliding < 0.05
    assert pairs[EXPERIMENT, BLOCK].band == 10.0
    own = found.as_source
    assert list(found.source_velocities) == [BLOCK, MULTIBODY, CLOSED]
    for velocity in found.source_velocities.values():
        assert np.all(velocity[own.time <= 2.0] == 0.0)
        assert velocity[-1] == pytest.approx((own.time[-1] - 2.0 - 0.2297) / 0.0321, rel=0.01)
    assert own.time[-1] - 2.0 == pytest.approx(0.55 * 2.95, abs=0.05)


def test_multibody_model_slides_with_the_friction_that_is_left() -> None:
    """After break-away T s' + s = (smooth friction - f_c) / f_v for s, by how much the closed form is faster."""
    model = RampModel(0.2297, 0.0321, 6.3e-5, 0.55, 0.02)
    static = model.coulomb + model.release
    levels = [-static, static, model.coulomb, model.coulomb]
    smooth = CubicHermiteSpline([-STICTION, STICTION, 1.5 * STICTION, 100.0], levels, np.zeros(4))
    time = np.linspace(0.55, 1.2, 1301)
    found = simulate_multibody(model, 0.0, RATIO, time)
    slower = model.velocity(time) - found
    balance = model.time_constant * np.gradient(slower, time) + slower
    left = smooth(found / RATIO) - model.coulomb
    whole = model.release / model.viscous
    assert balance == pytest.approx(left / model.viscous, abs=0.02 * whole)
    assert slower.max() > 0.8 * whole
    assert abs(slower[-1]) < 1e-3 * whole
