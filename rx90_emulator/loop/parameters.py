"""Parameters of a setup and a task by dotted paths: what there is, and how values are set.

`friction.joint_2.c0`, `friction.*.tau_c`, `drives.rotor_inertia[1]`, `drives.elasticity.stiffness[0]`,
`controller.kp[*]`, `arm.link_3.mass`, `controller.feed_forward.coulomb`, `task.speed`, `arm.seed`, and where an element
has that part `friction.joint_2.load.driving` or `friction.joint_2.ripple.motor_amplitude[0]`, and where motors cog
`drives.cogging.amplitude[1][0]`, of the second wave and motor 1. A `*` stands for every name or index in its place; an
index counts from 0. `tau_c` and `tau_s` stand for both signs of the velocity.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from rx90_common.base.arrays import Array
from rx90_common.base.errors import ConfigError, check_type, located
from rx90_common.base.models import AnyModel, Model, word_of
from rx90_common.base.quoting import counted, nearest, question, quoted
from rx90_common.description.robot import RobotModel
from rx90_common.description.rotations import symmetric
from rx90_common.description.urdf import inertia_fault
from rx90_common.friction.parts.scatter import LARGEST_SEED
from rx90_common.friction.signs import BySign
from rx90_controller.lines.task import LineTask
from rx90_controller.paths.path import Path
from rx90_emulator.loop.setup import Setup

Key = tuple[str, ...]
Index = tuple[int, ...]
Value = float | bool

SWITCH = "switch"
"""Stands where the unit would, for values that are true or false."""

ARM_UNITS = {"mass": "kg", "com": "m", "inertia": "kg m^2"}
Motion = TypeVar("Motion", bound="LineTask | Path")
TASK_UNITS = {
    "start": "m", "end": "m", "speed": "m/s", "acceleration": "m/s^2", "start_rpy": "rad", "end_rpy": "rad",
    "rest_before": "s", "rest_after": "s", "singularity_margin": "1",
}  # fmt: skip

_PATH = re.compile(r"(?P<names>[^\[\]]+)(?P<indices>(?:\[(?:[0-9]{1,9}|\*)\])*)")


@dataclass(frozen=True)
class Leaf:
    """One value: the key of its leaf, and the index in it, () where the leaf is one number."""

    key: Key
    index: Index = ()

    @property
    def path(self) -> str:
        """Return what names it."""
        return ".".join(self.key) + "".join(f"[{i}]" for i in self.index)


@dataclass(frozen=True)
class Place:
    """What one path without `*` names.

    Attributes:
        path: the path.
        leaves: the values that it sets, two for `tau_c` and `tau_s`.
        unit: their unit, or SWITCH.
    """

    path: str
    leaves: tuple[Leaf, ...]
    unit: str

    def check(self, value: Value | np.generic) -> Value:
        """Return a value, a scalar of NumPy's as one of Python's; refuse one of the wrong kind."""
        switch = self.unit == SWITCH
        plain = value.item() if isinstance(value, np.generic) else value
        if not isinstance(plain, int | float) or isinstance(plain, bool) != switch:
            raise ConfigError(
                f"a value is {value}; accepted: {'true or false' if switch else 'numbers'}"
            )
        return plain


class ParameterValue(NamedTuple):
    """A value and its unit; SWITCH stands for the unit of true and false."""

    value: Value
    unit: str


def parameters(setup: Setup) -> dict[str, ParameterValue]:
    """Return every parameter of a setup by its path: `friction.joint_2.c0`, `drives.gear[0]`, `arm.link_3.mass`, ..."""
    catalogue = Catalogue(setup)
    return {
        place.path: ParameterValue(catalogue.value(place.leaves[0]), place.unit)
        for place in catalogue.all()
    }


class Catalogue:
    """All values of a setup, and of a task if there is one, that have a path."""

    def __init__(self, setup: Setup, task: LineTask | Path | None = None) -> None:
        check_type(setup=(setup, Setup))
        self._values: dict[Key, tuple[Any, str]] = {}
        self._leaves: dict[
            Key, tuple[Key, ...]
        ] = {}  # what a path names, each by its place in the models
        self._add(("arm", "seed"), setup.seed, "1")
        self._add_model(("drives",), setup.drives)
        self._add_model(("controller",), setup.controller)
        for field, unit in TASK_UNITS.items():
            if hasattr(task, field):
                self._add(("task", field), getattr(task, field), unit)
        for name, element in zip(setup.friction.names, setup.friction.elements, strict=True):
            self._add_model(("friction", name), element)
        for i, (field, unit) in itertools.product(
            range(len(setup.robot.joint_names)), ARM_UNITS.items()
        ):
            self._add(("arm", f"link_{i + 1}", field), getattr(setup.robot.chain, field)[i], unit)

    def _add(self, key: Key, value: Any, unit: str, path: Key = ()) -> None:
        self._values[key] = value, unit
        self._leaves[path or key] = (key,)

    def _add_model(self, around: Key, model: Model) -> None:
        """Add all numbers and switches of a model, whose place is `around`, and of the models in it."""
        for name, value in model:
            key = (*around, name)
            if isinstance(value, BySign) and isinstance(value.positive, float):
                unit = word_of(type(model), name, "unit")
                self._add((*key, "positive"), value.positive, unit, (*around, f"{name}_positive"))
                self._add((*key, "negative"), value.negative, unit, (*around, f"{name}_negative"))
                self._leaves[key] = ((*key, "positive"), (*key, "negative"))
            elif isinstance(value, Model):
                self._add_model(key, value)
            elif isinstance(value, bool):
                self._add(key, value, SWITCH)
            elif (
                value is not None
                and np.size(value)
                and (unit := word_of(type(model), name, "unit"))
            ):
                short = word_of(type(model), name, "path")
                self._add(key, value, unit, (around[0], short) if short else ())

    def value(self, leaf: Leaf) -> Value:
        """Return a value as the files have it."""
        value, _ = self._values[leaf.key]
        if leaf.index:
            return float(np.asarray(value)[leaf.index])
        return value if isinstance(value, bool) else float(value)

    def all(self) -> list[Place]:
        """Return a place for each value."""
        return [
            place
            for path, keys in self._leaves.items()
            if len(keys) == 1
            for place in self._indexed(
                ".".join(path), path, "*" * np.ndim(self._values[keys[0]][0])
            )
        ]

    def places(self, path: str) -> tuple[Place, ...]:
        """Return what a path names, one place for each combination that its `*` stand for."""
        check_type(path=(path, str))
        match = _PATH.fullmatch(path)
        if match is None:
            raise ConfigError(
                f"{quoted(path)} is not a path; accepted: such as friction.joint_2.c0 or drives.gear[1]"
            )
        wanted = match["names"].split(".")
        keys = [key for key in self._leaves if _matches(key, wanted)]
        if not keys:
            raise ConfigError(self._unknown(path, wanted))
        indices = match["indices"][1:-1].split("][") if match["indices"] else []
        places = [place for key in keys for place in self._indexed(path, key, indices)]
        units = sorted({place.unit for place in places})
        if len(units) > 1:
            found = f"values of different units ({', '.join(units)})"
            raise ConfigError(f"{quoted(path)} names {found}; accepted: one unit")
        return tuple(places)

    def _indexed(self, path: str, key: Key, indices: Sequence[str]) -> list[Place]:
        keys = self._leaves[key]
        value, unit = self._values[keys[0]]
        shape = np.shape(value)
        if len(indices) != len(shape) or any(
            i != "*" and int(i) >= n for i, n in zip(indices, shape, strict=True)
        ):
            raise ConfigError(f"{quoted(path)}: {_accepted_indices('.'.join(key), shape)}")
        chosen = (range(n) if i == "*" else (int(i),) for i, n in zip(indices, shape, strict=True))
        return [
            Place(Leaf(key, index).path, tuple(Leaf(k, index) for k in keys), unit)
            for index in itertools.product(*chosen)
        ]

    def _unknown(self, path: str, wanted: Sequence[str]) -> str:
        """Say at which name a path goes astray, and which names there are in that place."""
        for depth in range(len(wanted) + 1):
            known = [key for key in self._leaves if _matches(key[:depth], wanted[:depth])]
            below = sorted({key[depth] for key in known if len(key) > depth})
            if depth == len(wanted):
                return f"{quoted(path)} is a group of values; accepted: {path} and one of .{', .'.join(below)}"
            if not below:
                return f"{quoted(path)} goes on after a value; accepted: {'.'.join(wanted[:depth])}"
            if wanted[depth] != "*" and wanted[depth] not in below:
                break
        unknown = f"{quoted(wanted[depth])} is unknown{question(nearest(wanted[depth], below))}"
        return f"{quoted(path)} names nothing: {unknown}; accepted there: {', '.join(below)}"


def _accepted_indices(name: str, shape: tuple[int, ...]) -> str:
    if not shape:
        return f"{name} is one value; accepted: {name}, without an index"
    count = (
        counted(shape[0], "number")
        if len(shape) == 1
        else f"{' by '.join(map(str, shape))} numbers"
    )
    last = "".join(f"[{n - 1}]" for n in shape)
    return f"{name} is {count}; accepted: up to {name}{last}, or * for all of an index"


def _matches(key: Sequence[str], wanted: Sequence[str]) -> bool:
    return len(key) == len(wanted) and all(w in ("*", k) for k, w in zip(key, wanted, strict=True))


def with_parameters(setup: Setup, values: Mapping[str, Value]) -> Setup:
    """Return a copy of a setup with some of its parameters set, such as `{"friction.joint_2.tau_s": 40.0}`.

    Args:
        setup: stays as it is.
        values: by the paths that `parameters` lists, SI units. A `*` stands for every name or index in its place, as in
            `friction.*.c0` or `drives.gear[*]`; `tau_c` and `tau_s` stand for both signs of the velocity. Of two paths
            to one value the last one counts.

    Raises:
        ConfigError: if a path names nothing or a value is out of range, with what is accepted.
    """
    check_type(values=(values, Mapping))
    catalogue = Catalogue(setup)
    leaves: dict[Leaf, Value] = {}
    for path, value in values.items():
        for place in catalogue.places(path):
            with located(quoted(path)):
                leaves.update(dict.fromkeys(place.leaves, place.check(value)))
    return _changed(setup, _tree(leaves))


def apply(setup: Setup, task: Motion, values: Mapping[Leaf, Value]) -> tuple[Setup, Motion]:
    """Return the setup and the task with the given values set.

    The URDF text inside the robot stays as it was read; its chain and Pinocchio's model are changed.

    Raises:
        ConfigError, LineError: if a value is out of range.
    """
    tree = _tree(values)
    return _changed(setup, tree), replace(
        task, **_changes(task, tree["task"])
    ) if "task" in tree else task


def _changes(holder: Any, tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the changed fields, of a model in it a mapping of its own."""
    changes: dict[str, Any] = {}
    for name, entries in tree.items():
        old = getattr(holder, name)
        changes[name] = (
            _changes(old, entries) if isinstance(old, Model) else _with_entries(old, entries)
        )
    return changes


