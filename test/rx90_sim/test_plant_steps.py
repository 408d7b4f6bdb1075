"""How many steps the plant takes in a tick: stable by its linear map, right by a stiff solver, refused beyond."""

from __future__ import annotations

import dataclasses
import math
import re
from typing import Any

import numpy as np
import pytest
from elastic_arms import INPUTS, SOFT, elastic, link_mass
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from benchmarks.accuracy import scaled, sticking, with_rotors
from rx90_common.base.errors import ConfigError
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.bristles import ElastoPlastic
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_emulator.loop.parameters import with_parameters
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
    "weaker": st.tuples(st.sampled_from(["positive", "negative"]), st.floats(-1.3, 0.0)),
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
    return with_rotors(dataclasses.replace(setup, friction=friction), 10.0 ** drawn["rotors"])


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
@settings(max_examples=8)
def test_what_is_let_pass_agrees_with_a_stiff_solver(shipped: Setup, draw: dict[str, Any]) -> None:
    """Through sticking, break-away, reversal and sticking again within 1 % of each joint's way, or 2 urad, of LSODA."""
    setup = drawn(shipped, draw)
    try:
        setup.plant()
    except ConfigError:
        assume(False)
    assert sticking(setup).share < WORST


@pytest.mark.parametrize("case", ["c0 x 50", "c0 x 100", "c1 x 3, light rotors", "alpha 0.3, c2 x 5", "undamped"])
def test_the_sets_that_were_wrong_agree_with_a_stiff_solver(shipped: Setup, case: str) -> None:
    """So do the sets that one step in a tick got wrong without a word, within 0.3 %; each takes more by itself."""
    setup = {
        "c0 x 50": scaled(shipped, c0=50.0),
        "c0 x 100": scaled(shipped, c0=100.0),
        "c1 x 3, light rotors": with_rotors(scaled(shipped, c1=3.0), 0.03),
        "alpha 0.3, c2 x 5": scaled(shipped, c2=5.0, alpha=0.3),
        "undamped": scaled(shipped, c0=3.0, c1=0.0, c2=0.0),
    }[case]
    assert setup.plant().substeps > 1
    assert sticking(setup).share < 0.3 * WORST


def test_the_shipped_robots_take_one_step(shipped: Setup, tx40: Setup) -> None:
    """Both robots keep one plant step in a tick, with their tools and without, and so the bits of their runs."""
    assert [one.plant().substeps for one in (shipped, tx40)] == [1, 1]


def test_the_boundary_is_that_of_the_step() -> None:
    """(k - 2 d) (k + d) = 4 d and d = 1 part the stable maps of one mass from the others, by their eigenvalues."""
    for d in (0.02, 0.05, 0.2, 0.45, 0.8):
        edge = 0.5 * (d + math.sqrt(9.0 * d * d + 16.0 * d))
        for k, stable in ((0.99 * edge, True), (1.01 * edge, False)):
            # (v h, z, a h^2) of a mass of 1 after a step
            middle = np.array([1.0, 0.0, 0.5])
            after = -(k * np.array([0.0, 1.0, 0.0]) + (0.5 * k + d) * middle)
            step = np.array([np.eye(3)[0] + after, np.eye(3)[1] + middle, after])
            assert (np.abs(np.linalg.eigvals(step)).max() < 1.0) == stable


def test_the_refusal_says_what_asks_for_steps(shipped: Setup) -> None:
    """Too few steps name element, value, what they bear, and the steps that would do; those then do."""
    stiff = scaled(shipped, c0=100.0)
    needed = stiff.plant().substeps
    line = rf"friction\.joint_6\.c0 is 500000 Nm/rad, .* times what 2 plant steps.*accepted: .*substeps {needed}$"
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


@pytest.mark.parametrize("weaker", ["positive", "negative"])
def test_directions_that_are_far_apart_are_refused(shipped: Setup, weaker: str) -> None:
    """With 1e-3 Nm in one direction and 5 Nm in the other, a step a tick was 12 % of the joint's way off."""

    def setup(ratio: float) -> Setup:
        one = shipped.friction.elements[4]
        torques = {f"{name}_{weaker}": one.parameters[f"{name}_{weaker}"] / ratio for name in ("tau_c", "tau_s")}
        elements = [*shipped.friction.elements[:4], one.with_parameters(torques), *shipped.friction.elements[5:]]
        return dataclasses.replace(shipped, friction=FrictionSet(shipped.friction.names, tuple(elements)))

    setup(19.9).plant()
    with pytest.raises(ConfigError, match=rf"joint_5\.tau_c_{weaker} is 0\.199.* Nm, .*accepted: up to 20 times apart"):
        setup(20.1).plant()


def test_parts_count_where_they_stiffen(shipped: Setup) -> None:
    """Elasto-plastic bristles stick as LuGre's; a joint that starts cold has the viscous friction of its cold."""
    for part in (None, ElastoPlastic(break_away=0.7)):
        elements = tuple(e.replaced(c0=50.0 * e.c0, bristles=part) for e in shipped.friction.elements)
        setup = dataclasses.replace(shipped, friction=FrictionSet(shipped.friction.names, elements))
        assert setup.plant().substeps == scaled(shipped, c0=50.0).plant().substeps
    cold = TemperaturePart(
        reference=60.0,
        lowest=-20.0,
        highest=80.0,
        start=-20.0,
        ambient=20.0,
        capacity=9000.0,
        resistance=0.4,
        viscous_scale=10.0,
    )
    elements = tuple(e.replaced(temperature=cold) for e in shipped.friction.elements)
    with pytest.raises(ConfigError, match=r"c2 is .* at its steepest"):
        dataclasses.replace(shipped, friction=FrictionSet(shipped.friction.names, elements)).plant(1)


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
