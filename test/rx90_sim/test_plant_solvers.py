"""The plant against solvers: the paper's equations, a stiff reference, other bristles, and the steps that it takes."""

import dataclasses
import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bristle_oracles import ElastoPlasticOracle, MaxwellSlipOracle, swing
from elastic_arms import INPUTS, SOFT, elastic, energy, link_mass
from full_friction import TEMPERATURE
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from signed_element import ELEMENT as SIGNED

from benchmarks.accuracy import compare, full_speed, run_plant, scaled, sticking, with_rotors, without_rounding
from benchmarks.hybrid_reference import StiffPlant, Work, hybrid_reference
from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_emulator.loop.parameters import parameters, with_parameters
from rx90_emulator.loop.setup import Setup
from rx90_sim.plant import Plant

POSE = np.array([0.4, 0.9, -0.6, 0.5, 0.3, -0.3])


def test_energy_is_kept_to_second_order(shipped: Setup, frictionless: FrictionSet, arm_oracle: Any) -> None:
    """A free arm keeps its energy, spring and rotors included; the error falls fourfold per halving."""
    setup = dataclasses.replace(shipped, friction=frictionless)
    drift, counts = [], np.array([1, 2, 4, 8])
    for substeps in counts:
        plant = setup.plant(int(substeps))
        plant.reset(POSE)
        start = energy(setup, plant.state[0])
        worst = 0.0
        for k in range(1600):
            plant.step(np.zeros(6))
            if k % 16 == 15:
                worst = max(worst, abs(energy(setup, plant.state[0]) - start))
        drift.append(worst)
        q, v, _ = plant.joint_states()
        assert np.all(q > setup.robot.lower + 0.1)
        assert np.all(q < setup.robot.upper - 0.1)
    kinetic = 0.5 * v @ arm_oracle.mass_and_bias(q, v)[0] @ v
    assert kinetic > 10.0
    assert -np.polyfit(np.log(counts), np.log(drift), 1)[0] == pytest.approx(2.0, abs=0.25)
    assert drift[0] < 1e-3 * kinetic


BENT = np.array([0.3, 0.5, 1.0, -0.4, 0.6, 0.2])


@pytest.fixture(scope="module")
def work() -> Work:
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
STIFF, LOOSE = ElastoPlastic(break_away=0.8), ElastoPlastic(break_away=0.2)
BLOCKS = MaxwellSlip(stiffness=(0.5, 0.3, 0.2), share=(0.2, 0.3, 0.5), attraction=2000.0)


def force(t: float) -> float:
    return 45.0 * math.sin(60.0 * t) + 6.0 * math.sin(171.0 * t)


def test_mixed_kinds_in_one_plant(masses: Callable[..., Plant]) -> None:
    """Four joints with four kinds follow solvers with located events; a reset plant does it again to the last bit."""
    elements = [ELEMENT.replaced(bristles=kind) for kind in (STIFF, BLOCKS, None, LOOSE)]
    plant, end = masses(elements, 1.5, 16_000), 0.1
    seen = []
    for _ in range(2):
        for k in range(round(end * 16_000)):
            plant.step(np.full(6, force((k + 0.5) / 16_000)) * [1, 1, 1, 1, 0, 0])
        seen.append(np.concatenate([*plant.joint_states()[:2], *plant.friction_states()]))
        plant.reset(np.zeros(6))
    assert seen[0].tolist() == seen[1].tolist()
    position, velocity, z, _, torque = np.split(seen[0], [6, 12, 19, 26])
    for joint, kind in ((0, STIFF), (1, BLOCKS), (3, LOOSE)):
        if isinstance(kind, ElastoPlastic):
            oracle: ElastoPlasticOracle | MaxwellSlipOracle = ElastoPlasticOracle(ELEMENT, kind.break_away)
        else:
            oracle = MaxwellSlipOracle(ELEMENT, np.array(kind.stiffness), np.array(kind.share), kind.attraction)
        x, v, turns = swing(oracle, 1.5, force, end, 0.0)
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


WORST = 0.01  # of the way that a joint has gone, what the plant may be off the solver by


def stuck_map(setup: Setup, pose: Array, substeps: int) -> Array:
    """Return what a step makes of (v, z, a) where all bristles stick, by docs/explanation/closed_loop.md, (19, 19)."""
    h = setup.rates.period / substeps
    mass = link_mass(setup, pose) + setup.drives.rotor_matrix
    c0, damping = (np.array([getattr(e, name) for e in setup.friction.elements]) for name in ("c0", "c1"))
    damping = damping + [e.c2 * 1e-3 ** (e.alpha - 1.0) for e in setup.friction.elements]
    v, z, a = np.split(np.eye(19), [6, 13])
    middle = INPUTS @ (v + 0.5 * h * a)
    force = c0[:, None] * (z + 0.5 * h * middle) + damping[:, None] * middle
    after = -np.linalg.solve(mass, INPUTS.T @ force)
    return np.vstack([v + h * after, z + h * middle, after])


