"""Every value of every kind of file, and of every declared dataclass, refuses what its declaration excludes."""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from config_samples import shipped, written

from rx90_common.base.config import load_yaml
from rx90_common.base.declared import Declared, declarations
from rx90_common.base.entries import (
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
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Either, Entries, Group, Variants
from rx90_common.base.quoting import quoted
from rx90_common.base.section import Section
from rx90_common.description.drives import Cogging, CurrentSensor, Elasticity, Windings
from rx90_common.description.robot_files import RobotFiles
from rx90_common.friction.parts.bristles import ElastoPlastic, MaxwellSlip
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart
from rx90_emulator.configuration.kinds import KINDS
from rx90_emulator.loop.setup import Setup

SIX = [0.1] * 6
BLOCKS: dict[str, dict[str, Any]] = {
    "drives": {
        "cogging": {"harmonic": [6.0], "amplitude": [SIX], "phase": [SIX]},
        "winding": {
            "resistance": SIX, "thermal_resistance": SIX, "heat_capacity": SIX, "ambient": 25.0, "initial": 25.0,
            "derating": 120.0, "limit": 140.0, "reference": 20.0, "coefficient": 0.004,
        },
        "current_sensor": {"offset": SIX, "noise": SIX, "resolution": SIX, "bandwidth": 800.0},
        "elasticity": {"stiffness": SIX, "damping": SIX, "backlash": SIX, "friction": "link"},
    },
    "controller": {"model": {"urdf": "a", "drives": "b", "friction": "c", "tool": "none"}},
}  # fmt: skip
"""What the shipped files leave out."""
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
            good = [next(x for x in ends if accepts(entry, (float(x),) * entry.count))] * (entry.count - 1)
            lengths = [good, [*good, good[0], good[0]]]
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
            bad = [3.0, [], [[1.0] * (entry.count + 1)], [["text"] * entry.count]]
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
def samples(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """The content of good files of every kind, with the blocks that the shipped ones leave out."""
    content: dict[str, list[Any]] = {kind.name: [] for kind in KINDS}
    for kind, path in shipped() + written(tmp_path_factory.mktemp("samples")):
        if kind in content:
            data = load_yaml(path, first=True).content
            content[kind].append(data)
            content[kind] += [{**data, name: block} for name, block in BLOCKS.get(kind, {}).items()]
    return content


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_each_value_of_a_file_is_refused_beyond_its_declaration(kind: Any, samples: dict[str, list[Any]]) -> None:
    """A value of another kind or beyond its range, a missing and an unknown key are refused by file, key and value."""
    seen: set[tuple[Any, ...]] = set()
    for data in samples[kind.name]:
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


ONE = np.full(6, 0.1)
OBJECTS = (
    LoadPart(0.1, 0.2), RipplePart((1.0,), (0.05,)), ScatterPart(0.01, 10.0), ElastoPlastic(0.5),
    MaxwellSlip((0.5, 0.5), (0.4, 0.6), 2.0), CurrentSensor(ONE, ONE, ONE, 800.0), Elasticity(ONE),
    Cogging(np.ones(1), np.ones((1, 6)), np.zeros((1, 6))),
    Windings(ONE, ONE, ONE, ambient=25.0, derating=120.0, limit=140.0),
    TemperaturePart(20.0, 0.0, 60.0, 20.0, 20.0, 1e4, 0.5, 30.0),
)  # fmt: skip


@pytest.mark.parametrize("index", range(len(OBJECTS) + 9))
def test_each_field_is_refused_in_python_as_in_a_file(index: int, shipped: Setup) -> None:
    """A declared dataclass refuses what its declarations exclude, by its own name and that of the field."""
    own = (shipped.drives, shipped.controller, *shipped.friction.elements)
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
        role: [block["provenance"] for block in load_yaml(getattr(shipped_files, role)).content.values()]
        for role in ("controller", "drives")
    }
    assert set(said["controller"]) == {"assumed"}
    assert None not in said["drives"]
