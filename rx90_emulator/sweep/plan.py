"""What a sweep consists of: blocks of runs, each the product of a grid and of random draws; and its YAML file.

The values of a parameter come from a list or from a distribution. docs/howto/sweep.md shows the file.
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from rx90_common.base.config import Section, load_yaml
from rx90_common.base.entries import LEFT_OUT, Entry, Integer, ListOf, Number, Numbers, Other, Switch, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Either, Entries, Group
from rx90_common.base.rates import Rates
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, MODEL_FILES, RobotFiles
from rx90_emulator.loop.parameters import Value

MOST_VALUES = 1_000_000
MOST_RUNS = 10_000_000
LARGEST_SEED = 2**63 - 1
_ROLES = (*MODEL_FILES, "task")
_LEAST_SHARE = 1e-3
_Thing = TypeVar("_Thing")


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
        raise ConfigError(f"the count of values is {count:g}; accepted: a whole number in [1, {MOST_VALUES}]")
    return int(count)


def _check_bounds(low: float, high: float) -> None:
    if not low < high:
        raise ConfigError(f"the bounds are {low:g} and {high:g}; accepted: a lower one below the higher one")


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
        _refuse_twice("parameter", (parameter.name for parameter in (*self.grid, *self.random)))
        listed = all(isinstance(parameter.space, Values) for parameter in self.grid)
        if not listed or any(isinstance(parameter.space, Values) for parameter in self.random):
            raise ConfigError(f"block '{self.name}'; accepted: lists of values in grid, distributions in random")

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
                found[role] = {"name": name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
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

_KINDS: dict[str, Callable[..., Values | Distribution]] = {
    "linspace": Values.linspace, "geomspace": Values.geomspace, "uniform": Uniform, "loguniform": LogUniform,
}  # fmt: skip


_VALUE = Other(
    "A value.",
    accepted="finite numbers, or true and false",
    good=lambda value: isinstance(value, int | float) and abs(value) <= sys.float_info.max,
    fragment={"anyOf": [Number("").rules(), Switch("").rules()]},
)
_spaced = partial(Numbers, count=3, default=LEFT_OUT)
_SPACED = Group(
    "Values at even distances or ratios, both ends included.",
    keys={
        "linspace": _spaced("Start, stop and count of evenly spaced values."),
        "geomspace": _spaced("Start, stop and count of values with a constant ratio."),
    },
    one_of=("linspace", "geomspace"),
)
_VALUES = Either(
    "The values, in their order.",
    mapping=_SPACED,
    plain=ListOf("The values.", item=_VALUE, least=1, accepted=_SPACES),
    default=LEFT_OUT,
)
_DISTRIBUTION = Group(
    "The distribution that values are drawn from.",
    keys={
        "uniform": Numbers("Bounds; every value between them is as likely.", count=2, default=LEFT_OUT),
        "loguniform": Numbers("Bounds, above 0; the logarithm is uniform.", count=2, default=LEFT_OUT),
        "normal": Group(
            "A normal distribution, cut off at the bounds.",
            keys={
                "mean": Number("Mean."),
                "deviation": Number("Standard deviation.", low=0.0, above=True),
                "low": Number("Lower bound; none if left out.", default=LEFT_OUT),
                "high": Number("Upper bound; none if left out.", default=LEFT_OUT),
            },
            default=LEFT_OUT,
        ),
    },
    one_of=("uniform", "loguniform", "normal"),
    accepted=_DRAWN,
    default=LEFT_OUT,
)


def _swept(space: Entry) -> Group:
    path = Text("A path, such as friction.*.c0.")
    each = "Whether every place that a * stands for is drawn on its own; of random draws only."
    return Group(
        "A swept quantity; its name is the path that it sets, unless there are paths.",
        keys={
            "paths": ListOf(
                "Paths that are all set to the same value.", item=path, least=1, accepted="at least one path",
                default=LEFT_OUT,
            ),
            "value": replace(space, about=f"{space.about} They replace what the files have."),
            "factor": replace(space, about=f"{space.about} They multiply what the files have."),
            "each": Switch(each, default=False),
        },
        one_of=("value", "factor"),
    )  # fmt: skip


def _name(role: str) -> Text:
    about = f"{DESCRIPTIONS[role][0].upper()}{DESCRIPTIONS[role][1:]}"
    return Text(f"{about}: beside the plan, or a shipped one; the robot's {FILES[role]} if left out.", default=LEFT_OUT)


_rate = partial(Integer, unit="Hz", low=1, high=10**9)
PLAN = Group(
    "A plan of many closed-loop runs, for rx90_sweep.",
    keys={
        "seed": Integer("Seed of all random draws.", low=0, high=LARGEST_SEED, default=0),
        "base": Group(
            "What every run starts from.",
            keys={
                "robot": Text("A shipped robot, or a robot folder; the RX90B if left out.", default=LEFT_OUT),
                **{role: _name(role) for role in _ROLES},
                "base_rate": _rate("Rate of plant and velocity loop.", default=Rates.base_hz),
                "position_rate": _rate("Rate of the position loop.", default=Rates.position_hz),
                "substeps": Integer(
                    "Plant steps in a tick; left out: as many as the arm of each run needs.",
                    low=1, high=1000, default=LEFT_OUT,
                ),
            },
            default=LEFT_OUT,
        ),
        "blocks": Entries(
            "Blocks of runs, by names of your own.",
            of=Group(
                "All combinations of the grid's values, each with the same random draws.",
                keys={
                    "grid": Entries(
                        "Parameters with lists of values, the last one varying fastest.",
                        of=_swept(_VALUES), least=1, what="parameter", default=LEFT_OUT,
                    ),
                    "random": Entries(
                        "Parameters with distributions.", of=_swept(_DISTRIBUTION), least=1, what="parameter",
                        default=LEFT_OUT,
                    ),
                    "draws": Integer("How often the random ones are drawn.", low=1, high=MOST_RUNS, default=1),
                },
                some_of=("grid", "random"),
                needed_by={"random": "draws"},
            ),
            least=1,
            what="block",
        ),
    },
)  # fmt: skip
"""What a sweep plan holds."""


def load_sweep_plan(name: Path | str, *, robot: Path | str | None = None) -> SweepPlan:
    """Read a plan.

    Args:
        name: a path, or the name of a shipped file below config/.
        robot: instead of the one that the plan names; a shipped one's name, or a robot folder.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    root = load_yaml(resolve_config(str(name)))
    content = PLAN.read(root)
    given = None if robot is None else str(robot)
    base = SweepBase(RobotFiles.named(given))
    if "base" in content:
        base = _base(root.section("base"), content["base"], given)
    blocks = tuple(_block(root.section("blocks"), name, block) for name, block in content["blocks"].items())
    return _built(root, "blocks", lambda: SweepPlan(blocks, content["seed"], base))