FACTORS = {
    "c0": st.floats(-1.0, 3.5),
    "c1": st.floats(-3.0, 1.0),
    "c2": st.floats(-3.0, 1.0),
    "rotors": st.floats(-2.0, 0.5),
    "alpha": st.sampled_from([1.0, 0.3, 0.6, 2.0]),
    "undamped": st.booleans(),
    "torques": st.floats(-3.0, 0.5),
    "weaker": st.tuples(st.sampled_from(["positive", "negative"]), st.floats(-4.0, 0.0)),
    "seed": st.integers(0, 2**32 - 1),
}


def drawn(setup: Setup, drawn: dict[str, Any]) -> Setup:
    """Return a setup with these powers of ten as factors, each element's own a little beside them."""
    rng, elements = np.random.default_rng(drawn["seed"]), []
    for one in setup.friction.elements:
        own = {
            name: 10.0 ** (drawn[name] + rng.uniform(-0.3, 0.3)) * one.parameters[name] for name in ("c0", "c1", "c2")
        }
        own |= {
            name: one.parameters[name]
            * 10.0 ** (drawn["torques"] + drawn["weaker"][1] * name.endswith(drawn["weaker"][0]))
            for name in ("tau_c_positive", "tau_c_negative", "tau_s_positive", "tau_s_negative")
        }
        if drawn["undamped"]:
            own |= {"c1": 0.0}
        elements.append(one.with_parameters({**own, "alpha": drawn["alpha"]}))
    friction = FrictionSet(setup.friction.names, tuple(elements))
    return with_rotors(replace(setup, friction=friction), 10.0 ** drawn["rotors"])


@given(st.fixed_dictionaries(FACTORS))
@settings(max_examples=60)
def test_what_sticks_stays_in_its_place(shipped: Setup, draw: dict[str, Any]) -> None:
    """Whatever is let pass, the stuck arm's map is stable in every pose, or grows by up to 10 % in a second."""
    setup = drawn(shipped, draw)
    try:
        substeps = setup.plant().substeps
    except ConfigError:
        assume(False)
    rng = np.random.default_rng(draw["seed"])
    for _ in range(3):
        pose = rng.uniform(setup.robot.lower, setup.robot.upper)
        values = np.linalg.eigvals(stuck_map(setup, pose, substeps))
        growth = (np.abs(values).max() - 1.0) * substeps / setup.rates.period
        assert growth < 0.11


@given(st.fixed_dictionaries(FACTORS))
@settings(max_examples=24)
def test_what_is_let_pass_agrees_with_a_stiff_solver(shipped: Setup, draw: dict[str, Any]) -> None:
    """Through sticking, break-away, reversal and sticking again within 1 % of each joint's way, or 2 urad, of LSODA."""
    setup = drawn(shipped, draw)
    try:
        setup.plant()
    except ConfigError:
        assume(False)
    assert sticking(setup).share < WORST


def test_the_shipped_robots_take_one_step(shipped: Setup, tx40: Setup) -> None:
    """Both robots keep one plant step in a tick, with their tools and without, and so the bits of their runs."""
    assert [one.plant().substeps for one in (shipped, tx40)] == [1, 1]


def test_the_refusal_says_what_asks_for_steps(shipped: Setup) -> None:
    """Too few steps name element, value, what they bear, and the steps that would do; those then do."""
    stiff = scaled(shipped, c0=100.0)
    needed = stiff.plant().substeps
    line = rf"friction\.joint_6\.c0 is 500000 Nm/rad, .* times what 2 plant steps.*substeps {needed}$"
    with pytest.raises(ConfigError, match=line):
        stiff.plant(2)
    assert stiff.plant(needed).substeps == needed
    assert stiff.plant(100).substeps == 100
    for setup, said in (
        (scaled(shipped, c1=60.0), r"friction\.joint_6\.c1 is 300 Nm s/rad"),
        (scaled(shipped, c2=5.0, alpha=0.3), r"friction\.joint_6\.c2 is .* at its steepest"),
        (with_parameters(shipped, {"drives.brake_damping[3]": 4000.0}), r"drives\.brake_damping\[3\] is 4000 Nm s/rad"),
        (elastic(with_rotors(shipped, 1e-320), SOFT), r"drives\.rotor_inertia is \[.* kg m\^2; accepted: .* inverted"),
    ):
        with pytest.raises(ConfigError, match=said):
            setup.plant(1)


