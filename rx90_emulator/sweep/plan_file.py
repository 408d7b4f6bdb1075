"""Read a sweep's plan from a YAML file; docs/howto/sweep.md shows the format."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rx90_common.base.config import Section, load_yaml
from rx90_common.base.errors import ConfigError
from rx90_common.base.rates import Rates
from rx90_common.base.share import resolve_config
from rx90_common.description.robot_files import MODEL_FILES, RobotFiles
from rx90_emulator.loop.catalogue import Value
from rx90_emulator.sweep.plan import LARGEST_SEED, MOST_RUNS, Block, SweepBase, SweepPlan, SweptParameter
from rx90_emulator.sweep.spaces import Distribution, LogUniform, Normal, Uniform, Values

_Thing = TypeVar("_Thing")
_SPACES = "[v1, v2, ...], {linspace: [start, stop, count]} or {geomspace: [start, stop, count]}"
_DRAWN = (
    "{uniform: [low, high]}, {loguniform: [low, high]} or "
    "{normal: {mean: x, deviation: x, low: x, high: x}} (the bounds may be left out)"
)


def load_sweep_plan(name: Path | str, *, robot: Path | str | None = None) -> SweepPlan:
    """Read a plan.

    Args:
        name: a path, or the name of a shipped file below config/.
        robot: instead of the one that the plan names; a shipped one's name, or a robot folder.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    root = _PlanSection.load(resolve_config(str(name)))
    given = None if robot is None else str(robot)
    base = _base(root.section("base"), given) if "base" in root else SweepBase(RobotFiles.named(given))
    seed = root.integer("seed", 0, LARGEST_SEED) if "seed" in root else 0
    blocks = root.section("blocks")
    if not list(blocks):
        root.refuse("blocks", {}, "at least one block")
    plan = _built(root, "blocks", lambda: SweepPlan(tuple(_block(blocks, name) for name in blocks), seed, base))
    root.finish()
    return plan


class _PlanSection(Section):
    """A section that also holds lists of any length."""

    @classmethod
    def load(cls, path: Path) -> _PlanSection:
        return cls(load_yaml(path)._data, path)

    def section(self, key: str) -> _PlanSection:
        """Return the mapping under `key`."""
        inner = super().section(key)
        return _PlanSection(inner._data, self.file, inner.path)

    def listed(self, key: str, accepted: str) -> list[Any]:
        """Return the list under `key`."""
        value = self._get(key, accepted)
        if not isinstance(value, list):
            self.refuse(key, value, accepted)
        return list(value)


def _base(section: _PlanSection, robot: str | None) -> SweepBase:
    names = {role: _file(section, role) for role in (*MODEL_FILES, "task") if role in section}
    own = _beside(section, "robot") if "robot" in section else None
    files = _built(section, "robot", lambda: RobotFiles.named(own if robot is None else robot, **names))
    base_hz = section.integer("base_rate", 1, 10**9) if "base_rate" in section else Rates.base_hz
    position_hz = section.integer("position_rate", 1, 10**9) if "position_rate" in section else Rates.position_hz
    substeps = section.integer("substeps", 1, 1000) if "substeps" in section else 1
    rates = _built(section, "base_rate", lambda: Rates(base_hz, position_hz))
    section.finish()
    return SweepBase(files, rates=rates, substeps=substeps)


def _file(section: _PlanSection, role: str) -> str:
    """Return what names a file: beside the plan, from the working folder, or shipped; or the tool `none`."""
    name = _beside(section, role)
    _built(section, role, lambda: RobotFiles.named(**{role: name}))
    return name


def _beside(section: _PlanSection, key: str) -> str:
    """Return the path of what stands beside the plan, or the name as it is."""
    name = section.text(key)
    beside = section.file.parent / name
    return str(beside) if beside.exists() else name


def _block(blocks: _PlanSection, name: str) -> Block:
    section = blocks.section(name)
    parts: dict[str, tuple[SweptParameter, ...]] = {}
    for part, read in (("grid", _grid_space), ("random", _random_space)):
        if part in section:
            inner = section.section(part)
            if not list(inner):
                section.refuse(part, {}, "at least one parameter")
            parts[part] = tuple(_parameter(inner, key, read) for key in inner)
    if not parts:
        blocks.refuse(name, {}, "a block with grid, random or both")
    draws = 1
    if "random" in section or "draws" in section:
        draws = section.integer("draws", 1, MOST_RUNS)
    section.finish()
    return _built(blocks, name, lambda: Block(name, draws=draws, **parts))


def _parameter(
    part: _PlanSection, name: str, read: Callable[[_PlanSection, str], Values | Distribution]
) -> SweptParameter:
    section = part.section(name)
    paths = tuple(section.listed("paths", "a list of paths")) if "paths" in section else (name,)
    if not paths:
        section.refuse("paths", [], "at least one path")
    for path in paths:
        if not isinstance(path, str):
            section.refuse("paths", path, "texts, such as friction.joint_2.c0")
    modes = [mode for mode in ("value", "factor") if mode in section]
    if len(modes) != 1:
        part.refuse(name, " and ".join(modes) or "neither value nor factor", "one of value and factor")
    each = section.boolean("each") if "each" in section else False
    space = _built(section, modes[0], lambda: read(section, modes[0]))
    section.finish()
    return _built(
        part, name, lambda: SweptParameter(name, paths=paths, factor=modes[0] == "factor", space=space, each=each)
    )


def _grid_space(section: _PlanSection, key: str) -> Values:
    if not section.holds_mapping(key):
        return Values(tuple(_value(section, key, value) for value in section.listed(key, _SPACES)))
    inner = section.section(key)
    kinds: dict[str, Callable[..., Values]] = {"linspace": Values.linspace, "geomspace": Values.geomspace}
    kind = _only(section, key, inner, kinds, _SPACES)
    return kinds[kind](*inner.numbers(kind, 3))


def _random_space(section: _PlanSection, key: str) -> Distribution:
    if not section.holds_mapping(key):
        section.refuse(key, section.listed(key, _DRAWN), _DRAWN)
    inner = section.section(key)
    kind = _only(section, key, inner, ("uniform", "loguniform", "normal"), _DRAWN)
    if kind != "normal":
        low, high = inner.numbers(kind, 2)
        return Uniform(low, high) if kind == "uniform" else LogUniform(low, high)
    normal = inner.section(kind)
    bounds = {side: normal.number(side) for side in ("low", "high") if side in normal}
    distribution = Normal(normal.number("mean"), normal.number("deviation"), **bounds)
    normal.finish()
    return distribution


def _only(section: _PlanSection, key: str, inner: _PlanSection, kinds: Any, accepted: str) -> str:
    found = list(inner)
    if len(found) != 1 or found[0] not in kinds:
        section.refuse(key, ", ".join(found), accepted)
    return found[0]


def _value(section: _PlanSection, key: str, value: Any) -> Value:
    if not isinstance(value, int | float) or not math.isfinite(value):
        section.refuse(key, value, "finite numbers, or true and false")
    return value if isinstance(value, bool) else float(value)


def _built(section: Section, key: str, build: Callable[[], _Thing]) -> _Thing:
    """Build something; let a refusal that does not name the file yet name file and key."""
    try:
        return build()
    except ConfigError as error:
        if str(error).startswith(str(section.file)):
            raise
        raise ConfigError(f"{section.where(key)}: {error}") from error