def _base(section: Section, content: dict[str, Any], robot: str | None) -> SweepBase:
    """Return what runs start from; its files are beside the plan, in the working folder, or shipped ones."""
    names = {}
    for role in ("robot", *_ROLES):
        if role in content:
            beside = section.file.parent / content[role]
            names[role] = str(beside) if beside.exists() else content[role]
    own = names.pop("robot", None) if robot is None else robot
    files = _built(section, "robot", lambda: RobotFiles.named(own, **names))
    rates = _built(section, "base_rate", lambda: Rates(content["base_rate"], content["position_rate"]))
    return SweepBase(files, rates, content.get("substeps"))


def _block(blocks: Section, name: str, content: dict[str, Any]) -> Block:
    parts = {
        part: tuple(_parameter(blocks.section(name).section(part), key, one) for key, one in content[part].items())
        for part in ("grid", "random")
        if part in content
    }
    return _built(blocks, name, lambda: Block(name, draws=content["draws"], **parts))


def _parameter(part: Section, name: str, content: dict[str, Any]) -> SweptParameter:
    mode = "factor" if "factor" in content else "value"
    made = partial(SweptParameter, name, paths=content.get("paths", ()), factor=mode == "factor", each=content["each"])
    space = _built(part.section(name), mode, lambda: _space(content[mode]))
    return _built(part, name, lambda: made(space=space))


def _space(given: tuple[Value, ...] | dict[str, Any]) -> Values | Distribution:
    if not isinstance(given, dict):
        return Values(tuple(value if isinstance(value, bool) else float(value) for value in given))
    (kind, how), *_ = given.items()
    return Normal(**how) if kind == "normal" else _KINDS[kind](*how)


def _built(section: Section, key: str, build: Callable[[], _Thing]) -> _Thing:
    """Build something; let a refusal that does not name the file yet name file and key."""
    try:
        return build()
    except ConfigError as error:
        if str(error).startswith(str(section.file)):
            raise
        raise ConfigError(f"{section.where(key)}: {error}") from error
