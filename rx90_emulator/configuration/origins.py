"""What a setup comes to: every value with where it comes from, and whether that is assumed."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rx90_common.base.config import load_yaml, yaml_lines
from rx90_common.base.entries import LEFT_OUT, Entry
from rx90_common.base.groups import Either, Entries, Group, Variants
from rx90_common.base.section import ABOUT
from rx90_common.base.share import config_path, resolve_config
from rx90_common.description.robot_files import FILES, NO_TOOL, RobotFiles
from rx90_common.friction.element import SIGNS
from rx90_controller.law.model import ROLES, ModelFiles
from rx90_emulator.configuration.check import kind_named
from rx90_emulator.loop.setup import Setup

OF_CODE = "default of the code"
COMMAND_LINE = "command line"
ASSUMED = "assumed"
_OTHERS = "others"


class ShownValue(NamedTuple):
    """A value of a setup.

    Attributes:
        name: role of the file and path of the key in it, or node and parameter.
        value: plain data.
        unit: of it; empty where it has none.
        origin: the file with the line, the command line, or the code's default.
        provenance: published, derived, assumed or identified; empty where nothing says so.
        source: the sentence that names the source.
    """

    name: str
    value: Any
    unit: str
    origin: str
    provenance: str = ""
    source: str = ""


class _About(NamedTuple):
    """The mappings around a value, from the file on, each with the key that leads on from it."""

    around: tuple[tuple[Mapping[str, Any], str], ...] = ()

    def within(self, content: Mapping[str, Any], key: str) -> _About:
        """Return what is around the value under `key` of the innermost mapping."""
        return _About((*self.around, (content, key)))

    def said(self, word: str) -> str:
        """Return what the innermost mapping that says it has under `word`, for all its values or for this one.

        Where it says something for each key, that may be any key from there to the value, the last one first.
        """
        keys: list[str] = []
        for content, key in reversed(self.around):
            keys.append(key)
            given = content.get(word)
            if isinstance(given, dict):
                given = next((given[each] for each in (*keys, _OTHERS) if each in given), None)
            if given is not None:
                return str(given)
        return ""


def place_of(path: Path) -> str:
    """Return what names a file in short: its path below config/ or below the working folder, or the path itself."""
    for folder in (config_path(""), Path.cwd()):
        if path.is_absolute() and path.is_relative_to(folder):
            return path.relative_to(folder).as_posix()
    return str(path)


def file_values(role: str, path: Path) -> list[ShownValue]:
    """Return the values of a robot's file, checked.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    kind = kind_named(role)
    kind.read(path)
    root, lines = load_yaml(path), yaml_lines(path)
    if not isinstance(kind.entry, Group):
        return []
    found = []
    name = place_of(path)
    for place, entry, value, about in _leaves(kind.entry, root.content, "", _About()):
        line = lines.get(place)
        origin = OF_CODE if line is None else f"{name}:{line}"
        said = about if line is not None else _About()
        one = ShownValue(f"{role}.{place}", value, entry.unit, origin, said.said("provenance"), said.said("source"))
        found.append(_by_itself(one, root.content))
    return found


def _by_itself(one: ShownValue, content: Mapping[str, Any]) -> ShownValue:
    """Return a value with what the block `identification` of a friction file says of it, if it says anything."""
    _, blocks, *names = one.name.split(".")
    known = content.get("identification", {}).get("parameters", {}) if blocks == "elements" else {}
    if not names or names[0] not in known:
        return one
    parameter, *sign = names[1:]
    entries = [known[names[0]].get(name) for name in (parameter, *(f"{parameter}_{each}" for each in sign or SIGNS))]
    said = [entry for entry in entries if entry is not None]
    if not said:
        return one
    first = next((entry for entry in said if entry["provenance"] == ASSUMED), said[0])
    taken = first.get("taken_from")
    reasons = [first.get("reason"), None if taken is None else f"taken from {taken}"]
    source = "; ".join(reason for reason in reasons if reason)
    return one._replace(provenance=first["provenance"], source=source or one.source)


def _leaves(entry: Entry, content: Any, path: str, about: _About) -> Iterator[tuple[str, Entry, Any, _About]]:
    """Yield the values of a mapping that are no mappings, and the defaults of those that are left out."""
    if isinstance(entry, Variants):
        yield f"{path}.{entry.key}", entry, content[entry.key], about
        entry = entry.groups[content[entry.key]]
    keys = entry.keys if isinstance(entry, Group) else {}
    names = [name for name in content if name not in ABOUT]
    for key in dict.fromkeys((*names, *keys)):
        inner = entry.of if isinstance(entry, Entries) else keys.get(key)
        if inner is None:
            continue  # for readers alone
        place = f"{path}{'.' * bool(path)}{key}"
        said = about.within(content, key)
        if key not in content:
            if inner.default is not LEFT_OUT:
                yield place, inner, inner.default, said
        elif isinstance(content[key], dict):
            mapping = inner.mapping if isinstance(inner, Either) else inner
            yield from _leaves(mapping, content[key], place, said)
        else:
            yield place, inner, content[key], said


def setup_values(files: RobotFiles, chosen: Mapping[str, str]) -> list[ShownValue]:
    """Return the files of a robot and the values in them.

    Args:
        files: of the robot.
        chosen: where the choice of a file comes from, by its role.

    Raises:
        ConfigError: for a file that cannot be used.
    """
    found = [ShownValue(f"file.{role}", files.text(role), "", chosen[role]) for role in FILES if role in chosen]
    for role in FILES:
        path: Path | None = getattr(files, role)
        if role != "urdf" and path is not None:
            found += file_values(role, path)
    return found + _model_files(files, {one.name for one in found})


def steps_value(setup: Setup, substeps: int | None = None) -> ShownValue:
    """Return the steps that the plant of a setup takes in a tick.

    Raises:
        ConfigError: if those asked for are too few, or it needs more than it takes unasked.
    """
    return ShownValue("plant steps in a tick", setup.plant(substeps).substeps, "1", "by friction, mass and gears")


def _model_files(files: RobotFiles, named: Collection[str]) -> list[ShownValue]:
    """Return the files of the controller's own model that its file does not name, if it has one that is there."""
    root = load_yaml(files.controller)
    model = ModelFiles.of(root)
    origin = f"beside {place_of(files.controller)}"
    found = []
    for role in ROLES:
        path: Path | None = getattr(model, role)
        if f"controller.model.{role}" not in named and (path is None or path.is_file()):
            found.append(
                ShownValue(f"controller.model.{role}", NO_TOOL if path is None else place_of(path), "", origin)
            )
    return found


def rig_values(rig: str, chosen: str) -> list[ShownValue]:
    """Return the file of a friction rig and the values in it.

    Args:
        rig: path of the file, or the name of a shipped one.
        chosen: where the choice of it comes from.

    Raises:
        ConfigError: for a file that cannot be used.
    """
    return [ShownValue("file.rig", rig, "", chosen), *file_values("rig", resolve_config(rig))]
