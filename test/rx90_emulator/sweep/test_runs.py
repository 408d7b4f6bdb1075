"""Which values each run of a plan sets."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from rx90_common.base.errors import ConfigError
from rx90_emulator.loop.parameters import Catalogue
from rx90_emulator.sweep.plan import Block, LogUniform, SweepPlan, SweptParameter, Uniform, Values
from rx90_emulator.sweep.runs import RunDescription, RunList


def parameter(path: str, *values: float, factor: bool = True) -> SweptParameter:
    """Return a grid's parameter."""
    return SweptParameter(path, factor=factor, space=Values(values))


def drawn(path: str, *, each: bool = False) -> SweptParameter:
    """Return a random factor between 1 and 2."""
    return SweptParameter(path, factor=True, space=Uniform(1.0, 2.0), each=each)


def all_runs(plan: SweepPlan, catalogue: Catalogue) -> list[RunDescription]:
    """Return every run of a plan."""
    runs = RunList(plan, catalogue)
    return [runs.describe(index) for index in range(len(runs))]


def test_grid_is_the_full_product(catalogue: Catalogue) -> None:
    """A grid has every combination once, the last parameter varying fastest, and blocks follow each other."""
    first = Block("a", (parameter("task.speed", 1.0, 2.0), parameter("friction.*.c0", 3.0, 4.0, 5.0)))
    second = Block("b", (parameter("task.speed", 6.0),))
    runs = all_runs(SweepPlan((first, second)), catalogue)
    assert [tuple(v for _, v in run.values) for run in runs] == [
        *product((1.0, 2.0), (3.0, 4.0, 5.0)),
        (6.0,),
    ]
    assert [run.index for run in runs] == list(range(7))


def test_runs_do_not_depend_on_how_many_are_asked_for(catalogue: Catalogue) -> None:
    """More draws, blocks before it and parameters after it leave the values of a run as they are."""
    block = Block("a", (parameter("task.speed", 1.0, 2.0),), (drawn("friction.*.c0"),), draws=3)
    other = Block("other", (parameter("task.speed", 3.0),), (drawn("friction.*.c1"),), draws=4)
    wider = replace(block, random=(*block.random, drawn("friction.*.c2")))
    few = all_runs(SweepPlan((block,), seed=1), catalogue)
    many = all_runs(SweepPlan((replace(block, draws=9),), seed=1), catalogue)
    after = all_runs(SweepPlan((other, block), seed=1), catalogue)[4:]
    more = all_runs(SweepPlan((wider,), seed=1), catalogue)
    assert many[:6] == few
    assert [(r.seed, r.values) for r in after] == [(r.seed, r.values) for r in few]
    assert [r.values[:2] for r in more] == [r.values for r in few]
    assert all_runs(SweepPlan((block,), seed=2), catalogue)[0].values != few[0].values


def test_points_of_the_grid_share_their_draws(catalogue: Catalogue) -> None:
    """Each draw meets every point of the grid, so that points are compared on the same random robots."""
    block = Block("a", (parameter("task.speed", 1.0, 2.0),), (drawn("friction.*.c0"),), draws=50)
    values = [dict(run.values)["friction.*.c0"] for run in all_runs(SweepPlan((block,)), catalogue)]
    assert values[0::2] == values[1::2]
    assert len(set(values)) == 50


def test_the_seed_gives_the_draws(catalogue: Catalogue) -> None:
    """NumPy's default generator, seeded with a run's seed, gives the shares that its values stand for."""
    low, high = 0.5, 2.0
    stiffness = SweptParameter("friction.*.c0", factor=True, space=LogUniform(low, high), each=True)
    for run in all_runs(SweepPlan((Block("a", (), (stiffness,), draws=3),), seed=3), catalogue):
        shares = np.random.default_rng(run.seed).random(7)
        expected = low * (high / low) ** shares
        np.testing.assert_allclose([v for _, v in run.values], expected, rtol=1e-12)
        assert [name for name, _ in run.values][-1] == "friction.joint_5_6.c0"


def test_factor_and_value(catalogue: Catalogue) -> None:
    """A factor multiplies each place's own number, a value replaces it."""
    plan = SweepPlan((Block("a", (parameter("friction.*.c0", 2.0), parameter("drives.gear[*]", 50.0, factor=False))),))
    runs = RunList(plan, catalogue)
    changes = runs.changes(runs.describe(0))
    friction = [value for leaf, value in changes.items() if leaf.key[0] == "friction"]
    assert friction == [2.0e5, 2.2e5, 1.4e5, 3.0e4, 2.0e4, 1.0e4, 8.0e3]
    assert [v for t, v in changes.items() if t.key[0] == "drives"] == [50.0] * 6
    assert runs.columns[0].unit == "1"


def test_one_name_means_one_thing(catalogue: Catalogue) -> None:
    """A column cannot hold values in one block and factors in another."""
    blocks = (
        Block("a", (parameter("task.speed", 2.0),)),
        Block("b", (parameter("task.speed", 2.0, factor=False),)),
    )
    with pytest.raises(ConfigError, match="means something else"):
        RunList(SweepPlan(blocks), catalogue)
