"""The perturbation method gives what the full simulation gives, in any company; its coefficients are Pinocchio's."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest
from elastic_arms import SOFT, elastic
from numpy.typing import ArrayLike, NDArray
from pinocchio_chain import tip_place

from benchmarks.perturbation import agreement
from rx90_common.base.errors import ConfigError, DivergenceError, SupervisionError, TrajectoryError
from rx90_common.base.rates import Rates
from rx90_common.description.drives import Cogging, CurrentSensor, Windings
from rx90_common.description.kinematics import forward
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_controller.law.parameters import CS7BParameters, FeedForward
from rx90_controller.trajectory import JointLimits, TrajectoryGenerator, TrajectoryPoints
from rx90_emulator.identification.arm import rigid_torque
from rx90_emulator.loop.closed_loop import simulate
from rx90_emulator.loop.setup import Setup
from rx90_emulator.perturbation.model import PerturbationModel, linearise, nominal_motion, nominal_torque
from rx90_emulator.perturbation.model import prepare_perturbation as prepare

Array = NDArray[np.float64]
NAMES = tuple(f"joint_{i}" for i in range(1, 7))
HOME = np.array([0.1, 0.3, 1.1, -0.2, 0.7, 0.3])
REST = np.zeros(6)


def with_drives(setup: Setup, **changes: Any) -> Setup:
    """Return a setup with other drives."""
    return dataclasses.replace(setup, drives=dataclasses.replace(setup.drives, **changes))


def there_and_back(size: float = 0.09) -> TrajectoryPoints:
    """Return a motion with reversals in all joints."""
    rows = [HOME, HOME + size * np.array([1, -1, 1, -1, 1, -1]), HOME]
    return TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.3, 0.6], rows, [REST] * 3, [REST] * 3)


def stay() -> TrajectoryPoints:
    """Return a rest at HOME."""
    return TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.1], [HOME, HOME], [REST] * 2, [REST] * 2)


def with_friction(friction: FrictionSet, scale: float, delta: float = 1.0) -> FrictionSet:
    """Return a friction set with other torques and another Stribeck exponent."""
    names = ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative", "c0", "c1", "c2")
    return FrictionSet(
        friction.names,
        tuple(
            dataclasses.replace(e, delta=delta, **{name: scale * getattr(e, name) for name in names})
            for e in friction.elements
        ),
    )


def weightless(setup: Setup, controller: CS7BParameters) -> Setup:
    """Return an arm without gravity, spring and noticeable friction or encoder counts."""
    model = setup.robot.model.copy()
    model.gravity.linear = np.zeros(3)
    robot = dataclasses.replace(setup.robot, model=model, chain=setup.robot.chain._replace(gravity=np.zeros(3)))
    drives = dataclasses.replace(setup.drives, spring_torque=np.zeros(6), encoder_counts=np.full(6, 2.0**30))
    return dataclasses.replace(
        setup, robot=robot, drives=drives, friction=with_friction(setup.friction, 1e-9), controller=controller
    )


def soft(controller: CS7BParameters) -> CS7BParameters:
    """Return gains that leave large deviations and no saturation."""
    return dataclasses.replace(
        controller,
        kp=0.03 * controller.kp,
        kv=0.1 * controller.kv,
        ki=0.0 * controller.ki,
        feed_forward=FeedForward.off(),
        start_tolerance=0.5,
    )


@pytest.fixture(scope="module")
def model(shipped: Setup) -> PerturbationModel:
    """Return the prepared motion."""
    return prepare(shipped, there_and_back(), HOME, 0.4)


@pytest.fixture(scope="module")
def variants(shipped: Setup) -> tuple[list[FrictionSet], list[CS7BParameters]]:
    """Return 21 pairs of friction and controller, so that two widths of groups have idle lanes."""
    frictions = [with_friction(shipped.friction, 0.5 + 0.1 * n, (1.0, 2.0, 1.5)[n % 3]) for n in range(21)]
    plain = dataclasses.replace(shipped.controller, feed_forward=FeedForward.off())
    return frictions, [(shipped.controller, plain, soft(shipped.controller))[n // 3 % 3] for n in range(21)]


CASES = {
    "as shipped": (Rates(), 0.0),
    "later start": (Rates(), 0.037),
    "other rates": (Rates(8000, 500), 0.0),
    "one rate": (Rates(4000, 4000), 0.01),
}


@pytest.mark.parametrize("case", CASES)
def test_a_short_task_agrees_with_the_full_simulation(shipped: Setup, case: str) -> None:
    """Worst and RMS tip deviation differ by less than 1 %, and so do the tips at every time."""
    rates, start = CASES[case]
    setup = dataclasses.replace(shipped, rates=rates)
    full = simulate(setup, there_and_back(), HOME, 0.7, start)
    result = prepare(setup, there_and_back(), HOME, 0.7, start).run_one()
    compared = agreement(full, result)
    assert compared.worst[0] > 1e-4
    assert max(compared.relative_worst, compared.relative_rms) < 0.01
    assert compared.relative_difference < 0.02
    reach = np.abs(full.slow.friction_states[:, 0]).max(axis=0)
    assert (np.abs(result.bristles[0] - full.slow.friction_states[:, 0]) < 0.05 * reach).all()


def test_other_bristles_agree_with_the_full_simulation(shipped: Setup) -> None:
    """Elements of all kinds in one robot, and runs with other kinds side by side, are those of full simulations."""
    kinds = [ElastoPlastic(0.7), MaxwellSlip((0.6, 0.3, 0.1), (0.3, 0.3, 0.4), 3000.0), None]
    frictions = [
        FrictionSet(
            shipped.friction.names,
            tuple(dataclasses.replace(e, bristles=kinds[(i + n) % 3]) for i, e in enumerate(shipped.friction.elements)),
        )
        for n in range(3)
    ]
    result = prepare(shipped, there_and_back(), HOME, 0.7).run(frictions)
    plain = prepare(shipped, there_and_back(), HOME, 0.7).run_one()
    for run, friction in enumerate(frictions[:2]):
        full = simulate(dataclasses.replace(shipped, friction=friction), there_and_back(), HOME, 0.7)
        tip = forward(shipped.robot.chain, full.slow.joint_states[:, 0]).position
        distance = np.linalg.norm(tip - result.tip_position(run), axis=1).max()
        assert distance < 0.02 * np.linalg.norm(result.tip_deviation[run], axis=1).max()
        assert distance < 0.2 * np.linalg.norm(result.tip_deviation[run] - plain.tip_deviation[0], axis=1).max()
        reach = np.abs(full.slow.friction_states[:, 0]).max(axis=0)
        assert (np.abs(result.bristles[run] - full.slow.friction_states[:, 0]) < 0.05 * reach).all()


def test_a_run_begins_as_the_full_simulation_does(shipped: Setup) -> None:
    """From rest with brakes just opened, the first milliseconds of sagging are the same within 0.1 %."""
    full = simulate(shipped, stay(), HOME, 0.005)
    result = prepare(shipped, stay(), HOME, 0.005).run_one()
    np.testing.assert_allclose(result.joint_position(0)[0], HOME, rtol=0, atol=1e-15)
    sag = full.slow.joint_states[:, 0] - HOME
    assert np.abs(sag).max() > 1e-6
    assert (np.abs(result.joint_position(0) - HOME - sag) <= 1e-3 * np.abs(sag).max(axis=0) + 1e-15).all()


def test_the_error_is_quadratic_in_the_deviation(shipped: Setup) -> None:
    """Half the initial deviation leaves a quarter of the difference to the full simulation."""
    setup = weightless(shipped, soft(shipped.controller))
    errors = []
    for size in (0.02, 0.01, 0.005):
        begin = HOME + size * np.array([1, -1, 1, 1, -1, 1])
        full = simulate(setup, stay(), begin, 0.1)
        result = prepare(setup, stay(), begin, 0.1).run_one()
        assert np.abs(result.joint_deviation).max() >= size
        errors.append(np.abs(full.slow.joint_states[:, 0] - result.joint_position(0)).max())
    ratios = np.array(errors[:-1]) / errors[1:]
    assert (ratios > 3.6).all(), errors
    assert (ratios < 4.4).all(), errors


def test_exact_feed_forward_without_friction_leaves_no_deviation(shipped: Setup) -> None:
    """If the drives give tau0 in every step, and nothing else, the arm stays on the nominal motion."""
    none = np.zeros(6)
    controller = dataclasses.replace(
        shipped.controller,
        kp=none,
        kv=none,
        ki=none,
        feed_forward=FeedForward(acceleration=True, coulomb=False, viscous=False),
        current_bandwidth=1e9,
        current_slew=np.full(6, 1e12),
    )
    setup = dataclasses.replace(weightless(shipped, controller), rates=Rates(4000, 4000))
    moving = prepare(setup, there_and_back(), HOME, 0.6)
    acceleration = moving.tables.reference[:, 2] / setup.drives.gear  # of the motors, seen from the joints
    torque = acceleration * controller.inertia
    torque[:, 4] += torque[:, 5]  # motor 6 turns with joints 5 and 6
    ideal = dataclasses.replace(moving, tables=moving.tables._replace(torque=torque))
    assert np.abs(moving.run_one().joint_deviation).max() > 1e-3
    # What is left: steps of constant acceleration do not quite end at the set-points.
    assert np.abs(ideal.run_one().joint_deviation).max() < 2e-7


def test_saturation_is_counted_as_in_the_full_simulation(shipped: Setup) -> None:
    """A motion too fast for weak amplifiers saturates them for as many ticks in both methods, and trips both."""
    weak = dataclasses.replace(shipped.drives, peak_current=0.45 * shipped.drives.peak_current)
    fast = dataclasses.replace(shipped.controller, max_acceleration=np.full(6, 99.0))
    loose = dataclasses.replace(fast, following_error=np.full(6, 1.0))
    setup = dataclasses.replace(shipped, drives=weak, controller=loose)
    full = simulate(setup, there_and_back(0.4), HOME, 0.7)
    model = prepare(setup, there_and_back(0.4), HOME, 0.7)
    result = model.run([shipped.friction] * 2, [loose, fast])
    with pytest.raises(SupervisionError, match="joint_2: following error"):
        simulate(dataclasses.replace(setup, controller=fast), there_and_back(0.4), HOME, 0.7)
    assert result.tripped.tolist() == [False, True]
    assert full.saturated.max() > 20
    assert np.abs(result.saturated[0] - full.saturated).max() <= 0.05 * full.saturated.max()


def test_a_run_of_a_batch_equals_the_run_alone(
    model: PerturbationModel, variants: tuple[list[FrictionSet], list[CS7BParameters]]
) -> None:
    """In groups of many and of few lanes, every bit is that of a single run, and no two runs are the same."""
    frictions, controllers = variants
    many = model.run(frictions, controllers)
    assert len({tip.tobytes() for tip in many.tip_deviation}) == len(frictions)
    few = model.run(frictions[:6], controllers[:6])
    for run in range(len(frictions)):
        alone = model.run_one(frictions[run], controllers[run])
        for batch in (many, few) if run < 6 else (many,):
            for name in ("joint_deviation", "bristles", "tip_deviation", "saturated"):
                assert getattr(batch, name)[run].tobytes() == getattr(alone, name)[0].tobytes(), (run, name)


def test_a_lost_run_is_named_and_harms_no_other(shipped: Setup) -> None:
    """A gain far too large, without a limit of current, diverges in full and loses its own run alone."""
    drives = dataclasses.replace(shipped.drives, peak_current=1e6 * shipped.drives.peak_current)
    setup = dataclasses.replace(shipped, drives=drives)
    model = prepare(setup, there_and_back(), HOME, 0.4)
    friction, tame = shipped.friction, shipped.controller
    kv = tame.kv * [1, 1, 1, 30, 1, 1]
    wild = dataclasses.replace(tame, kv=kv, following_error=np.full(6, 1e9), over_speed=1e9)
    with pytest.raises(DivergenceError):
        simulate(dataclasses.replace(setup, controller=wild), there_and_back(), HOME, 0.4)
    result = model.run([friction] * 3, [tame, wild, tame])
    alone = model.run_one()
    assert result.diverged.tolist() == [False, True, False]
    for run in (0, 2):
        assert result.tip_deviation[run].tobytes() == alone.tip_deviation[0].tobytes()


def test_friction_too_stiff_for_a_tick_is_refused(shipped: Setup, model: PerturbationModel) -> None:
    """The method takes one plant step in a tick, so it refuses bristles that need more, which the plant takes."""
    elements = tuple(dataclasses.replace(one, c0=100.0 * one.c0) for one in shipped.friction.elements)
    stiff = dataclasses.replace(shipped.friction, elements=elements)
    assert dataclasses.replace(shipped, friction=stiff).plant().substeps > 1
    with pytest.raises(ConfigError, match=r"friction\.joint_6\.c0 is 500000 Nm/rad.*1 plant step.*substeps"):
        model.run_one(stiff)


def test_coarse_points_are_close_enough(shipped: Setup) -> None:
    """Coefficients interpolated over 20 ms change the tip by less than 1 % against coefficients in every tick."""
    tips = [prepare(shipped, there_and_back(), HOME, 0.6, spacing=s).run_one().tip_deviation for s in (0.00025, 0.02)]
    assert 0 < np.abs(tips[0] - tips[1]).max() < 0.01 * np.abs(tips[0]).max()


def test_the_tip_deviation_is_the_change_of_the_forward_kinematics(model: PerturbationModel) -> None:
    """J(q0) dq is the difference of the tip's positions by Pinocchio, to second order."""
    result = model.run_one()
    for row in (0, 100, 250, 399):
        expected = tip_place(model.setup.robot, result.joint_position(0)[row])
        np.testing.assert_allclose(result.tip_position(0)[row], expected, atol=1e-7)


