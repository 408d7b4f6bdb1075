"""Parameters declared once, as fields of a dataclass: file keys, schema, checks, units and paths follow from that.

    @dataclass(frozen=True)
    class Encoder(Declared):
        '''Encoder of a motor.'''

        counts: Annotated[float, Integer("Counts per revolution.", low=16, high=2**30), "encoder.counts_per_revolution"]
        bandwidth: Annotated[float, Number("Bandwidth of the observer.", "Hz", low=0.0, above=True)] = 100.0

An entry describes the accepted values in a file, and a second one those in Python, if more are accepted there; a file
is also checked for wrong units. The text after them is the key in a file if it is not the field's own name,
with the blocks that contain it. The field's default is the file's, too, unless the entry has one of its own or
is followed by REQUIRED: then the default means that the whole block is left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import MISSING, Field, dataclass, fields, replace
from typing import Annotated, Any, ClassVar, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from rx90_common.base.entries import LEFT_OUT, PER_JOINT, REQUIRED, Entry, Integer, NotAccepted, Number, Numbers
from rx90_common.base.errors import ConfigError
from rx90_common.base.groups import Group, Variants
from rx90_common.base.quoting import quoted

_Self = TypeVar("_Self", bound="Declared")


@dataclass(frozen=True)
class Declaration:
    """The declaration of one field.

    Attributes:
        name: of the field.
        keys: its keys in a file, from the outermost block on.
        entry: accepted values in a file; None if the field has a type that declares its own.
        in_python: accepted values in Python.
        kind: the field's type.
        field: of the dataclass.
    """

    name: str
    keys: tuple[str, ...]
    entry: Entry | None
    in_python: Entry | None
    kind: Any
    field: Field[Any]

    @property
    def default(self) -> Any:
        """Return the field's default, MISSING without one."""
        return self.field.default if self.field.default_factory is MISSING else self.field.default_factory()

    @property
    def by_owner(self) -> bool:
        """Return whether the entry is a group, which the owner reads and checks."""
        return isinstance(self.entry, Group | Variants)

    @property
    def per_joint(self) -> bool:
        """Return whether it has a value for each joint, or motor, of an arm."""
        return self.spread or (isinstance(self.entry, Numbers) and self.entry.count == PER_JOINT)

    @property
    def spread(self) -> bool:
        """Return whether a file has one value for all elements of an array."""
        return isinstance(self.entry, Number | Integer) and not isinstance(self.entry, Numbers) and self.kind is _ARRAY


_ARRAY = np.ndarray


@dataclass(frozen=True)
class Declared:
    """A dataclass whose fields declare their accepted values.

    Attributes:
        name: prefix of the names of fields in messages.
        about: description of the group in a file.
        blocks: the groups of keys with dots, by name, with their descriptions.
    """

    name: ClassVar[str] = ""
    about: ClassVar[str] = ""
    blocks: ClassVar[Mapping[str, str]] = {}

    def __post_init__(self) -> None:
        for one in declarations(type(self)).values():
            value = getattr(self, one.name)
            if one.in_python is None or one.by_owner or _same(value, one.default):
                continue
            try:
                checked = one.in_python.check(in_file(value))
            except NotAccepted as fault:
                place = f"{self.name}{': ' * bool(self.name)}{one.name}{fault.place}"
                raise ConfigError(f"{place} is {quoted(fault.value)}; accepted: {fault.accepted}") from None
            if one.kind is not _ARRAY:  # as a file gives it: no NumPy scalar, which writers do not know
                object.__setattr__(self, one.name, checked)

    def fitted(self: _Self, joints: int, first: str) -> _Self:
        """Return a copy in which every array by joint has a value for each of so many joints.

        A single value applies to all of them, as defaults do; `first` is the array that determines the number.
        """
        fitting = copy(self)
        for one in declarations(type(self)).values():
            value = getattr(self, one.name)
            if isinstance(value, Declared):
                object.__setattr__(fitting, one.name, value.fitted(joints, first))
            if not one.per_joint or np.shape(value) == (joints,):
                continue
            if np.shape(value) != (1,):
                place = f"{self.name}{': ' * bool(self.name)}{one.name}"
                accepted = f"{joints} numbers, as many as {first} has"
                raise ConfigError(f"{place} is {quoted(in_file(value))}; accepted: {accepted}")
            object.__setattr__(fitting, one.name, np.full(joints, value[0]))
        return fitting

    @classmethod
    def group(cls, default: Any = REQUIRED) -> Group:
        """Return the group of entries of a file, in the order of the fields."""
        return Group(cls.about, keys=_keys(cls), default=default)

    @classmethod
    def of_file(cls: type[_Self], content: Mapping[str, Any] | None, **fields: Any) -> _Self:
        """Return an instance for the values that `group()` has read from a file; all defaults for a missing block.

        Args:
            content: by the file's keys.
            fields: additional fields, by their names.
        """
        return cls(**fields) if content is None else cls(**_values(cls, content), **fields)

    @classmethod
    def units(cls) -> dict[str, str]:
        """Return the units of the fields, 1 for a pure number."""
        return {one.name: one.entry.unit or "1" for one in declarations(cls).values() if one.entry is not None}


