"""Set values of a setup and a task, and build only what they touch anew."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from rx90_common.base.errors import ConfigError, check_type
from rx90_common.base.quoting import quoted
from rx90_common.description.robot import RobotModel
from rx90_common.description.urdf import inertia_fault
from rx90_common.friction import FrictionSet
from rx90_common.friction.parts.scatter import LARGEST_SEED
from rx90_controller.lines.task import LineTask
from rx90_emulator.loop.catalogue import Catalogue, Index, Key, Leaf, Value
from rx90_emulator.loop.setup import Setup

Changes = dict[Key, dict[Index, Value]]


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
            try:
                taken = place.check(value)
            except ConfigError as error:
                raise ConfigError(f"{quoted(path)}: {error}") from error
            leaves.update(dict.fromkeys(place.leaves, taken))
    return _changed(setup, _sections(leaves))


def apply(setup: Setup, task: LineTask, values: Mapping[Leaf, Value]) -> tuple[Setup, LineTask]:
    """Return the setup and the task with the given values set.

    The URDF text inside the robot stays as it was read; its chain and Pinocchio's model are changed.

    Raises:
        ConfigError, LineError: if a value is out of range.
    """
    sections = _sections(values)
    if "task" in sections:
        task = replace(task, **_fields(task, sections["task"]))
    return _changed(setup, sections), task


def _sections(values: Mapping[Leaf, Value]) -> dict[str, Changes]:
    sections: dict[str, Changes] = defaultdict(dict)
    for leaf, value in values.items():
        sections[leaf.key[0]].setdefault(leaf.key[1:], {})[leaf.index] = value
    return sections


def _changed(setup: Setup, sections: Mapping[str, Changes]) -> Setup:
    new: dict[str, Any] = {}
    if "friction" in sections:
        new["friction"] = _friction(setup.friction, sections["friction"])
    if "drives" in sections:
        new["drives"] = _replaced("drives", setup.drives, sections["drives"])
    if "controller" in sections:
        new["controller"] = _replaced("controller", setup.controller, sections["controller"])
    links = dict(sections.get("arm", {}))
    seed = links.pop(("seed",), None)
    if seed is not None:
        new["seed"] = _seed(seed[()])
    if links:
        new["robot"] = _robot(setup.robot, links)
    return replace(setup, **new) if new else setup


def _fields(holder: object, changes: Changes) -> dict[str, Any]:
    """Return the changed fields of a dataclass; those that hold several numbers keep their other ones."""
    fields: dict[str, Any] = {}
    for (name,), entries in changes.items():
        old = getattr(holder, name)
        if () in entries:
            fields[name] = entries[()]
            continue
        numbers = np.array(old, dtype=np.float64)
        for index, value in entries.items():
            numbers[index] = value
        fields[name] = tuple(numbers.tolist()) if isinstance(old, tuple) else numbers
    return fields


def _replaced(where: str, holder: Any, changes: Changes) -> Any:
    """Return a dataclass with changed values of its own, and of the dataclasses in it, such as parts of an element."""
    own: Changes = {key: entries for key, entries in changes.items() if len(key) == 1}
    blocks = _by_first_name({key: entries for key, entries in changes.items() if len(key) > 1})
    new = {name: _replaced(where, getattr(holder, name), block) for name, block in blocks.items()}
    try:
        return replace(holder, **_fields(holder, own), **new)
    except ConfigError as error:
        named = str(error).startswith(f"{where}: ")
        raise error if named else ConfigError(f"{where}: {error}") from error


def _by_first_name(changes: Changes) -> dict[str, Changes]:
    groups: dict[str, Changes] = defaultdict(dict)
    for (name, *field), entries in changes.items():
        groups[name][tuple(field)] = entries
    return groups


def _friction(friction: FrictionSet, changes: Changes) -> FrictionSet:
    by_element = _by_first_name(changes)
    elements = tuple(
        _replaced(f"friction.{name}", element, by_element[name]) if name in by_element else element
        for name, element in zip(friction.names, friction.elements, strict=True)
    )
    return replace(friction, elements=elements)


def _seed(value: Value) -> int:
    if isinstance(value, float) and not value.is_integer():  # NaN and infinity are none
        raise ConfigError(f"arm.seed is {value}; accepted: a whole number from 0 to {LARGEST_SEED}")
    return int(value)


def _robot(robot: RobotModel, changes: Changes) -> RobotModel:
    chain = robot.chain
    bodies = {"mass": chain.mass.copy(), "com": chain.com.copy(), "inertia": chain.inertia.copy()}
    links = set()
    for (link, field), entries in changes.items():
        row = int(link.removeprefix("link_")) - 1
        links.add(row)
        for index, value in entries.items():
            bodies[field][(row, *index)] = value
    for row in sorted(links):
        _check_body(row, bodies["mass"][row], bodies["com"][row], bodies["inertia"][row])
    chain = chain._replace(**bodies)
    return replace(robot, chain=chain, model=_model(robot.model, links, bodies))


def _check_body(row: int, mass: float, com: NDArray[np.float64], inertia: NDArray[np.float64]) -> None:
    where = f"arm.link_{row + 1}"
    if not (np.isfinite(mass) and mass > 0):
        raise ConfigError(f"{where}.mass is {mass:g} kg; accepted: a finite number > 0")
    if not (np.isfinite(com).all() and np.isfinite(inertia).all()):
        raise ConfigError(f"{where}: com {com.tolist()}, inertia {inertia.tolist()}; accepted: finite numbers")
    fault = inertia_fault(tuple(inertia.tolist()))
    if fault is not None:
        raise ConfigError(f"{where}.inertia is {inertia.tolist()} kg m^2; accepted: {fault}")


def _model(model: Any, links: set[int], bodies: Mapping[str, NDArray[np.float64]]) -> Any:
    """Return a copy of Pinocchio's model with the bodies of the chain, whose axes are the base's at q = 0."""
    model = model.copy()
    data = model.createData()
    pin.forwardKinematics(model, data, np.zeros(model.nq))
    for row in sorted(links):
        turn = data.oMi[row + 1].rotation
        xx, yy, zz, xy, xz, yz = bodies["inertia"][row]
        tensor = turn.T @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn
        model.inertias[row + 1] = pin.Inertia(bodies["mass"][row], turn.T @ bodies["com"][row], tensor)
    return model
