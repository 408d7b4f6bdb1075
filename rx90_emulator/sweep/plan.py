"""What a sweep consists of: blocks of runs, each the product of a grid and of random draws.

The values of a parameter come from a list or from a distribution.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.base.rates import Rates
from rx90_common.description.robot_files import MODEL_FILES, RobotFiles
from rx90_emulator.loop.parameters import Value

MOST_VALUES = 1_000_000
_LEAST_SHARE = 1e-3


@dataclass(frozen=True)
class Values:
    """The values of a grid's parameter, in their order.

    Raises:
        ConfigError: if there are none, one is not finite, or one stands twice.
    """

    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        if not self.values:
            raise ConfigError("the list of values is empty; accepted: at least one value")
        for value in self.values:
            if not math.isfinite(value):
                raise ConfigError(f"a value is {value}; accepted: finite numbers, or true and false")
        if len(set(self.values)) < len(self.values):
            twice = next(v for v in self.values if self.values.count(v) > 1)
            raise ConfigError(f"the value {twice} stands twice; accepted: each value once")

    @classmethod
    def linspace(cls, start: float, stop: float, count: float) -> Values:
        """Return evenly spaced values, both ends included."""
        return cls(tuple(np.linspace(start, stop, _count(count)).tolist()))

    @classmethod
    def geomspace(cls, start: float, stop: float, count: float) -> Values:
        """Return values with a constant ratio, both ends included."""
        if not (start > 0.0 and stop > 0.0):
            raise ConfigError(f"geomspace from {start:g} to {stop:g}; accepted: both > 0")
        return cls(tuple(np.geomspace(start, stop, _count(count)).tolist()))


def _count(count: float) -> int:
    if count != int(count) or not 1 <= count <= MOST_VALUES:
        raise ConfigError(f"the count of values is {count:g}; accepted: a whole number in [1, {MOST_VALUES}]")
    return int(count)


@dataclass(frozen=True)
class Uniform:
    """Every value between the bounds is as likely."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_bounds(self.low, self.high)
        _check_finite(self.low, self.high)

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        return min(self.high, self.low + share * (self.high - self.low))