_known: dict[type[Any], dict[str, Declaration]] = {}


def declarations(owner: type[Any]) -> dict[str, Declaration]:
    """Return the declarations of a dataclass' fields, by their names; fields without one are left out."""
    if owner not in _known:
        _known[owner] = _declared_by(owner)
    return _known[owner]


def _declared_by(owner: type[Any]) -> dict[str, Declaration]:
    hints = get_type_hints(owner, include_extras=True)
    found = {}
    for own_field in fields(owner):
        hint = hints[own_field.name]
        kind, *annotations = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        kind = get_origin(kind) or kind
        entries = [each for each in annotations if isinstance(each, Entry)]
        entry, in_python = (entries[0], entries[-1]) if entries else (None, None)
        own = isinstance(kind, type) and issubclass(kind, Declared)
        if entry is None and not own:
            continue
        keys = tuple(next((each for each in annotations if isinstance(each, str)), own_field.name).split("."))
        one = Declaration(own_field.name, keys, entry, in_python, kind, own_field)
        if (
            entry is not None
            and entry.default is REQUIRED
            and REQUIRED not in annotations
            and one.default is not MISSING
        ):
            one = replace(one, entry=replace(entry, default=_as_read(one.default)))
        found[own_field.name] = one
    return found


def _keys(owner: type[Declared]) -> dict[str, Entry]:
    """Return the entries of a file's keys, with the blocks that contain them."""
    keys: dict[str, Any] = {}
    for one in declarations(owner).values():
        *blocks, last = one.keys
        if one.entry is not None:
            inner = keys
            for block in blocks:
                inner = inner.setdefault(block, {})
            inner[last] = one.entry
        elif last in owner.blocks:  # its keys are among others of the block
            keys.setdefault(last, {}).update(_keys(one.kind))
        else:
            keys[last] = one.kind.group(LEFT_OUT if one.default is not MISSING else REQUIRED)
    return {
        key: Group(owner.blocks[key], keys=entry) if isinstance(entry, dict) else entry for key, entry in keys.items()
    }


def _values(owner: type[Declared], content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields for the values that `group()` has read."""
    values: dict[str, Any] = {}
    for one in declarations(owner).values():
        *blocks, last = one.keys
        inner = content
        for block in blocks:
            inner = inner[block]
        if one.entry is None:
            values[one.name] = one.kind.of_file(inner.get(last))
        elif last in inner and not one.by_owner:
            value = (inner[last],) if one.spread else inner[last]
            values[one.name] = np.array(value, dtype=np.float64) if one.kind is _ARRAY else value
    return values


def in_file(value: Any) -> Any:
    """Return a value as YAML has it."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [float(each) for each in value] if isinstance(value, tuple) else value


def _as_read(default: Any) -> Any:
    return tuple(default.tolist()) if isinstance(default, np.ndarray) else default


def _same(value: Any, default: Any) -> bool:
    """Return whether a value is the default, which needs no check: it may mean a missing entry."""
    if default is MISSING:
        return False
    if isinstance(default, np.ndarray):
        return np.shape(value) == default.shape and bool(np.all(np.asarray(value) == default))
    return value is default or (type(value) is type(default) and bool(value == default))