def _changed_model(where: str, model: AnyModel, tree: Mapping[str, Any]) -> AnyModel:
    """Return a file's content with some values changed."""
    if not tree:
        return model
    with located(where):
        return model.replaced(**_changes(model, tree))


def _with_entries(old: Any, entries: Mapping[Index, Value]) -> Any:
    """Return a value, or rows of values, with some of them changed."""
    if () in entries:
        value = entries[()]
        whole = type(old) is int and isinstance(value, float) and value.is_integer()
        return int(value) if whole else value
    numbers = np.array(old, dtype=np.float64)
    for index, value in entries.items():
        numbers[index] = value
    return tuple(numbers.tolist())


def _tree(values: Mapping[Leaf, Value]) -> dict[str, Any]:
    """Return values by the names of their paths, one below the other; those of a leaf by their index."""
    tree: dict[Any, Any] = {}
    for leaf, value in values.items():
        node = tree
        for name in leaf.key:
            node = node.setdefault(name, {})
        node[leaf.index] = value
    return tree


def _changed(setup: Setup, tree: Mapping[str, Any]) -> Setup:
    new: dict[str, Any] = {}
    for name, model in (("drives", setup.drives), ("controller", setup.controller)):
        if name in tree:
            new[name] = _changed_model(name, model, tree[name])
    if "friction" in tree:
        elements = zip(setup.friction.names, setup.friction.elements, strict=True)
        changed = [
            _changed_model(f"friction.{name}", one, tree["friction"].get(name, {}))
            for name, one in elements
        ]
        new["friction"] = replace(setup.friction, elements=tuple(changed))
    links = dict(tree.get("arm", {}))
    if (seed := links.pop("seed", {(): None})[()]) is not None:
        if isinstance(seed, float) and not seed.is_integer():  # NaN and infinity are none
            raise ConfigError(
                f"arm.seed is {seed}; accepted: a whole number from 0 to {LARGEST_SEED}"
            )
        new["seed"] = int(seed)
    if links:
        new["robot"] = _robot(setup.robot, links)
    return replace(setup, **new) if new else setup


