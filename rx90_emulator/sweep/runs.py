"""The runs of a plan, one by one: which values each of them sets."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from rx90_common.base.errors import ConfigError, SweepError, located
from rx90_emulator.loop.parameters import SWITCH, Catalogue, Leaf, Value
from rx90_emulator.sweep.plan import Block, DrawnParameter, DrawnValues, GridParameter, SweepPlan


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
class Column:
    """A parameter of a block, and what its column in tables holds.

    Attributes:
        name: of the parameter.
        paths: that are all set to the same value.
        factor: whether the value multiplies what the files have, or replaces it.
        space: where its values come from.
        unit: of its values; "1" for factors and SWITCH for true or false.
        leaves: the values that it sets.
    """

    name: str
    paths: tuple[str, ...]
    factor: bool
    space: tuple[Value, ...] | DrawnValues
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
        self._seed = plan.seed
        self._blocks = list(plan.blocks.entries.items())
        self._catalogue = catalogue
        self._ends = list(accumulate(block.runs for _, block in self._blocks))
        self._bound = [_bind(name, block, catalogue) for name, block in self._blocks]
        columns: dict[str, Column] = {}
        for (name, _), bound in zip(self._blocks, self._bound, strict=True):
            for column in bound:
                first = columns.setdefault(column.name, column)
                if (first.paths, first.factor) != (column.paths, column.factor):
                    raise ConfigError(
                        f"block '{name}': the parameter '{column.name}' means something else in an earlier "
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
        name, block = self._blocks[at]
        columns = self._bound[at]
        draw, point = divmod(index - (self._ends[at - 1] if at else 0), block.points)
        key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big")
        sequence = np.random.SeedSequence(self._seed, spawn_key=(key, draw))
        seed = int(sequence.generate_state(1, np.uint64)[0])
        # The grid's parameters come first.
        lists = [column.space for column in columns if isinstance(column.space, tuple)]
        places = np.unravel_index(point, [len(values) for values in lists]) if lists else ()
        values = [choices[int(place)] for choices, place in zip(lists, places, strict=True)]
        # Each random parameter takes one share, so that one more at the end leaves the others as they were. Half a step
        # of the generator keeps the share off 0, where an unbounded quantile is infinite.
        spaces = [column.space for column in columns if isinstance(column.space, DrawnValues)]
        shares = np.random.default_rng(seed).random(len(spaces)) + 2.0**-54
        values += [
            space.quantile(share) for space, share in zip(spaces, shares.tolist(), strict=True)
        ]
        names = [column.name for column in columns]
        return RunDescription(index, name, seed, tuple(zip(names, values, strict=True)))

    def changes(self, run: RunDescription) -> dict[Leaf, Value]:
        """Return the value that each leaf takes in a run."""
        columns = self._bound[bisect_right(self._ends, run.index)]
        return {
            leaf: self._catalogue.value(leaf) * value if column.factor else value
            for column, (_, value) in zip(columns, run.values, strict=True)
            for leaf in column.leaves
        }


def _bind(block_name: str, block: Block, catalogue: Catalogue) -> list[Column]:
    """Return the parameters of a block, the grid's first, with what they set; those that are drawn each apart."""
    columns: list[Column] = []
    parameters: list[tuple[str, GridParameter | DrawnParameter]] = [
        *block.listed.items(),
        *block.drawn.items(),
    ]
    for name, parameter in parameters:
        paths = parameter.paths or (name,)
        with located(f"block '{block_name}', parameter '{name}'"):
            if isinstance(parameter, DrawnParameter) and parameter.each:
                places = [place.path for path in paths for place in catalogue.places(path)]
                columns += [_column(path, (path,), parameter, catalogue) for path in places]
            else:
                columns.append(_column(name, paths, parameter, catalogue))
    owner: dict[Leaf, Column] = {}
    for column in columns:
        for leaf in column.leaves:
            if (other := owner.setdefault(leaf, column)) is not column:
                raise ConfigError(
                    f"block '{block_name}': '{other.name}' and '{column.name}' both set {leaf.path}; accepted: one "
                    "parameter for each value"
                )
    return columns


def _column(
    name: str,
    paths: tuple[str, ...],
    parameter: GridParameter | DrawnParameter,
    catalogue: Catalogue,
) -> Column:
    factor = parameter.value is None
    places = [place for path in paths for place in catalogue.places(path)]
    units = sorted({place.unit for place in places})
    switch = SWITCH in units
    if len(units) > 1 and (switch or not factor):
        raise ConfigError(
            f"its paths have different units ({', '.join(units)}); accepted: one unit"
        )
    if switch and factor:
        raise ConfigError("a factor of true or false; accepted: value")
    if isinstance(parameter, GridParameter):
        for value in parameter.space:
            places[0].check(value)
    elif switch:
        raise ConfigError(
            "true or false is drawn from a distribution; accepted: a grid of true and false"
        )
    leaves = tuple(leaf for place in places for leaf in place.leaves)
    if len(set(leaves)) < len(leaves):
        raise ConfigError("its paths set a value twice; accepted: once")
    return Column(name, paths, factor, parameter.space, "1" if factor else units[0], leaves)