def test_wrong_calls_are_refused_in_one_line(shipped: Setup, model: PerturbationModel) -> None:
    """Every refusal names the value and what is accepted."""
    cogging = Cogging(np.ones(1), np.ones((1, 6)), np.zeros((1, 6)))
    winding = Windings(resistance=np.ones(6), derating=100.0, limit=120.0)
    sensor = CurrentSensor(offset=np.ones(6))
    switches = dataclasses.replace(shipped.controller.feed_forward, friction_model=True)
    by_model = dataclasses.replace(shipped.controller, feed_forward=switches)

    def at_rest(setup: Setup = shipped, time: float = 0.1, **how: Any) -> Any:
        return lambda: prepare(setup, stay(), HOME, time, **how)

    calls = {
        "a batch of 0 runs": lambda: model.run([]),
        "1 controllers for 2 friction sets": lambda: model.run([shipped.friction] * 2, [shipped.controller]),
        "feed_forward.friction_model is true; accepted: false": lambda: model.run(
            [shipped.friction] * 2, [shipped.controller, by_model]
        ),
        "duration is 1e-09 s": at_rest(time=1e-9),
        "spacing is 0.0001 s": at_rest(spacing=1e-4),
        "spacing is nan s": at_rest(spacing=float("nan")),
        "start time is nan s": at_rest(start_time=float("nan")),
        "initial position of joint_2 is 9.0 rad": lambda: prepare(shipped, stay(), [0, 9, 0, 0, 0, 0], 0.1),
        "drives.cogging: the perturbation method cannot hold this": at_rest(with_drives(shipped, cogging=cogging)),
        "drives.current_sensor: the": at_rest(with_drives(shipped, current_sensor=sensor)),
        "drives.winding: the": at_rest(with_drives(shipped, winding=winding)),
        "drives.elasticity.stiffness[0] is 150000 Nm/rad": at_rest(elastic(shipped, SOFT)),
    }
    for text, call in calls.items():
        with pytest.raises(ConfigError, match=re.escape(text)) as refusal:
            call()
        assert "accepted" in str(refusal.value)
        assert "\n" not in str(refusal.value)
    with pytest.raises(TrajectoryError, match="accepted"):
        prepare(shipped, stay(), HOME + 0.01, 0.1)