def _robot(robot: RobotModel, links: Mapping[str, Any]) -> RobotModel:
    """Return the robot with the bodies of some links changed, in the chain and in a copy of Pinocchio's model."""
    bodies = {name: getattr(robot.chain, name).copy() for name in ARM_UNITS}
    turns = _rotations_at_zero(robot.model)
    model = robot.model.copy()
    rows = {int(link.removeprefix("link_")) - 1: fields for link, fields in links.items()}
    for row, fields in rows.items():
        for field, entries in fields.items():
            for index, value in entries.items():
                bodies[field][(row, *index)] = value
    for row in sorted(rows):
        mass, com, inertia = (bodies[name][row] for name in ARM_UNITS)
        where = f"arm.link_{row + 1}"
        if not (np.isfinite(mass) and mass > 0):
            raise ConfigError(f"{where}.mass is {mass:g} kg; accepted: a finite number > 0")
        if not (np.isfinite(com).all() and np.isfinite(inertia).all()):
            raise ConfigError(
                f"{where}: com {com.tolist()}, inertia {inertia.tolist()}; accepted: finite numbers"
            )
        if (fault := inertia_fault(tuple(inertia.tolist()))) is not None:
            raise ConfigError(f"{where}.inertia is {inertia.tolist()} kg m^2; accepted: {fault}")
        turn = turns[row]  # the chain's axes are the base's at q = 0
        tensor = turn.T @ symmetric(inertia) @ turn
        model.inertias[row + 1] = pin.Inertia(mass, turn.T @ com, tensor)
    return replace(robot, chain=robot.chain._replace(**bodies), model=model)


@lru_cache(maxsize=4)
def _rotations_at_zero(model: Any) -> list[Array]:
    """Return the orientation of each link at q = 0; runs of a sweep have it in common."""
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    return [data.oMi[row + 1].rotation.copy() for row in range(model.nq)]
