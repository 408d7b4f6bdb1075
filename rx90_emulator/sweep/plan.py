"""What a sweep consists of: blocks of runs, each the product of a grid and of random draws; and its YAML file.

The values of a parameter come from a list or from a distribution. docs/howto/sweep.md shows the file.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from rx90_common.base.errors import ConfigError, located
from rx90_common.base.models import FileModel, OneOf, Some, Triple, quantity, read_model
from rx90_common.base.quoting import plain
from rx90_common.base.rates import Rates
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, MODEL_FILES, RobotFiles
from rx90_emulator.loop.parameters import Value

MOST_VALUES = 1_000_000
MOST_RUNS = 10_000_000
LARGEST_SEED = 2**63 - 1
_ROLES = (*MODEL_FILES, "task")
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
        _refuse_twice("value", self.values)
        _refuse_infinite(*self.values)

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


def _refuse_twice(what: str, values: Iterable[object]) -> None:
    for value, count in Counter(values).items():
        if count > 1:
            raise ConfigError(f"the {what} {value} stands twice; accepted: once")


def _refuse_infinite(*values: float) -> None:
    for value in values:
        if not math.isfinite(value):
            raise ConfigError(f"a value is {value}; accepted: finite numbers, or true and false")


def _count(count: float) -> int:
    if count != int(count) or not 1 <= count <= MOST_VALUES:
        raise ConfigError(
            f"the count of values is {count:g}; accepted: a whole number in [1, {MOST_VALUES}]"
        )
    return int(count)


def _check_bounds(low: float, high: float) -> None:
    if not low < high:
        raise ConfigError(
            f"the bounds are {low:g} and {high:g}; accepted: a lower one below the higher one"
        )


@dataclass(frozen=True)
class Uniform:
    """Every value between the bounds is as likely."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _refuse_infinite(self.low, self.high)
        _check_bounds(self.low, self.high)

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        return min(self.high, self.low + share * (self.high - self.low))


@dataclass(frozen=True)
class LogUniform(Uniform):
    """The logarithm is uniform."""

    def __post_init__(self) -> None:
        super().__post_init__()
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
        _refuse_infinite(self.mean, self.deviation)
        _check_bounds(self.low, self.high)
        if self.deviation <= 0.0:
            raise ConfigError(f"deviation is {self.deviation:g}; accepted: a number > 0")
        first, last = self._ends()
        if last - first < _LEAST_SHARE:
            raise ConfigError(
                f"the bounds {self.low:g} and {self.high:g} leave {last - first:.2g} of the normal "
                f"distribution ({self.mean:g}, {self.deviation:g}); accepted: at least {_LEAST_SHARE:g}"
            )

    def _ends(self) -> tuple[float, float]:
        from scipy.special import ndtr  # takes a while

        low = (self.low - self.mean) / self.deviation
        high = (self.high - self.mean) / self.deviation
        return float(ndtr(low)), float(ndtr(high))

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        from scipy.special import ndtri

        first, last = self._ends()
        value = self.mean + self.deviation * float(ndtri(first + share * (last - first)))
        return min(self.high, max(self.low, value))


Distribution = Uniform | LogUniform | Normal


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
            raise ConfigError(
                f"parameter '{self.name}' of a grid has each; accepted: in random draws only"
            )


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
            raise ConfigError(
                f"draws is {self.draws} without random parameters; accepted: parameters to draw"
            )
        _refuse_twice("parameter", (parameter.name for parameter in (*self.grid, *self.random)))
        listed = all(isinstance(parameter.space, Values) for parameter in self.grid)
        if not listed or any(isinstance(parameter.space, Values) for parameter in self.random):
            raise ConfigError(
                f"block '{self.name}'; accepted: lists of values in grid, distributions in random"
            )

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
    """

    files: RobotFiles = field(default_factory=RobotFiles)
    rates: Rates = field(default_factory=Rates)
    substeps: int | None = None

    def hashes(self) -> dict[str, dict[str, str] | None]:
        """Return name and SHA-256 of each file by its role; a shipped file's name is its path below config/."""
        found: dict[str, dict[str, str] | None] = dict.fromkeys(_ROLES)
        for role in _ROLES:
            path: Path | None = getattr(self.files, role)
            if path is not None:
                # Wherever the user's own file is, the results are the same.
                name = path.name if (text := self.files.text(role)) == str(path) else text
                found[role] = {
                    "name": name,
                    "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
                }
        return found


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
        _refuse_twice("block", (block.name for block in self.blocks))
        if self.runs > MOST_RUNS:
            raise ConfigError(f"the sweep has {self.runs} runs; accepted: up to {MOST_RUNS}")

    @classmethod
    def of_grid(
        cls, values: Mapping[str, Sequence[Value]], base: SweepBase | None = None
    ) -> SweepPlan:
        """Return the plan of all combinations of values, by the paths that they set; the last one varies fastest.

        Raises:
            ConfigError: for values that are no grid.
        """
        grid = tuple(
            SweptParameter(path, space=Values(tuple(listed))) for path, listed in values.items()
        )
        return cls((Block("grid", grid),), base=base or SweepBase())

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return sum(block.runs for block in self.blocks)

    def description(self) -> dict[str, Any]:
        """Return everything that decides the results, as data for JSON: the files by their content."""

        def described(parameter: SweptParameter) -> dict[str, Any]:
            kind = type(parameter.space).__name__.lower()
            data = asdict(parameter)
            return {**data, "space": {kind: data["space"]}}

        return {
            "seed": self.seed,
            "base_rate": self.base.rates.base_hz,
            "position_rate": self.base.rates.position_hz,
            "substeps": self.base.substeps,
            "files": self.base.hashes(),
            "blocks": [
                {
                    "name": block.name, "grid": [*map(described, block.grid)],
                    "random": [*map(described, block.random)], "draws": block.draws,
                }
                for block in self.blocks
            ],
        }  # fmt: skip


