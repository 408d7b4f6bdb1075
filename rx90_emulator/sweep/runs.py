"""The runs of a plan, one by one: which values each of them sets."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, replace
from itertools import accumulate

import numpy as np

from rx90_common.base.errors import ConfigError, SweepError, located
from rx90_emulator.loop.parameters import SWITCH, Catalogue, Leaf, Value
from rx90_emulator.sweep.plan import Block, SweepPlan, SweptParameter, Values


@dataclass(frozen=True)
class RunDescription:
    """One run of a sweep.

    Attributes:
        index: number of the run in the sweep.
        block: name of its block.
        seed: of its random draws; `numpy.random.default_rng(seed)` gives their uniform shares.
        values: value, or factor, of each parameter by its name.
    """

    index: int
    block: str
    seed: int
    values: tuple[tuple[str, Value], ...]


@dataclass(frozen=True)
class Column(SweptParameter):
    """A parameter of a block, and what its column in tables holds.

    Attributes:
        unit: of its values; "1" for factors and SWITCH for true or false.
        leaves: the values that it sets.
    """

    _: KW_ONLY
    unit: str
    leaves: tuple[Leaf, ...]

    @property
    def title(self) -> str:
        """Return the column's name in tables, which says of factors what they multiply."""
        return f"factor of {self.name}" if self.factor else self.name


class RunList:
    """All runs of a plan over a given setup and task.

    Attributes:
        columns: of the parameters of all blocks, in the order of their first appearance.
    """

    def __init__(self, plan: SweepPlan, catalogue: Catalogue) -> None:
        """Check every path and value of the plan."""
        self._plan = plan
        self._catalogue = catalogue
        self._ends = list(accumulate(block.runs for block in plan.blocks))
        self._bound = [_bind(block, catalogue) for block in plan.blocks]
        columns: dict[str, Column] = {}
        for block, bound in zip(plan.blocks, self._bound, strict=True):
            for column in bound:
                first = columns.setdefault(column.name, column)
                if (first.paths, first.factor) != (column.paths, column.factor):
                    raise ConfigError(
                        f"block '{block.name}': the parameter '{column.name}' means something else in an earlier "
                        "block; accepted: the same paths and value or factor, or another name"
                    )
        self.columns = tuple(columns.values())

    def __len__(self) -> int:
        return self._ends[-1]

    def describe(self, index: int) -> RunDescription:
        """Return what run `index` is."""
        if not 0 <= index < len(self):
            raise SweepError(f"run {index}; accepted: 0 to {len(self) - 1}")
        at = bisect_right(self._ends, index)
        block = self._plan.blocks[at]
        columns = self._bound[at]
        draw, point = divmod(index - (self._ends[at - 1] if at else 0), block.points)
        key = int.from_bytes(hashlib.sha256(block.name.encode()).digest()[:8], "big")
        sequence = np.random.SeedSequence(self._plan.seed, spawn_key=(key, draw))
        seed = int(sequence.generate_state(1, np.uint64)[0])
        # The grid's parameters come first.
        lists = [column.space.values for column in columns if isinstance(column.space, Values)]
        places = np.unravel_index(point, [len(values) for values in lists]) if lists else ()
        values = [choices[int(place)] for choices, place in zip(lists, places, strict=True)]
        # Each random parameter takes one share, so that one more at the end leaves the others as they were. Half a step
        # of the generator keeps the share off 0, where an unbounded quantile is infinite.
        spaces = [column.space for column in columns if not isinstance(column.space, Values)]
        shares = np.random.default_rng(seed).random(len(spaces)) + 2.0**-54
        values += [
            space.quantile(share) for space, share in zip(spaces, shares.tolist(), strict=True)
        ]
        names = [column.name for column in columns]
        return RunDescription(index, block.name, seed, tuple(zip(names, values, strict=True)))

    def changes(self, run: RunDescription) -> dict[Leaf, Value]:
        """Return the value that each leaf takes in a run."""
        columns = self._bound[bisect_right(self._ends, run.index)]
        return {
            leaf: self._catalogue.value(leaf) * value if column.factor else value
            for column, (_, value) in zip(columns, run.values, strict=True)
            for leaf in column.leaves
        }


def _bind(block: Block, catalogue: Catalogue) -> Sequence[Column]:
    """Return the parameters of a block, the grid's first, with what they set; those that are drawn each apart."""
    columns: list[Column] = []
    for parameter in (*block.grid, *block.random):
        with located(f"block '{block.name}', parameter '{parameter.name}'"):
            places = [place for path in parameter.paths for place in catalogue.places(path)]
            each = [
                replace(parameter, name=place.path, paths=(place.path,), each=False)
                for place in places
            ]
            columns += [
                _column(one, catalogue) for one in (each if parameter.each else [parameter])
            ]
    owner: dict[Leaf, Column] = {}
    for column in columns:
        for leaf in column.leaves:
            if (other := owner.setdefault(leaf, column)) is not column:
                raise ConfigError(
                    f"block '{block.name}': '{other.name}' and '{column.name}' both set {leaf.path}; accepted: one "
                    "parameter for each value"
                )
    return columns


def _column(parameter: SweptParameter, catalogue: Catalogue) -> Column:
    places = [place for path in parameter.paths for place in catalogue.places(path)]
    units = sorted({place.unit for place in places})
    switch = SWITCH in units
    if len(units) > 1 and (switch or not parameter.factor):
        raise ConfigError(
            f"its paths have different units ({', '.join(units)}); accepted: one unit"
        )
    if switch and parameter.factor:
        raise ConfigError("a factor of true or false; accepted: value")
    if isinstance(parameter.space, Values):
        for value in parameter.space.values:
            places[0].check(value)
    elif switch:
        raise ConfigError(
            "true or false is drawn from a distribution; accepted: a grid of true and false"
        )
    leaves = tuple(leaf for place in places for leaf in place.leaves)
    if len(set(leaves)) < len(leaves):
        raise ConfigError("its paths set a value twice; accepted: once")
    return Column(**vars(parameter), unit="1" if parameter.factor else units[0], leaves=leaves)
