"""The runs of a plan, one by one: which values each of them sets."""

from __future__ import annotations

import hashlib
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np

from rx90_common.base.errors import ConfigError, SweepError
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
class Column:
    """What the column of a parameter holds.

    Attributes:
        name: of the parameter.
        paths: what it sets.
        unit: of its values; "1" for factors and SWITCH for true or false.
        factor: whether it holds factors.
    """

    name: str
    paths: tuple[str, ...]
    unit: str
    factor: bool

    @property
    def title(self) -> str:
        """Return the column's name in tables, which says of factors what they multiply."""
        return f"{'factor of ' * self.factor}{self.name}"


@dataclass(frozen=True)
class _Bound:
    """A parameter and the leaves that it sets."""

    parameter: SweptParameter
    leaves: tuple[Leaf, ...]
    unit: str


class RunList:
    """All runs of a plan over a given setup and task.

    Attributes:
        columns: of the parameters of all blocks, in the order of their first appearance.
    """

    def __init__(self, plan: SweepPlan, catalogue: Catalogue) -> None:
        """Check every path and value of the plan.

        Raises:
            ConfigError: naming block, parameter and what is accepted.
        """
        self._plan = plan
        self._catalogue = catalogue
        self._ends = list(accumulate(block.runs for block in plan.blocks))
        self._blocks = [_BoundBlock(block, catalogue) for block in plan.blocks]
        self.columns = _columns(self._blocks)

    def __len__(self) -> int:
        return self._ends[-1]

    def describe(self, index: int) -> RunDescription:
        """Return what run `index` is.

        Raises:
            SweepError: if there is no such run.
        """
        if not 0 <= index < len(self):
            raise SweepError(f"run {index}; accepted: 0 to {len(self) - 1}")
        block, inner = self._locate(index)
        draw, point = divmod(inner, block.block.points)
        seed = block.seed(self._plan.seed, draw)
        values = [*block.grid_values(point), *block.random_values(seed)]
        names = [bound.parameter.name for bound in block.bound]
        return RunDescription(index, block.block.name, seed, tuple(zip(names, values, strict=True)))

    def changes(self, run: RunDescription) -> dict[Leaf, Value]:
        """Return the value that each leaf takes in a run."""
        block, _ = self._locate(run.index)
        changes: dict[Leaf, Value] = {}
        for bound, (_, value) in zip(block.bound, run.values, strict=True):
            for leaf in bound.leaves:
                changes[leaf] = self._catalogue.value(leaf) * value if bound.parameter.factor else value
        return changes

    def _locate(self, index: int) -> tuple[_BoundBlock, int]:
        at = bisect_right(self._ends, index)
        return self._blocks[at], index - (self._ends[at - 1] if at else 0)


class _BoundBlock:
    """A block with its parameters' leaves; parameters that are drawn each on their own are taken apart."""

    def __init__(self, block: Block, catalogue: Catalogue) -> None:
        self.block = block
        self.grid = tuple(_bind(block, parameter, catalogue) for parameter in block.grid)
        single = [one for parameter in block.random for one in _singles(block, parameter, catalogue)]
        self.random = tuple(_bind(block, parameter, catalogue) for parameter in single)
        self.bound = self.grid + self.random
        self._shape = [len(_listed(bound.parameter)) for bound in self.grid]
        self._key = int.from_bytes(hashlib.sha256(block.name.encode()).digest()[:8], "big")
        self._check_overlap()

    def seed(self, root: int, draw: int) -> int:
        sequence = np.random.SeedSequence(root, spawn_key=(self._key, draw))
        return int(sequence.generate_state(1, np.uint64)[0])

    def grid_values(self, point: int) -> Iterator[Value]:
        at = np.unravel_index(point, self._shape) if self._shape else ()
        return (_listed(bound.parameter)[int(i)] for bound, i in zip(self.grid, at, strict=True))

    def random_values(self, seed: int) -> Iterator[Value]:
        # Each parameter takes one share, so that one more at the end leaves the others as they were. Half a
        # step of the generator keeps the share off 0, where an unbounded quantile is infinite.
        shares = np.random.default_rng(seed).random(len(self.random)) + 2.0**-54
        for bound, share in zip(self.random, shares.tolist(), strict=True):
            space = bound.parameter.space
            assert not isinstance(space, Values)
            yield space.quantile(share)

    def _check_overlap(self) -> None:
        owner: dict[Leaf, _Bound] = {}
        for bound in self.bound:
            for leaf in bound.leaves:
                other = owner.setdefault(leaf, bound)
                if other is not bound:
                    raise ConfigError(
                        f"block '{self.block.name}': '{other.parameter.name}' and '{bound.parameter.name}' both "
                        f"set {leaf.path}; accepted: one parameter for each value"
                    )


def _listed(parameter: SweptParameter) -> tuple[Value, ...]:
    assert isinstance(parameter.space, Values)
    return parameter.space.values


def _singles(block: Block, parameter: SweptParameter, catalogue: Catalogue) -> list[SweptParameter]:
    if not parameter.each:
        return [parameter]
    with _naming(block, parameter):
        places = [place for path in parameter.paths for place in catalogue.places(path)]
    return [replace(parameter, name=place.path, paths=(place.path,), each=False) for place in places]


def _bind(block: Block, parameter: SweptParameter, catalogue: Catalogue) -> _Bound:
    with _naming(block, parameter):
        places = [place for path in parameter.paths for place in catalogue.places(path)]
        units = sorted({place.unit for place in places})
        switch = SWITCH in units
        if len(units) > 1 and (switch or not parameter.factor):
            raise ConfigError(f"its paths have different units ({', '.join(units)}); accepted: one unit")
        if switch and parameter.factor:
            raise ConfigError("a factor of true or false; accepted: value")
        if isinstance(parameter.space, Values):
            for value in parameter.space.values:
                places[0].check(value)
        elif switch:
            raise ConfigError("true or false is drawn from a distribution; accepted: a grid of true and false")
    leaves = tuple(leaf for place in places for leaf in place.leaves)
    if len(set(leaves)) < len(leaves):
        raise ConfigError(
            f"block '{block.name}', parameter '{parameter.name}': its paths set a value twice; accepted: once"
        )
    return _Bound(parameter, leaves, "1" if parameter.factor else units[0])


@contextmanager
def _naming(block: Block, parameter: SweptParameter) -> Iterator[None]:
    """Let a refusal name block and parameter."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"block '{block.name}', parameter '{parameter.name}': {error}") from error


def _columns(blocks: list[_BoundBlock]) -> tuple[Column, ...]:
    columns: dict[str, Column] = {}
    for block in blocks:
        for bound in block.bound:
            parameter = bound.parameter
            column = Column(parameter.name, parameter.paths, bound.unit, parameter.factor)
            if columns.setdefault(parameter.name, column) != column:
                raise ConfigError(
                    f"block '{block.block.name}': the parameter '{parameter.name}' means something else in "
                    "an earlier block; accepted: the same paths and value or factor, or another name"
                )
    return tuple(columns.values())
