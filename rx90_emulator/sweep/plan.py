"""What a sweep consists of: blocks of runs, each the product of a grid and of random draws. Its file holds the same.

The values of a parameter come from a list or from a distribution. docs/howto/sweep.md shows the file.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeAlias, TypeVar

import numpy as np
from pydantic import Field, model_validator

from rx90_common.base.errors import ConfigError, located
from rx90_common.base.models import (
    FileModel,
    OneOf,
    Some,
    Triple,
    as_refusal,
    quantity,
    read_model,
    refusals,
)
from rx90_common.base.quoting import plain, quoted
from rx90_common.base.rates import Rates
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, MODEL_FILES, RobotFiles
from rx90_emulator.loop.parameters import Value

MOST_VALUES = 1_000_000
MOST_RUNS = 10_000_000
LARGEST_SEED = 2**63 - 1
_ROLES = (*MODEL_FILES, "task")
_LEAST_SHARE = 1e-3
"""Of a normal distribution between the bounds: where less is left, it is no longer computed exactly."""
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

    def values(self) -> tuple[Value, ...]:
        """Return the values.

        Raises:
            ValueError: for a count or bounds of which there are none.
        """
        start, stop, count = self.linspace or self.geomspace or ()
        if count != int(count) or not 1 <= count <= MOST_VALUES:
            raise ValueError(
                f"the count of values is {count:g}; accepted: a whole number in [1, {MOST_VALUES}]"
            )
        if self.geomspace is not None and not (start > 0.0 and stop > 0.0):
            raise ValueError(f"geomspace from {start:g} to {stop:g}; accepted: both > 0")
        spaced = np.linspace if self.geomspace is None else np.geomspace
        with np.errstate(all="ignore"):  # values that are not finite are refused
            return tuple(spaced(start, stop, int(count)).tolist())


class NormalDistribution(FileModel):
    """A normal distribution, cut off at the bounds."""

    mean: Annotated[float, Field(description="Mean.")]
    deviation: Annotated[float, Field(gt=0.0, description="Standard deviation.")]
    low: Annotated[float | None, Field(description="Lower bound; none if left out.")] = None
    high: Annotated[float | None, Field(description="Upper bound; none if left out.")] = None

    @property
    def bounds(self) -> tuple[float, float]:
        """Return lower and upper bound."""
        return (
            -math.inf if self.low is None else self.low,
            math.inf if self.high is None else self.high,
        )

    def shares(self) -> tuple[float, float]:
        """Return which shares of the whole distribution lie below the bounds."""
        from scipy.special import ndtr  # takes a while

        low, high = ((bound - self.mean) / self.deviation for bound in self.bounds)
        return float(ndtr(low)), float(ndtr(high))

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        from scipy.special import ndtri

        first, last = self.shares()
        return self.mean + self.deviation * float(ndtri(first + share * (last - first)))


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

    @property
    def bounds(self) -> tuple[float, ...]:
        """Return lower and upper bound."""
        if self.normal is not None:
            return self.normal.bounds
        return self.uniform or self.loguniform or ()

    @model_validator(mode="after")
    def _check_bounds(self) -> DrawnValues:
        low, high = self.bounds
        if not low < high:
            raise ValueError(
                f"the bounds are {low:g} and {high:g}; accepted: a lower one below the higher one"
            )
        if self.loguniform is not None and low <= 0.0:
            raise ValueError(f"loguniform from {low:g}; accepted: a lower bound > 0")
        if self.normal is not None:
            first, last = self.normal.shares()
            if last - first < _LEAST_SHARE:
                raise ValueError(
                    f"the bounds {low:g} and {high:g} leave {last - first:.2g} of the normal distribution "
                    f"({self.normal.mean:g}, {self.normal.deviation:g}); accepted: at least {_LEAST_SHARE:g}"
                )
        return self

    def quantile(self, share: float) -> float:
        """Return the value below which `share` of the distribution lies."""
        low, high = self.bounds
        if self.normal is not None:
            value = self.normal.quantile(share)
        elif self.uniform is not None:
            value = low + share * (high - low)
        else:
            value = low * math.exp(share * math.log(high / low))
        return min(high, max(low, value))


Listed: TypeAlias = Annotated[
    Annotated[tuple[_Value, ...], Field(strict=False, min_length=1)] | SpacedValues,
    Field(json_schema_extra={"accepted": _SPACES}),
]
Drawn: TypeAlias = Annotated[DrawnValues, Field(json_schema_extra={"accepted": _DRAWN})]
_Space = TypeVar("_Space")


class SweptParameter(OneOf, Generic[_Space]):
    """A swept quantity; its name is the path that it sets, unless there are paths."""

    one_of = ("value", "factor")

    value: Annotated[_Space | None, Field(description="Replaces what the files have.")] = None
    factor: Annotated[_Space | None, Field(description="Multiplies what the files have.")] = None
    paths: Annotated[
        tuple[str, ...] | None,
        Field(
            strict=False,
            min_length=1,
            description="Paths, such as friction.*.c0, that are all set to the same value.",
        ),
    ] = None


class GridParameter(SweptParameter[Listed]):
    """A quantity with a list of values; its name is the path that it sets, unless there are paths."""

    each: Annotated[Literal[False], Field(description="Of random draws only.")] = False

    @cached_property
    def space(self) -> tuple[Value, ...]:
        """Return the values, in their order."""
        listed = self.factor if self.value is None else self.value
        return listed.values() if isinstance(listed, SpacedValues) else listed or ()

    @model_validator(mode="after")
    def _check_values(self) -> GridParameter:
        for value, count in Counter(self.space).items():
            if not math.isfinite(value):
                raise ValueError(f"a value is {value}; accepted: finite numbers, or true and false")
            if count > 1:
                raise ValueError(f"the value {value} stands twice; accepted: once")
        return self


class DrawnParameter(SweptParameter[Drawn]):
    """A quantity with a distribution; its name is the path that it sets, unless there are paths."""

    each: Annotated[
        bool, Field(description="Whether every place that a * stands for is drawn on its own.")
    ] = False

    @property
    def space(self) -> DrawnValues:
        """Return the distribution."""
        drawn = self.factor if self.value is None else self.value
        assert drawn is not None
        return drawn


class Grid(Some[GridParameter]):
    """Parameters with lists of values, the last one varying fastest."""


class Draws(Some[DrawnParameter]):
    """Parameters with distributions."""


class Block(FileModel):
    """All combinations of the grid's values, each with the same random draws.

    The draws vary slowest and are shared by the grid's points, so that the points can be compared on the same
    random robots, and more draws leave the runs of the first ones as they are.
    """

    grid: Grid | None = None
    random: Draws | None = None
    draws: Annotated[
        int | None, Field(ge=1, le=MOST_RUNS, description="How often the random ones are drawn.")
    ] = None

    @property
    def listed(self) -> dict[str, GridParameter]:
        """Return the parameters of the grid by their names."""
        return {} if self.grid is None else self.grid.entries

    @property
    def drawn(self) -> dict[str, DrawnParameter]:
        """Return the random parameters by their names."""
        return {} if self.random is None else self.random.entries

    @model_validator(mode="after")
    def _check_parts(self) -> Block:
        if self.grid is None and self.random is None:
            raise ValueError("has no parameters; accepted: one or both of grid, random")
        if self.random is not None and self.draws is None:
            raise ValueError(
                f"draws is missing beside random; accepted: an integer in [1, {MOST_RUNS}]"
            )
        if self.random is None and self.draws not in (None, 1):
            raise ValueError(
                f"draws is {self.draws} without random parameters; accepted: parameters to draw"
            )
        return self

    @cached_property
    def points(self) -> int:
        """Return the number of points of the grid."""
        return math.prod(len(parameter.space) for parameter in self.listed.values())

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return self.points * (self.draws or 1)


def _file(role: str) -> Any:
    about = f"{DESCRIPTIONS[role][0].upper()}{DESCRIPTIONS[role][1:]}"
    return Field(
        description=f"{about}: beside the plan, or a shipped one; the robot's {FILES[role]} if left out."
    )


class SweepBase(FileModel):
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

    @property
    def files(self) -> RobotFiles:
        """Return robot, tool, drives, friction, controller and task."""
        return RobotFiles.named(self.robot, **self.model_dump(include={*_ROLES}))

    @property
    def rates(self) -> Rates:
        """Return the rates of the loops."""
        return Rates(self.base_rate, self.position_rate)

    @model_validator(mode="after")
    def _check_rates(self) -> SweepBase:
        with as_refusal():
            _ = self.rates
        return self

    def beside(self, folder: Path) -> dict[str, str]:
        """Return the names of the files that are in a folder, as paths."""
        names = self.model_dump(include={"robot", *_ROLES}, exclude_none=True)
        return {
            role: str(folder / name) for role, name in names.items() if (folder / name).exists()
        }

    def hashes(self) -> dict[str, dict[str, str] | None]:
        """Return name and SHA-256 of each file by its role; a shipped file's name is its path below config/."""
        files = self.files
        found: dict[str, dict[str, str] | None] = dict.fromkeys(_ROLES)
        for role in _ROLES:
            path: Path | None = getattr(files, role)
            if path is not None:
                # Wherever the user's own file is, the results are the same.
                name = path.name if (text := files.text(role)) == str(path) else text
                found[role] = {
                    "name": name,
                    "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
                }
        return found


