"""Read a sweep's plan from a YAML file; docs/howto/sweep.md shows the format."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from rx90_common.base.config import load_yaml
from rx90_common.base.entries import LEFT_OUT, Entry, Integer, ListOf, Number, Numbers, Other, Switch, Text
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Either, Entries, Group
from rx90_common.base.rates import Rates
from rx90_common.base.section import Section
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import DESCRIPTIONS, FILES, MODEL_FILES, RobotFiles
from rx90_emulator.loop.parameters import Value
from rx90_emulator.sweep.plan import (
    LARGEST_SEED,
    METHODS,
    MOST_RUNS,
    Block,
    Distribution,
    LogUniform,
    Normal,
    SweepBase,
    SweepPlan,
    SweptParameter,
    Uniform,
    Values,
)

_Thing = TypeVar("_Thing")
_SPACES = "[v1, v2, ...], {linspace: [start, stop, count]} or {geomspace: [start, stop, count]}"
_DRAWN = (
    "{uniform: [low, high]}, {loguniform: [low, high]} or "
    "{normal: {mean: x, deviation: x, low: x, high: x}} (the bounds may be left out)"
)

_KINDS: dict[str, Callable[..., Values | Distribution]] = {
    "linspace": Values.linspace,
    "geomspace": Values.geomspace,
    "uniform": Uniform,
    "loguniform": LogUniform,
}
_ROLES = (*MODEL_FILES, "task")


def _is_value(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) <= sys.float_info.max


_VALUE = Other(
    "A value.",
    accepted="finite numbers, or true and false",
    good=_is_value,
    fragment={"anyOf": [Number("").rules(), Switch("").rules()]},
)
_SPACED = Group(
    "Values at even distances or ratios, both ends included.",
    keys={
        "linspace": Numbers("Start, stop and count of evenly spaced values.", count=3, default=LEFT_OUT),
        "geomspace": Numbers("Start, stop and count of values with a constant ratio.", count=3, default=LEFT_OUT),
    },
    one_of=("linspace", "geomspace"),
)
_VALUES = Either(
    "The values, in their order.",
    mapping=_SPACED,
    plain=ListOf("The values.", item=_VALUE, least=1, accepted=_SPACES),
    default=LEFT_OUT,
)
_bound = partial(Number, default=LEFT_OUT)
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
                "low": _bound("Lower bound; none if left out."),
                "high": _bound("Upper bound; none if left out."),
            },
            default=LEFT_OUT,
        ),
    },
    one_of=("uniform", "loguniform", "normal"),
    accepted=_DRAWN,
    default=LEFT_OUT,
)


def _swept(space: Entry, each: Entry) -> Group:
    path = Text("A path, such as friction.*.c0.")
    return Group(
        "A swept quantity; its name is the path that it sets, unless there are paths.",
        keys={
            "paths": ListOf(
                "Paths that are all set to the same value.", item=path, least=1, accepted="at least one path",
                default=LEFT_OUT,
            ),
            "value": replace(space, about=f"{space.about} They replace what the files have."),
            "factor": replace(space, about=f"{space.about} They multiply what the files have."),
            "each": each,
        },
        one_of=("value", "factor"),
    )  # fmt: skip


_GRID = _swept(
    _VALUES,
    Other("Of random draws only.", accepted="in random draws only", good=lambda value: value is False,
          fragment={"const": False}, default=False),
)  # fmt: skip
_RANDOM = _swept(_DISTRIBUTION, Switch("Whether every place that a * stands for is drawn on its own.", default=False))


def _name(role: str) -> Text:
    about = f"{DESCRIPTIONS[role][0].upper()}{DESCRIPTIONS[role][1:]}"
    return Text(f"{about}: beside the plan, or a shipped one; the robot's {FILES[role]} if left out.", default=LEFT_OUT)


PLAN = Group(
    "A plan of many closed-loop runs, for rx90_sweep.",
    keys={
        "seed": Integer("Seed of all random draws.", low=0, high=LARGEST_SEED, default=0),
        "base": Group(
            "What every run starts from.",
            keys={
                "robot": Text("A shipped robot, or a robot folder; the RX90B if left out.", default=LEFT_OUT),
                **{role: _name(role) for role in _ROLES},
                "base_rate": Integer(
                    "Rate of plant and velocity loop.", "Hz", low=1, high=10**9, default=Rates.base_hz
                ),
                "position_rate": Integer(
                    "Rate of the position loop.", "Hz", low=1, high=10**9, default=Rates.position_hz
                ),
                "substeps": Integer(
                    "Plant steps in a tick; left out: as many as the arm of each run needs.",
                    low=1, high=1000, default=LEFT_OUT,
                ),
                "method": Text(
                    "How runs are computed: the closed loop, or the perturbation method.",
                    choices=METHODS, default=METHODS[0],
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
                        of=_GRID, least=1, what="parameter", default=LEFT_OUT,
                    ),
                    "random": Entries(
                        "Parameters with distributions.", of=_RANDOM, least=1, what="parameter", default=LEFT_OUT
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
    blocks = root.section("blocks")
    return _built(
        root,
        "blocks",
        lambda: SweepPlan(
            tuple(_block(blocks, name, block) for name, block in content["blocks"].items()), content["seed"], base
        ),
    )


def _base(section: Section, content: dict[str, Any], robot: str | None) -> SweepBase:
    names = {role: _file(section, role, content[role]) for role in _ROLES if role in content}
    own = _beside(section, content["robot"]) if "robot" in content else None
    files = _built(section, "robot", lambda: RobotFiles.named(own if robot is None else robot, **names))
    rates = _built(section, "base_rate", lambda: Rates(content["base_rate"], content["position_rate"]))
    substeps, method = content.get("substeps"), content["method"]
    return _built(section, "substeps", lambda: SweepBase(files, rates=rates, substeps=substeps, method=method))


def _file(section: Section, role: str, given: str) -> str:
    """Return what names a file: beside the plan, from the working folder, or shipped; or the tool `none`."""
    name = _beside(section, given)
    _built(section, role, lambda: RobotFiles.named(**{role: name}))
    return name


def _beside(section: Section, name: str) -> str:
    """Return the path of what stands beside the plan, or the name as it is."""
    beside = section.file.parent / name
    return str(beside) if beside.exists() else name


def _block(blocks: Section, name: str, content: dict[str, Any]) -> Block:
    section = blocks.section(name)
    parts = {
        part: tuple(_parameter(section.section(part), key, one) for key, one in content[part].items())
        for part in ("grid", "random")
        if part in content
    }
    return _built(blocks, name, lambda: Block(name, draws=content["draws"], **parts))


def _parameter(part: Section, name: str, content: dict[str, Any]) -> SweptParameter:
    mode = "factor" if "factor" in content else "value"
    space = _built(part.section(name), mode, lambda: _space(content[mode]))
    paths = content.get("paths", (name,))
    return _built(
        part,
        name,
        lambda: SweptParameter(name, paths=paths, factor=mode == "factor", space=space, each=content["each"]),
    )


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