@pytest.mark.parametrize("weaker", ["positive", "negative"])
def test_a_weak_direction_takes_more_steps(shipped: Setup, weaker: str) -> None:
    """As many as the ratio, from one on that a step does not resolve; each is as the stiff solver has it."""
    values = parameters(shipped)
    given = {path: float(values[path].value) for path in values if re.match(rf"friction.joint_5.tau_._{weaker}", path)}
    setups = [
        with_parameters(shipped, {path: torque / ratio for path, torque in given.items()}) for ratio in (60, 1e3, 3e3)
    ]
    first, second, third = (setup.plant().substeps for setup in setups)
    assert first == 1
    assert third == pytest.approx(3.0 * second, abs=3.0)
    assert max(sticking(setup).share for setup in setups) < WORST
    elements = list(shipped.friction.elements)
    other = "negative" if weaker == "positive" else "positive"
    tables = {weaker: {"velocity": [0.0, 1.0], "torque": [2e-3] * 2}, other: {"velocity": [0.0, 1.0], "torque": [2, 2]}}
    elements[4] = elements[4].replaced(curve=tables)
    friction = replace(shipped.friction, elements=tuple(elements))
    assert replace(shipped, friction=friction).plant().substeps == pytest.approx(second, abs=1)


def test_the_refusal_of_a_weak_direction_says_how_weak_it_is(shipped: Setup) -> None:
    """With the value that it accepts in place of the one that it names the set is taken at once."""
    weak = {f"friction.joint_5.{name}_negative": 1e-9 for name in ("tau_c", "tau_s")}
    for _ in range(2):
        with pytest.raises(ConfigError, match=r"with torques \S+ times apart in both directions") as refused:
            with_parameters(shipped, weak).plant()
        told = re.search(r"^(friction\.joint_5\.c[01]) is .* up to about (\S+)$", str(refused.value))
        weak[told[1]] = 0.9 * float(told[2])
    with_parameters(shipped, weak).plant()


def test_parts_count_where_they_stiffen(shipped: Setup) -> None:
    """Elasto-plastic bristles stick as LuGre's; a joint that starts cold has the viscous friction of its cold."""
    for part in (None, ElastoPlastic(break_away=0.7)):
        elements = tuple(e.replaced(c0=50.0 * e.c0, bristles=part) for e in shipped.friction.elements)
        setup = replace(shipped, friction=FrictionSet(shipped.friction.names, elements))
        assert setup.plant().substeps == scaled(shipped, c0=50.0).plant().substeps
    cold = TEMPERATURE.replaced(lowest=-20.0, start=-20.0, viscous_scale=7.0, speed_slope=0.0, static_slope=0.0)
    elements = tuple(e.replaced(temperature=cold) for e in shipped.friction.elements)
    with pytest.raises(ConfigError, match=r"c2 is .* at its steepest"):
        replace(shipped, friction=FrictionSet(shipped.friction.names, elements)).plant(1)


def test_gears_that_ring_above_the_step_take_more_or_are_refused(shipped: Setup) -> None:
    """An undamped gear is stepped finely enough for its frequency, a damped one need not be, too stiff is refused."""
    assert elastic(shipped, SOFT).plant().substeps == 1
    stiff = elastic(shipped, 1e4 * SOFT).plant().substeps
    mass = link_mass(shipped, np.zeros(6)) + 0.0
    reduced = 1.0 / (1.0 / shipped.drives.rotor_inertia + np.linalg.inv(mass).diagonal())
    fastest = math.sqrt((1e4 * SOFT / reduced).max())
    assert fastest * shipped.rates.period / stiff < 0.75  # in this pose, each gear alone
    assert elastic(shipped, 1e4 * SOFT, 2e-4 * 1e4 * SOFT).plant().substeps == 1
    with pytest.raises(ConfigError, match=r"drives\.elasticity\.stiffness\[\d\] is .* up to about"):
        elastic(shipped, 1e9 * SOFT).plant()


@pytest.mark.parametrize("name", ["c0", "c1", "c2"])
@pytest.mark.filterwarnings("error")
def test_a_value_near_the_largest_number_is_one_line(shipped: Setup, name: str) -> None:
    """Without a warning of NumPy's, and what is accepted in its place is accepted."""
    setup = with_parameters(shipped, {f"friction.joint_6.{name}": 1e308})
    with pytest.raises(ConfigError, match=rf"^friction\.joint_6\.{name} is 1e\+308 ") as refused:
        setup.plant()
    told = re.search(r"accepted: up to about (\S+)$", str(refused.value))
    assert float(told[1]) > 0.0
    with_parameters(shipped, {f"friction.joint_6.{name}": 0.95 * float(told[1])}).plant()