def inverse_dynamics(setup: Setup, q: Array, v: Array, a: Array) -> Array:
    """Return the torque on the joints at one state, shape (6,)."""
    drives = setup.drives
    return rigid_torque(setup.robot.model, drives.rotor_matrix, drives.spring_torque, q[None], v[None], a[None])[0]


def accepted(points: TrajectoryPoints, hold: ArrayLike, start: int, rates: Rates) -> TrajectoryGenerator:
    """Return a generator without limits that follows the points from position tick `start` on."""
    free = np.full(6, np.inf)
    generator = TrajectoryGenerator(JointLimits(NAMES, -free, free, free, free, 1.0), rates.position_period, hold)
    generator.accept(points, 0, start)
    return generator


def slopes(setup: Setup, state: Array, which: int, step: float = 1e-5) -> Array:
    """Return the derivative of the torque by position, velocity or acceleration, by central differences."""
    columns = []
    for joint in range(6):
        move = np.zeros((3, 6))
        move[which, joint] = step
        difference = inverse_dynamics(setup, *(state + move)) - inverse_dynamics(setup, *(state - move))
        columns.append(difference / (2.0 * step))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_derivatives_equal_differences_of_the_inverse_dynamics(shipped: Setup, seed: int) -> None:
    """M0, C0 and K0 are the slopes of the torque, rotors, wrist coupling, gravity and spring included."""
    rng = np.random.default_rng(seed)
    state = np.stack([rng.uniform(-2.0, 2.0, 6), rng.uniform(-3.0, 3.0, 6), rng.uniform(-20.0, 20.0, 6)])
    linear = linearise(shipped.robot, shipped.drives, *state[:, None])
    for ours, which in ((linear.stiffness, 0), (linear.damping, 1), (linear.mass, 2)):
        expected = slopes(shipped, state, which)
        np.testing.assert_allclose(ours[0], expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_the_nominal_torque_is_the_inverse_dynamics_of_the_motion(shipped: Setup) -> None:
    """In the middle of a step tau0 is what Pinocchio, rotors and spring ask for."""
    plant = shipped.plant()
    rows = [[0.1, 0.3, 1.1, -0.2, 0.7, 0.3], [0.3, 0.1, 1.4, -0.4, 0.8, 0.1]]
    points = TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.3], rows, [REST] * 2, [REST] * 2)
    motion = nominal_motion(accepted(points, rows[0], 2, Rates()), 1600, Rates())
    torque = nominal_torque(plant.constants, plant.state, motion)
    for k in (0, 8, 300, 900, 1599):
        state = motion.middle_position[k], motion.middle_velocity[k], motion.acceleration[k]
        np.testing.assert_allclose(torque[k], inverse_dynamics(shipped, *state), rtol=1e-10, atol=1e-9)


def test_the_nominal_steps_lead_from_set_point_to_set_point(shipped: Setup) -> None:
    """Steps of constant acceleration, and what they slip, add up to the set-points, even where these jump."""
    rates = shipped.rates
    rows = [[0.1, 0.3, 1.1, -0.2, 0.7, 0.3], [0.3, 0.1, 1.4, -0.4, 0.8, 0.1]]
    points = TrajectoryPoints.create(NAMES, NAMES, [0.0, 0.1003], rows, [], [])
    motion = nominal_motion(accepted(points, np.array(rows[0]) + 5e-4, 10, rates), 1000, rates)
    q, v = motion.position[0].copy(), motion.velocity[0].copy()
    for k in range(1000):
        q += rates.period * (v + 0.5 * rates.period * motion.acceleration[k]) + motion.slip[k]
        v += rates.period * motion.acceleration[k]
        np.testing.assert_allclose(q, motion.position[k + 1], atol=1e-12)
        np.testing.assert_allclose(v, motion.velocity[k + 1], atol=1e-9)
    np.testing.assert_allclose(q, rows[1], atol=1e-12)