class Blocks(Some[Block]):
    """Blocks of runs, by names of your own."""


class SweepPlan(FileModel):
    """A plan of many closed-loop runs, for rx90 sweep; its runs are the blocks' runs, one block after the other.

    The draws of a block depend on its name, and not on its place.
    """

    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED, description="Seed of all random draws.")] = 0
    base: SweepBase = SweepBase()
    blocks: Blocks

    @model_validator(mode="after")
    def _check_runs(self) -> SweepPlan:
        if self.runs > MOST_RUNS:
            raise ValueError(f"the sweep has {self.runs} runs; accepted: up to {MOST_RUNS}")
        return self

    @classmethod
    def of_grid(
        cls, values: Mapping[str, Sequence[Value]], base: SweepBase | None = None
    ) -> SweepPlan:
        """Return the plan of all combinations of values, by the paths that they set; the last path varies fastest.

        Raises:
            ConfigError: for values that are no grid.
        """
        for path in values.keys() & FileModel.about_keys:
            raise ConfigError(
                f"{quoted(path)} names nothing; accepted: such as friction.joint_2.c0"
            )
        grid = {path: {"value": np.asarray(listed).tolist()} for path, listed in values.items()}
        content = {"blocks": {"grid": {"grid": grid}}, "base": base or SweepBase()}
        with refusals(cls, content=content):
            return cls.model_validate(content)

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return sum(block.runs for block in self.blocks.entries.values())

    def description(self) -> dict[str, Any]:
        """Return everything that decides the results, as data for JSON: the files by their content."""
        plan = self.model_dump(mode="json", exclude_none=True)
        plan["base"] = {
            key: plan["base"].get(key) for key in ("base_rate", "position_rate", "substeps")
        }
        return {"files": self.base.hashes(), **_without_remarks(plan)}


def _without_remarks(content: Any) -> Any:
    """Return a plan's content without what is said of it for readers."""
    if not isinstance(content, dict):
        return content
    return {
        key: _without_remarks(value)
        for key, value in content.items()
        if key not in FileModel.about_keys
    }


def plan_hash(description: dict[str, Any]) -> str:
    """Return the SHA-256 of a plan's description; the files count by their content alone."""
    files = {role: entry and entry["sha256"] for role, entry in description["files"].items()}
    return hashlib.sha256(json.dumps({**description, "files": files}).encode()).hexdigest()


def load_sweep_plan(name: Path | str, *, robot: Path | str | None = None) -> SweepPlan:
    """Read a plan; its files are beside it, in the working folder, or shipped ones.

    Args:
        name: a path, or the name of a shipped file below config/.
        robot: instead of the one that the plan names; a shipped one's name, or a robot folder.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    file = resolve_config(str(name))
    plan = read_model(SweepPlan, file)
    files = plan.base.beside(file.parent)
    if robot is not None:
        files["robot"] = str(robot)
    plan = plan.replaced(base=files)
    with located(f"{plain(file)}: base.robot"):
        _ = plan.base.files
    return plan