def plan_hash(description: dict[str, Any]) -> str:
    """Return the SHA-256 of a plan's description; the files count by their content alone."""
    files = {role: entry and entry["sha256"] for role, entry in description["files"].items()}
    text = json.dumps({**description, "files": files}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


# The file.

_SPACES = "[v1, v2, ...], {linspace: [start, stop, count]} or {geomspace: [start, stop, count]}"
_DRAWN = (
    "{uniform: [low, high]}, {loguniform: [low, high]} or "
    "{normal: {mean: x, deviation: x, low: x, high: x}} (the bounds may be left out)"
)

_Pair: TypeAlias = Annotated[tuple[float, ...], Field(strict=False, min_length=2, max_length=2)]
_Value: TypeAlias = Annotated[
    bool | float, Field(json_schema_extra={"accepted": "finite numbers, or true and false"})
]


class SpacedValues(OneOf):
    """Values at even distances or ratios, both ends included."""

    one_of = ("linspace", "geomspace")

    linspace: Annotated[
        Triple | None, Field(description="Start, stop and count of evenly spaced values.")
    ] = None
    geomspace: Annotated[
        Triple | None, Field(description="Start, stop and count of values with a constant ratio.")
    ] = None

    def space(self) -> Values:
        """Return the values."""
        if self.linspace is not None:
            return Values.linspace(*self.linspace)
        assert self.geomspace is not None
        return Values.geomspace(*self.geomspace)


class NormalDistribution(FileModel):
    """A normal distribution, cut off at the bounds."""

    mean: Annotated[float, Field(description="Mean.")]
    deviation: Annotated[float, Field(gt=0.0, description="Standard deviation.")]
    low: Annotated[float | None, Field(description="Lower bound; none if left out.")] = None
    high: Annotated[float | None, Field(description="Upper bound; none if left out.")] = None


class DrawnValues(OneOf):
    """The distribution that values are drawn from."""

    one_of = ("uniform", "loguniform", "normal")

    uniform: Annotated[
        _Pair | None, Field(description="Bounds; every value between them is as likely.")
    ] = None
    loguniform: Annotated[
        _Pair | None, Field(description="Bounds, above 0; the logarithm is uniform.")
    ] = None
    normal: NormalDistribution | None = None

    def space(self) -> Distribution:
        """Return the distribution."""
        if self.uniform is not None:
            return Uniform(*self.uniform)
        if self.loguniform is not None:
            return LogUniform(*self.loguniform)
        assert self.normal is not None
        low = -math.inf if self.normal.low is None else self.normal.low
        high = math.inf if self.normal.high is None else self.normal.high
        return Normal(self.normal.mean, self.normal.deviation, low, high)


_Listed: TypeAlias = Annotated[
    Annotated[tuple[_Value, ...], Field(strict=False, min_length=1)] | SpacedValues,
    Field(json_schema_extra={"accepted": _SPACES}),
]
_Drawn: TypeAlias = Annotated[DrawnValues, Field(json_schema_extra={"accepted": _DRAWN})]
_Space: TypeAlias = tuple[Value, ...] | SpacedValues | DrawnValues


class _Swept(OneOf):
    """A swept quantity; its name is the path that it sets, unless there are paths."""

    one_of = ("value", "factor")

    paths: Annotated[
        tuple[str, ...] | None,
        Field(
            strict=False,
            min_length=1,
            description="Paths, such as friction.*.c0, that are all set to the same value.",
        ),
    ] = None
    each: Annotated[
        bool,
        Field(
            description="Whether every place that a * stands for is drawn on its own; of random draws only."
        ),
    ] = False

    def _parameter(
        self, where: str, name: str, value: _Space | None, factor: _Space | None
    ) -> SweptParameter:
        given = factor if value is None else value
        with located(f"{where}.{'factor' if value is None else 'value'}"):
            space = (
                given.space()
                if isinstance(given, SpacedValues | DrawnValues)
                else Values(given or ())
            )
        with located(where):
            return SweptParameter(
                name, paths=self.paths or (), factor=value is None, space=space, each=self.each
            )


class GridParameter(_Swept):
    """A quantity with a list of values; its name is the path that it sets, unless there are paths."""

    value: Annotated[
        _Listed | None, Field(description="The values, which replace what the files have.")
    ] = None
    factor: Annotated[
        _Listed | None, Field(description="The values, which multiply what the files have.")
    ] = None

    def parameter(self, where: str, name: str) -> SweptParameter:
        """Return the quantity of this name; `where` names it in refusals."""
        return self._parameter(where, name, self.value, self.factor)


class DrawnParameter(_Swept):
    """A quantity with a distribution; its name is the path that it sets, unless there are paths."""

    value: Annotated[
        _Drawn | None, Field(description="Distribution of what replaces the files' value.")
    ] = None
    factor: Annotated[
        _Drawn | None, Field(description="Distribution of what multiplies the files' value.")
    ] = None

    def parameter(self, where: str, name: str) -> SweptParameter:
        """Return the quantity of this name; `where` names it in refusals."""
        return self._parameter(where, name, self.value, self.factor)


class BlockFile(FileModel):
    """All combinations of the grid's values, each with the same random draws."""

    grid: Annotated[
        Some[GridParameter] | None,
        Field(description="Parameters with lists of values, the last one varying fastest."),
    ] = None
    random: Annotated[
        Some[DrawnParameter] | None, Field(description="Parameters with distributions.")
    ] = None
    draws: Annotated[
        int | None, Field(ge=1, le=MOST_RUNS, description="How often the random ones are drawn.")
    ] = None

    @model_validator(mode="after")
    def _check_parts(self) -> BlockFile:
        if self.grid is None and self.random is None:
            raise ValueError("has no parameters; accepted: one or both of grid, random")
        if self.random is not None and self.draws is None:
            raise ValueError(
                f"draws is missing beside random; accepted: an integer in [1, {MOST_RUNS}]"
            )
        return self

    def block(self, where: str, name: str) -> Block:
        """Return the block of this name; `where` names it in refusals."""
        listed = {} if self.grid is None else self.grid.entries
        drawn = {} if self.random is None else self.random.entries
        grid = tuple(swept.parameter(f"{where}.grid.{key}", key) for key, swept in listed.items())
        random = tuple(
            swept.parameter(f"{where}.random.{key}", key) for key, swept in drawn.items()
        )
        with located(where):
            return Block(name, grid, random, 1 if self.draws is None else self.draws)


def _file(role: str) -> Any:
    about = f"{DESCRIPTIONS[role][0].upper()}{DESCRIPTIONS[role][1:]}"
    return Field(
        description=f"{about}: beside the plan, or a shipped one; the robot's {FILES[role]} if left out."
    )


class BaseFile(FileModel):
    """What every run starts from."""

    robot: Annotated[
        str | None, Field(description="A shipped robot, or a robot folder; the RX90B if left out.")
    ] = None
    urdf: Annotated[str | None, _file("urdf")] = None
    tool: Annotated[str | None, _file("tool")] = None
    drives: Annotated[str | None, _file("drives")] = None
    friction: Annotated[str | None, _file("friction")] = None
    controller: Annotated[str | None, _file("controller")] = None
    task: Annotated[str | None, _file("task")] = None
    base_rate: Annotated[
        int, quantity("Hz", "Rate of plant and velocity loop.", ge=1, le=10**9)
    ] = Rates.base_hz
    position_rate: Annotated[int, quantity("Hz", "Rate of the position loop.", ge=1, le=10**9)] = (
        Rates.position_hz
    )
    substeps: Annotated[
        int | None,
        Field(
            ge=1,
            le=1000,
            description="Plant steps in a tick; left out: as many as the arm of each run needs.",
        ),
    ] = None

    def base(self, file: Path, robot: str | None) -> SweepBase:
        """Return what runs start from; its files are beside the plan, in the working folder, or shipped ones."""
        names = self.model_dump(include={"robot", *_ROLES}, exclude_none=True)
        for role, name in names.items():
            if (file.parent / name).exists():
                names[role] = str(file.parent / name)
        planned = names.pop("robot", None)
        with located(f"{plain(file)}: base.robot"):
            files = RobotFiles.named(planned if robot is None else robot, **names)
        with located(f"{plain(file)}: base.base_rate"):
            return SweepBase(files, Rates(self.base_rate, self.position_rate), self.substeps)


class PlanFile(FileModel):
    """A plan of many closed-loop runs, for rx90 sweep."""

    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED, description="Seed of all random draws.")] = 0
    base: BaseFile = BaseFile()
    blocks: Annotated[Some[BlockFile], Field(description="Blocks of runs, by names of your own.")]


def load_sweep_plan(name: Path | str, *, robot: Path | str | None = None) -> SweepPlan:
    """Read a plan.

    Args:
        name: a path, or the name of a shipped file below config/.
        robot: instead of the one that the plan names; a shipped one's name, or a robot folder.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    file = resolve_config(str(name))
    plan = read_model(PlanFile, file)
    base = plan.base.base(file, None if robot is None else str(robot))
    where = f"{plain(file)}: blocks"
    blocks = tuple(
        block.block(f"{where}.{plain(key)}", key) for key, block in plan.blocks.entries.items()
    )
    with located(where):
        return SweepPlan(blocks, plan.seed, base)
