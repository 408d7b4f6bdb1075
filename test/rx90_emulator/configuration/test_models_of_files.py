"""Every model of a file refuses in one line what a validator of its JSON schema excludes; good files fit."""

import copy
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from config_samples import shipped, written
from full_drives import DRIVE_BLOCKS
from full_friction import write_with_parts
from jsonschema import Draft202012Validator
from schema_faults import schema_faults

from rx90_common.base.config import read_yaml
from rx90_common.base.models import FileModel, model_text, schema_at
from rx90_common.base.quoting import quoted
from rx90_common.base.share import config_path
from rx90_common.description.robot_files import RobotFiles
from rx90_emulator.configuration.check import KINDS, FileKind, kind_named
from tools import schemas

WRONG = (None, "text", True, 7, -3.5, 0, -1e30, math.nan, math.inf, [], [1.0], [["text"]], {}, {"odd": 1})
ENDLESS = {"stiffness", "omega_d", "thermal_resistance", "heat_capacity", "derating", "limit"}
"""Keys whose values may be .inf."""
Place = tuple[Any, ...]
BLOCKS: dict[str, dict[str, Any]] = {
    "drives": DRIVE_BLOCKS,
    "controller": {"model": {"urdf": "a", "drives": "b", "friction": "c", "tool": "none"}},
}
"""What the shipped files leave out."""


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory, shipped_files: RobotFiles) -> list[tuple[str, Path]]:
    folder = tmp_path_factory.mktemp("samples")
    parts = write_with_parts(shipped_files.friction, folder / "parts.yaml")
    return [*shipped(), *written(folder), ("friction", parts)]


def places(content: Any, place: Place = ()) -> Iterator[Place]:
    if isinstance(content, dict):
        keys: list[Any] = list(content)
    else:
        keys = sorted({0, len(content) - 1}) if isinstance(content, list) and content else []
    for key in keys:
        if key not in FileModel.about_keys:
            yield (*place, key)
            yield from places(content[key], (*place, key))


def holder(content: Any, place: Place) -> Any:
    for key in place[:-1]:
        content = content[key]
    return content


def beyond(node: dict[str, Any]) -> list[Any]:
    values: list[Any] = ["no such word"]
    for key, direction in (("minimum", -math.inf), ("maximum", math.inf)):
        if key in node:
            exact = node.get("type") == "integer"
            values.append(node[key] + int(math.copysign(1, direction)) if exact else np.nextafter(node[key], direction))
    values += [node[key] for key in ("exclusiveMinimum", "exclusiveMaximum") if key in node]
    return [value.item() if isinstance(value, np.generic) else value for value in values]


def changes(schema: dict[str, Any], content: Any, tried: set[str]) -> Iterator[tuple[Any, str, Any]]:
    """Yield a content that the schema excludes, what the line must name, and the wrong value, if there is one."""
    is_valid = Draft202012Validator(schema).is_valid
    for place in ((), *places(content)):
        node = schema_at(schema, place, content)
        mark = json.dumps([node, place[-1:] if "properties" not in node else ""], sort_keys=True)
        if mark in tried:
            continue
        tried.add(mark)
        name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in place).removeprefix(".")
        if place:
            for value in (*WRONG, *beyond(node)):
                wrong = copy.deepcopy(content)
                holder(wrong, place)[place[-1]] = value
                # Of these schemas say nothing.
                infinite = isinstance(value, float) and not math.isfinite(value)
                endless = value == math.inf and not ENDLESS.isdisjoint(place)
                if not is_valid(wrong) or (infinite and not endless and node.get("type") == "number"):
                    yield wrong, name, value
        for key in node.get("required", ()):
            wrong = copy.deepcopy(content)
            del holder(wrong, (*place, key))[key]
            yield wrong, f"{name}.{key} is missing; accepted: ".removeprefix("."), None
        if node.get("additionalProperties") is False:
            wrong = copy.deepcopy(content)
            holder(wrong, (*place, ""))["no_such_key"] = 1.0
            yield wrong, f"{name}.no_such_key is not a known key; accepted: ".removeprefix("."), None


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_what_the_schema_excludes_is_refused_in_a_line_that_names_the_place(
    kind: FileKind, samples: list[tuple[str, Path]]
) -> None:
    """Below, above, not finite, of another type, missing and unknown: each is one line with place and value."""
    schema = kind.json_schema()
    optional = BLOCKS.get(kind.name, {})
    refused = 0
    seen: set[str] = set()
    tried: set[str] = set()
    files = [read_yaml(path, first=True) for name, path in samples if name == kind.name]
    wider = [
        {**content, **json.loads(json.dumps({name: block}))} for content in files for name, block in optional.items()
    ]
    fitting = [content for content in wider if not kind.faults(Path("f.yaml"), content)]  # blocks are for six joints
    assert len(fitting) >= len(optional)
    for content in [*files, *fitting]:
        for wrong, said, value in changes(schema, content, tried):
            lines = [str(fault) for fault in kind.faults(Path("f.yaml"), wrong)]
            assert lines, (said, value)
            line = lines[0]
            assert line.startswith(f"f.yaml: {said}"), (said, value, line)
            assert "accepted: " in line, line
            assert all(len(text.splitlines()) == 1 for text in lines)
            if isinstance(value, str | float | bool) and f"f.yaml: {said} is " in line:
                assert quoted(value) in line, (said, value, line)
            refused += 1
            seen.add(said)
    assert refused > len(seen) > 2


def test_the_shipped_schemas_are_those_of_the_readers() -> None:
    """The files in config/schemas/ are what `python -m tools.schemas` writes, and are schemas of draft 2020-12."""
    shipped_texts = {path.name: path.read_text(encoding="utf-8") for path in config_path("schemas").iterdir()}
    assert shipped_texts == schemas.texts()
    for kind in KINDS:
        Draft202012Validator.check_schema(kind.json_schema())


def test_good_files_fit_their_schemas_and_are_written_as_they_were_read(
    samples: list[tuple[str, Path]], tmp_path: Path
) -> None:
    """Files of every kind, the shipped ones too, are read; what is written from their values gives them again."""
    assert {kind for kind, _ in samples} == {kind.name for kind in KINDS}
    again = tmp_path / "again.yaml"
    for name, path in samples:
        kind = kind_named(name)
        kind.read(path)
        assert schema_faults(name, path) == [], path
        values = kind.model.model_validate(read_yaml(path, first=True))
        again.write_text(model_text(values), encoding="utf-8")
        assert kind.model.model_validate(read_yaml(again)) == values
