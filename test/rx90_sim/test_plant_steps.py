"""How many steps the plant takes in a tick: stable by its linear map, right by a stiff solver, refused beyond."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from elastic_arms import INPUTS, SOFT, elastic, link_mass
from full_friction import TEMPERATURE
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks.accuracy import scaled, sticking, with_rotors
from rx90_common.base.errors import ConfigError
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.bristles import ElastoPlastic
from rx90_emulator.loop.parameters import parameters, with_parameters
from rx90_emulator.loop.setup import Setup

Array = NDArray[np.float64]
WORST = 0.01
"""Of the way that a joint has gone, what the plant may be off the solver by."""


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
    line = rf"friction\.joint_6\.c0 is 500000 Nm/rad, .* times what 2 plant steps.*substeps {needed}; likewise friction"
    with pytest.raises(ConfigError, match=line):
        stiff.plant(2)
    assert stiff.plant(needed).substeps == needed
    assert stiff.plant(100).substeps == 100
    with pytest.raises(ConfigError, match=r"friction\.joint_6\.c0 .* 64 plant steps .*substeps \d+, more than the 64"):
        scaled(shipped, c0=2e4).plant()
    with pytest.raises(ConfigError, match=r"friction\.joint_6\.c0 is 5e\+12 Nm/rad"):
        scaled(shipped, c0=1e9).plant(1000)
    with pytest.raises(ConfigError, match=r"friction\.joint_6\.c1 is 300 Nm s/rad"):
        scaled(shipped, c1=60.0).plant(1)
    with pytest.raises(ConfigError, match=r"friction\.joint_6\.c2 is .* at its steepest"):
        scaled(shipped, c2=5.0, alpha=0.3).plant(1)
    with pytest.raises(ConfigError, match=r"drives\.brake_damping\[3\] is 4000 Nm s/rad"):
        with_parameters(shipped, {"drives.brake_damping[3]": 4000.0}).plant(1)
    with pytest.raises(ConfigError, match=r"drives\.rotor_inertia is \[.* kg m\^2; accepted: .* can be inverted"):
        elastic(with_rotors(shipped, 1e-320), SOFT).plant()


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


def test_a_refusal_names_all_that_ask_for_more(shipped: Setup) -> None:
    """With less than the limits that it names in place of the values the set is taken at once."""
    hard = {f"friction.joint_{k}.c0": 1e11 for k in (2, 4, 6)} | {"friction.joint_3.c1": 1e9}
    weak = {f"friction.joint_5.{name}_negative": 1e-9 for name in ("tau_c", "tau_s")}
    with pytest.raises(ConfigError, match=r"joint_5\.c\d is .* with torques \S+ times apart in both directions, "):
        with_parameters(shipped, weak).plant()
    with pytest.raises(ConfigError) as refused:
        with_parameters(shipped, hard | weak).plant()
    named = dict(re.findall(r"(friction\.\S+) (?:is .*? )?up to about ([\d.e+-]+)", str(refused.value)))
    assert {*hard, "friction.joint_5.c0", "friction.joint_5.c1"} <= set(named)
    with_parameters(shipped, weak | {name: 0.3 * float(limit) for name, limit in named.items()}).plant()


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
    with pytest.raises(ConfigError, match=r"elasticity\.stiffness\[\d\] .*elasticity\.damping\[\d\] from about"):
        elastic(shipped, 1e9 * SOFT).plant()


@pytest.mark.parametrize("name", ["c0", "c1", "c2"])
@pytest.mark.filterwarnings("error")
def test_a_value_near_the_largest_number_is_one_line(shipped: Setup, name: str) -> None:
    """Without a warning of NumPy's, and what is accepted in its place is accepted."""
    setup = with_parameters(shipped, {f"friction.joint_6.{name}": 1e308})
    with pytest.raises(ConfigError, match=rf"^friction\.joint_6\.{name} is 1e\+308 ") as refused:
        setup.plant()
    told = re.search(r"accepted: up to about (\S+)$", str(refused.value))
    assert told is not None
    assert float(told[1]) > 0.0
    with_parameters(shipped, {f"friction.joint_6.{name}": 0.95 * float(told[1])}).plant()