@dataclass(frozen=True)
class LogUniform:
    """The logarithm is uniform."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _check_bounds(self.low, self.high)
        _check_finite(self.low, self.high)
        if self.low <= 0.0:
            raise ConfigError(f"loguniform from {self.low:g}; accepted: a lower bound > 0")

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        return min(self.high, self.low * math.exp(share * math.log(self.high / self.low)))


@dataclass(frozen=True)
class Normal:
    """A normal distribution cut off at the bounds.

    Raises:
        ConfigError: also if the bounds leave less than 0.1 % of it: there it is no longer computed exactly.
    """

    mean: float
    deviation: float
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        _check_finite(self.mean, self.deviation)
        if self.deviation <= 0.0:
            raise ConfigError(f"deviation is {self.deviation:g}; accepted: a number > 0")
        _check_bounds(self.low, self.high)
        first, last = self._ends()
        if last - first < _LEAST_SHARE:
            raise ConfigError(
                f"the bounds {self.low:g} and {self.high:g} leave {last - first:.2g} of the normal "
                f"distribution ({self.mean:g}, {self.deviation:g}); accepted: at least {_LEAST_SHARE:g}"
            )

    def _ends(self) -> tuple[float, float]:
        low, high = ((bound - self.mean) / self.deviation for bound in (self.low, self.high))
        return float(ndtr(low)), float(ndtr(high))

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        first, last = self._ends()
        value = self.mean + self.deviation * float(ndtri(first + share * (last - first)))
        return min(self.high, max(self.low, value))


Distribution = Uniform | LogUniform | Normal


def _check_finite(*values: float) -> None:
    for value in values:
        if not math.isfinite(value):
            raise ConfigError(f"a distribution has the value {value}; accepted: finite numbers")


def _check_bounds(low: float, high: float) -> None:
    if not low < high:
        raise ConfigError(f"the bounds are {low:g} and {high:g}; accepted: a lower one below the higher one")


MOST_RUNS = 10_000_000
LARGEST_SEED = 2**63 - 1
METHODS = ("closed_loop", "perturbation")


@dataclass(frozen=True)
class SweptParameter:
    """One swept quantity.

    Attributes:
        name: of its column.
        paths: what it sets (see `rx90_emulator.loop.parameters`), all of them to the same value; by default its name.
        factor: whether the value multiplies what the files have, or replaces it.
        space: where its values come from: a list in a grid, a distribution in random draws.
        each: whether every place that a `*` stands for is a parameter of its own, drawn on its own.
    """

    name: str
    _: KW_ONLY
    paths: tuple[str, ...] = ()
    factor: bool = False
    space: Values | Distribution
    each: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "paths", self.paths or (self.name,))
        if self.each and isinstance(self.space, Values):
            raise ConfigError(f"parameter '{self.name}' of a grid has each; accepted: in random draws only")


@dataclass(frozen=True)
class Block:
    """All combinations of the grid's values, each with the same random draws.

    The draws vary slowest and are shared by the grid's points, so that the points can be compared on the same
    random robots, and more draws leave the runs of the first ones as they are.

    Attributes:
        name: stands in the results; the draws depend on it and not on the block's place.
        grid: parameters with lists of values, the last one varying fastest.
        random: parameters with distributions.
        draws: how often the random ones are drawn; 1 without any.
    """

    name: str
    grid: tuple[SweptParameter, ...] = ()
    random: tuple[SweptParameter, ...] = ()
    draws: int = 1

    def __post_init__(self) -> None:
        if self.draws < 1:
            raise ConfigError(f"draws is {self.draws}; accepted: an integer >= 1")
        if self.draws > 1 and not self.random:
            raise ConfigError(f"draws is {self.draws} without random parameters; accepted: parameters to draw")
        names = [parameter.name for parameter in (*self.grid, *self.random)]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"the parameter '{name}' stands twice; accepted: once in a block")
        for parameter in self.grid:
            if not isinstance(parameter.space, Values):
                raise ConfigError(f"'{parameter.name}' of a grid is drawn; accepted: a list of values")
        for parameter in self.random:
            if isinstance(parameter.space, Values):
                raise ConfigError(f"'{parameter.name}' of the random draws is a list; accepted: a distribution")

    @property
    def points(self) -> int:
        """Return the number of points of the grid."""
        return math.prod(len(p.space.values) for p in self.grid if isinstance(p.space, Values))

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return self.points * self.draws


@dataclass(frozen=True)
class SweepBase:
    """What every run starts from.

    Attributes:
        files: robot, tool, drives, friction, controller and task.
        rates: of the loops.
        substeps: plant steps in a tick; None for as many as the arm of each run needs.
        method: `closed_loop`, or `perturbation`: deviations from the prescribed motion, linear in the arm
            (docs/explanation/perturbation.md), several times as fast where friction and controller alone are swept.

    Raises:
        ConfigError: for another method, or more than one plant step with the perturbation method.
    """

    files: RobotFiles = field(default_factory=RobotFiles)
    rates: Rates = field(default_factory=Rates)
    substeps: int | None = None
    method: str = METHODS[0]

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(f"method is {quoted(self.method)}; accepted: {' or '.join(METHODS)}")
        if self.method == "perturbation" and self.substeps not in (None, 1):
            raise ConfigError(f"substeps is {self.substeps}; accepted by the perturbation method: 1, or left out")

    def hashes(self) -> dict[str, dict[str, str] | None]:
        """Return name and SHA-256 of each file by its role; a shipped file's name is its path below config/.

        Raises:
            ConfigError: if one cannot be read.
        """
        paths = {role: getattr(self.files, role) for role in (*MODEL_FILES, "task")}
        return {
            role: None if path is None else _named_hash(path, self.files.text(role)) for role, path in paths.items()
        }


def _named_hash(path: Path, text: str) -> dict[str, str]:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    # Wherever the user's own file is, the results are the same.
    name = path.name if text == str(path) else text
    return {"name": name, "sha256": hashlib.sha256(content).hexdigest()}


@dataclass(frozen=True)
class SweepPlan:
    """A sweep as it is asked for; its runs are the blocks' runs, one block after the other.

    Attributes:
        blocks: at least one.
        seed: of all random draws.
        base: what every run starts from.

    Raises:
        ConfigError: naming the value and what is accepted.
    """

    blocks: tuple[Block, ...]
    seed: int = 0
    base: SweepBase = field(default_factory=SweepBase)

    def __post_init__(self) -> None:
        if not self.blocks:
            raise ConfigError("the sweep has no blocks; accepted: at least one")
        if not 0 <= self.seed <= LARGEST_SEED:
            raise ConfigError(f"seed is {self.seed}; accepted: an integer in [0, {LARGEST_SEED}]")
        names = [block.name for block in self.blocks]
        for name in names:
            if names.count(name) > 1:
                raise ConfigError(f"the block '{name}' stands twice; accepted: names that differ")
        if self.runs > MOST_RUNS:
            raise ConfigError(f"the sweep has {self.runs} runs; accepted: up to {MOST_RUNS}")

    @classmethod
    def of_grid(cls, values: Mapping[str, Sequence[Value]], base: SweepBase | None = None) -> SweepPlan:
        """Return the plan of all combinations of values, by the paths that they set; the last one varies fastest.

        Raises:
            ConfigError: for values that are no grid.
        """
        grid = tuple(SweptParameter(path, space=Values(tuple(listed))) for path, listed in values.items())
        return cls((Block("grid", grid),), base=base or SweepBase())

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return sum(block.runs for block in self.blocks)

    def description(self) -> dict[str, Any]:
        """Return everything that decides the results, as data for JSON: the files by their content."""
        return {
            "seed": self.seed,
            "base_rate": self.base.rates.base_hz,
            "position_rate": self.base.rates.position_hz,
            "substeps": self.base.substeps,
            # Results of earlier versions, which had no other method, can be taken up.
            **({} if self.base.method == METHODS[0] else {"method": self.base.method}),
            "files": self.base.hashes(),
            "blocks": [_block_description(block) for block in self.blocks],
        }


def _block_description(block: Block) -> dict[str, Any]:
    parts = {"grid": block.grid, "random": block.random}
    described = {name: [_parameter_description(p) for p in parameters] for name, parameters in parts.items()}
    return {"name": block.name, **described, "draws": block.draws}


def _parameter_description(parameter: SweptParameter) -> dict[str, Any]:
    data = asdict(parameter)
    data["space"] = {type(parameter.space).__name__.lower(): data["space"]}
    return data


def plan_hash(description: dict[str, Any]) -> str:
    """Return the SHA-256 of a plan's description; the files count by their content alone."""
    files = {role: entry and entry["sha256"] for role, entry in description["files"].items()}
    text = json.dumps({**description, "files": files}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
