"""The JSON schemas say what the readers accept, and each value refuses what its declaration excludes."""

from __future__ import annotations

import copy
import dataclasses
import math
import random
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from config_samples import EVERY_KIND, OWN, shipped, written
from jsonschema import Draft202012Validator
from schema_faults import schema_faults, validator

from rx90_common.base.config import ABOUT, Section, read_yaml, yaml_text
from rx90_common.base.declared import Declared, declarations
from rx90_common.base.entries import (
    MAX_JOINTS,
    REQUIRED,
    Entry,
    Integer,
    ListOf,
    NotAccepted,
    Number,
    Numbers,
    Other,
    Rows,
    Switch,
    Text,
    Texts,
)
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.groups import Either, Entries, Group, Variants
from rx90_common.base.quoting import quoted
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles
from rx90_common.exchange.parameters import leaves
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_emulator.configuration.check import kind_named
from rx90_emulator.configuration.kinds import KINDS, FileKind
from rx90_emulator.configuration.nodes import NODES, node_values
from rx90_emulator.identification.experiments.plan import INDEX
from rx90_emulator.loop.setup import Setup
from tools import schemas

ROOT = Path(__file__).resolve().parents[3]
WRONG = (None, "text", True, 7, -3.5, 0, -1e30, 0.5, [], [1.0], {}, {"odd": 1})
MUTATIONS = 25  # of each kind
TOGETHER = re.compile(
    r"positive definite inertia|principal moments|from < to|counts_per_turn is missing|2 numbers, each|ends? at|"
    r"takes .* s at|one for each name|length is|>= tau_c|bounds are|of the normal|stands twice|count of values|"
    r"geomspace|is not there|segment \d+ \(|zone is|the path"
)
"""What is refused because of several values together, or of one in a list of unlike ones: no schema says that."""


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Path]]:
    """A good file, or several, of every kind."""
    return shipped() + written(tmp_path_factory.mktemp("samples"))


def test_the_shipped_schemas_are_those_of_the_readers() -> None:
    """The files in config/schemas/ are what `python -m tools.schemas` writes, and are schemas of draft 2020-12."""
    shipped_texts = {path.name: path.read_text(encoding="utf-8") for path in config_path("schemas").iterdir()}
    assert shipped_texts == schemas.texts()
    for kind in EVERY_KIND:
        Draft202012Validator.check_schema(kind.json_schema())


def test_good_files_fit_their_schemas(samples: list[tuple[str, Path]]) -> None:
    """Shipped files and those of every other kind are read, and fit their schemas."""
    assert {kind for kind, _ in samples} == {kind.name for kind in EVERY_KIND}
    for kind, path in samples:
        kind_named(kind).read(path)
        assert schema_faults(kind, path) == [], path


def places(data: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all values."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def changed(data: Any, random_: random.Random) -> tuple[str, Any]:
    """Return data with one value changed, taken away or added, and what was done."""
    data = copy.deepcopy(data)
    path = random_.choice(list(places(data)))
    parent = data
    for key in path[:-1]:
        parent = parent[key]
    how = random_.randrange(8)
    if how == 0 and isinstance(parent, dict):
        del parent[path[-1]]
        return f"{path} taken away", data
    if how == 1 and isinstance(parent, dict):
        parent["unknown_key"] = 1.0
        return f"{path}: unknown key", data
    parent[path[-1]] = value = random_.choice(WRONG)
    return f"{path} = {value!r}", data


def refused(kind: str, path: Path, data: Any) -> str:
    """Return why a file with this data is refused by its reader; empty if it is not."""
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    try:
        kind_named(kind).read(path)
    except Rx90Error as error:
        return str(error)
    return ""


@pytest.mark.parametrize("kind", [kind.name for kind in EVERY_KIND])
def test_schema_and_reader_refuse_the_same(kind: str, samples: list[tuple[str, Path]], tmp_path: Path) -> None:
    """Of random changes the schema refuses none that the reader takes, and 95 % of those that break a value's own rule.

    Not among these: a whole number written as 1.0 where an integer is asked for, which JSON does not tell from 1.
    """
    random_ = random.Random(f"{kind} 1")
    check = validator(kind)
    of_kind = [path for name, path in samples if name == kind]
    if kind in OWN:
        shutil.copytree(of_kind[0].parent, tmp_path, dirs_exist_ok=True)
    both, alone = 0, []
    for _ in range(MUTATIONS):
        file = random_.choice(of_kind)
        what, data = changed(read_yaml(file), random_)
        by_reader = refused(kind, tmp_path / file.name, data)
        by_schema = not check.is_valid(data)
        assert by_reader or not by_schema, f"{file.name}: {what}"
        both += bool(by_reader and by_schema)
        if by_reader and not by_schema and not TOGETHER.search(by_reader):
            alone.append(f"{what}: {by_reader}")
    assert both > MUTATIONS / 4
    assert len(alone) <= 0.05 * (both + len(alone)), "\n".join(alone)


@pytest.mark.parametrize("node", NODES)
def test_declared_parameters_are_those_of_running_nodes(node: str) -> None:
    """Name, default and range of each parameter are those in the page that is written from nodes that run."""
    text = (ROOT / "docs/reference/parameters.md").read_text(encoding="utf-8")
    table = re.search(rf"<!-- parameters of {node} -->\n(.*?)<!-- end -->", text, re.DOTALL)
    assert table is not None
    rows = re.findall(r"^\| `([^`]+)` \| `([^`]*)` \| ([^|]*) \|", table[1], re.MULTILINE)
    joints = [f"joint_{k}" for k in range(1, 7)]
    every = [(name.replace("<joint>", joint), *rest) for name, *rest in rows for joint in joints]
    parameters = {name: (value, field) for name, value, field in leaves(node_values(node, {}))}
    # What the robot says, and nobody chooses, is compared with it instead: see the next test.
    arms = ("joints", "command_interfaces", "state_interfaces")
    every = [row for row in every if row[0] not in arms]
    assert {name for name, *_ in every} == parameters.keys() - {*arms}
    for name, default, accepted in every:
        value, field = parameters[name]
        assert value == tuple(found) if isinstance(found := yaml.safe_load(default), list) else value == found, name
        ends = re.fullmatch(r"([\d.,e-]+) to ([\d.,e+]+)", accepted.strip())
        if ends is not None:
            bounds = [rule.ge if hasattr(rule, "ge") else rule.le for rule in field.metadata]
            assert bounds == [float(end.replace(",", "")) for end in ends.groups()]


def test_what_joint_trajectory_controller_alone_has_is_taken_out() -> None:
    """Its parameters without a counterpart are no parameters of the node, nor unknown."""
    joints = [f"joint_{k}" for k in (6, 1, 2, 3, 4, 5)]
    given = {"joints": joints, "gains.joint_1.p": 1.0, "cmd_timeout": 0.0}
    assert node_values("rx90_controller", given) == node_values("rx90_controller", {})
    for name in ("gain", "interpolation_methods", "joint"):
        with pytest.raises(ConfigError, match=f"parameter {name} is not a known key"):
            node_values("rx90_controller", {name: 1.0})


WRONG_KINDS = ("text", None, True, [], [1.0], {})


def bad_numbers(entry: Number) -> list[Any]:
    """Return what is not a number, and numbers just beyond the ends of a range."""
    bad: list[Any] = [*WRONG_KINDS, math.nan, -math.inf, *([] if entry.infinite else [math.inf])]
    bad += [entry.low if entry.above else np.nextafter(entry.low, -math.inf).item()] if entry.low > -math.inf else []
    bad += [np.nextafter(entry.high, math.inf).item()] if entry.high < math.inf else []
    return bad + [0.0] * entry.nonzero


def accepts(entry: Entry, value: Any) -> bool:
    """Return whether a declaration accepts a value."""
    try:
        entry.check(value)
    except NotAccepted:
        return False
    return True


def bad_values(entry: Entry) -> list[Any]:
    """Return values that a declaration excludes by its own words."""
    match entry:
        case Numbers():
            ends = (1.0, 0.5, 0.1, entry.low, entry.high)
            count = entry.count or MAX_JOINTS
            good = [next(x for x in ends if accepts(entry, (float(x),) * count))] * (count - 1)
            lengths = [good if entry.count else [], [*good, good[0], good[0]]]
            bad = [*WRONG_KINDS[:3], {}, *lengths, *([*good, one] for one in bad_numbers(entry))]
        case Number():
            bad = bad_numbers(entry)
        case Integer():
            bad = [*WRONG_KINDS, 1.5, entry.low - 1, entry.high + 1]
        case Switch():
            bad = [1, 0.0, "maybe", None, []]
        case Text():
            bad = [3, None, [], {}, *(["no such word"] * bool(entry.choices))]
        case Texts():
            bad = ["text", None, [1], {}, *([[], ["a", "a"]] if entry.once else [])]
        case Rows():
            count = entry.count or MAX_JOINTS
            bad = [3.0, [], [[1.0] * (count + 1)], [["text"] * count]]
        case Other():
            bad = [value for value in (*WRONG_KINDS, math.nan, -1.0) if not entry.good(value)]
        case _:
            bad = ["text", None, 3.0, *([[]] if isinstance(entry, ListOf) and entry.least else [])]
    return bad


def faults(entry: Entry, data: Any, place: tuple[Any, ...]) -> Iterator[tuple[tuple[Any, ...], Any, str]]:
    """Yield place, wrong value (or REQUIRED for a key that is taken away) and what the refusal names."""
    either = isinstance(entry, Either)
    if isinstance(entry, Either):
        entry = entry.mapping if isinstance(data, dict) else entry.plain
    if place and not isinstance(entry, Group | Entries | Variants):
        wrong = (bad for bad in bad_values(entry) if not (either and bad == {}))  # which lacks keys
        yield from ((place, bad, str(place[-1])) for bad in wrong)
    if isinstance(entry, Group | Variants):
        group = entry if isinstance(entry, Group) else entry.groups[data[entry.key]]
        for key, inner in group.keys.items():
            if key in data:
                yield from faults(inner, data[key], (*place, key))
                if inner.default is REQUIRED:
                    yield (*place, key), REQUIRED, f"{key} is missing"
        if group.known:
            yield (*place, "no_such_key"), 1.0, "no_such_key is not a known key"
        yield from ((place, bad, str(place[-1])) for bad in ("text", None, *([] if either else [[1]])) if place)
    elif isinstance(entry, Entries):
        for name in list(data)[:1]:
            if name not in {"source", "provenance", "note"}:
                yield from faults(entry.of, data[name], (*place, name))
    elif isinstance(entry, ListOf) and data:
        yield from faults(entry.item, data[0], (*place, 0))


@pytest.fixture(scope="module")
def contents(samples: list[tuple[str, Path]]) -> dict[str, list[Any]]:
    """The content of good files of every kind, with the blocks that the shipped ones leave out."""
    found: dict[str, list[Any]] = {kind.name: [] for kind in KINDS}
    for kind, path in samples:
        if kind in found:
            data = read_yaml(path, first=True)
            found[kind].append(data)
    return found


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.model is None], ids=lambda kind: kind.name)
def test_each_value_of_a_file_is_refused_beyond_its_declaration(kind: Any, contents: dict[str, list[Any]]) -> None:
    """A value of another kind or beyond its range, a missing and an unknown key are refused by file, key and value."""
    seen: set[tuple[Any, ...]] = set()
    for data in contents[kind.name]:
        for place, bad, said in faults(kind.entry, data, ()):
            if (place, repr(bad)) in seen:
                continue
            seen.add((place, repr(bad)))
            wrong = copy.deepcopy(data)
            holder = wrong
            for key in place[:-1]:
                holder = holder[key]
            if bad is REQUIRED:
                del holder[place[-1]]
            else:
                holder[place[-1]] = bad
            with pytest.raises(ConfigError) as caught:
                kind.entry.read(Section(wrong, Path("file.yaml")))
            line = str(caught.value)
            assert line.startswith("file.yaml: "), (place, bad)
            assert "accepted: " in line, (place, bad)
            assert said in line, (place, bad)
            if bad is not REQUIRED and "no_such" not in said:
                shown = bad
                while isinstance(shown, list) and shown:
                    shown = shown[-1]
                assert quoted(shown) in line or quoted(bad) in line, (place, bad, line)
    assert seen


def keys_of(entry: Entry, data: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the places of all keys of a file whose names the project gives, and which do not stand twice in a name."""
    if isinstance(entry, Either):
        entry = entry.mapping if isinstance(data, dict) else entry.plain
    if isinstance(entry, Group | Variants):
        group = entry if isinstance(entry, Group) else entry.groups[data[entry.key]]
        for key in data:
            if key in group.keys:
                yield from keys_of(group.keys[key], data[key], (*place, key))
            if group.known or (key in group.keys and group.keys[key].default is REQUIRED):
                yield (*place, key)
    elif isinstance(entry, Entries):
        for name in data.keys() - {*ABOUT}:
            yield from keys_of(entry.of, data[name], (*place, name))
    elif isinstance(entry, ListOf):
        for index, item in enumerate(data):
            yield from keys_of(entry.item, item, (*place, index))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.model is None], ids=lambda kind: kind.name)
def test_a_misspelt_key_is_the_first_thing_named(
    kind: FileKind, contents: dict[str, list[Any]], tmp_path: Path
) -> None:
    """Whatever key lacks a letter, the reader of all commands names it first, with the key that is meant."""
    misspelt = 0
    for data in contents[kind.name]:
        for *around, key in list(keys_of(kind.entry, data))[:200]:
            if len(key) > 4 and key not in ABOUT:
                wrong = copy.deepcopy(data)
                holder = wrong
                for name in around:
                    holder = holder[name]
                odd = key[:3] + key[4:]
                holder[odd] = holder.pop(key)
                path = tmp_path / INDEX
                path.write_text(yaml_text(wrong), encoding="utf-8")
                with pytest.raises(Rx90Error) as caught:
                    kind.read(path)
                assert f"{odd} is not a known key (did you mean {key}?); accepted: " in str(caught.value)
                misspelt += 1
    assert misspelt


OBJECTS = (
    LoadPart(0.1, 0.2), RipplePart((1.0,), (0.05,)), ScatterPart(0.01, 10.0), ElastoPlastic(0.5),
    MaxwellSlip((0.5, 0.5), (0.4, 0.6), 2.0),
    TemperaturePart(20.0, 0.0, 60.0, 20.0, 20.0, 1e4, 0.5, 30.0),
)  # fmt: skip


@pytest.mark.parametrize("index", range(len(OBJECTS) + 7))
def test_each_field_is_refused_in_python_as_in_a_file(index: int, shipped: Setup) -> None:
    """A declared dataclass refuses what its declarations exclude, by its own name and that of the field."""
    own = shipped.friction.elements
    good: Declared = (*OBJECTS, *own)[index]
    for name, one in declarations(type(good)).items():
        if one.in_python is None or one.by_owner or isinstance(one.in_python, Other | ListOf | Rows):
            continue
        array = isinstance(getattr(good, name), np.ndarray)
        for bad in bad_values(one.in_python):
            shown = np.array(bad) if array and isinstance(bad, list) and all(type(x) is float for x in bad) else bad
            if array and not isinstance(shown, np.ndarray):
                continue
            with pytest.raises(ConfigError, match=rf"{name}(\[\d\])? is .*; accepted: "):
                dataclasses.replace(good, **{name: shown})


def test_the_shipped_values_say_that_they_are_assumed(shipped_files: RobotFiles) -> None:
    """Each block of the RX90B's controller and drives carries its provenance; the controller's are assumed."""
    said = {
        role: [block["provenance"] for block in read_yaml(getattr(shipped_files, role)).values()]
        for role in ("controller", "drives")
    }
    assert set(said["controller"]) == {"assumed"}
    assert None not in said["drives"]
