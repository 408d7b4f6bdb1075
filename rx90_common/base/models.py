"""Models of files and parameters, by pydantic: what each value may be, with its unit and its meaning, once.

    class Encoder(FileModel):
        '''Encoder of a motor.'''

        counts: Annotated[int, Field(ge=16, le=2**30, description="Counts per revolution.")]
        bandwidth: Annotated[float, quantity("Hz", "Bandwidth of the observer.", gt=0.0)] = 100.0

Reader, writer, JSON schema, legends, sweep paths and the nodes' parameters follow from the model. `read_model` reads a
file; `refusals` and `fault_lines` turn pydantic's ValidationError into lines for users: file, place, value and what is
accepted. What is accepted comes from the field's JSON schema, or from `accepted` in it where words say it better.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Generic, Literal, TypeAlias, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from rx90_common.base.arrays import MAX_JOINTS
from rx90_common.base.config import read_yaml, yaml_text
from rx90_common.base.errors import ConfigError, Rx90Error
from rx90_common.base.quoting import nearest, plain, question, quoted

JsonSchema: TypeAlias = dict[str, Any]
AnyModel = TypeVar("AnyModel", bound="Model")
Item = TypeVar("Item")
Place: TypeAlias = tuple[str | int, ...]
Provenance: TypeAlias = Literal["published", "derived", "assumed", "identified"]

_REFUSED = "refused"
_UNKNOWN_KEY = "extra_forbidden"
_UNKNOWN_KIND = "union_tag_invalid"
_NO_KIND = "union_tag_not_found"
_MISSING = {"missing", _NO_KIND}
_MAX_FAULTS = 20
"""That are told at most."""
_SIGNS = {"minimum": ">=", "exclusiveMinimum": ">", "maximum": "<=", "exclusiveMaximum": "<"}
_OF_ALL_KINDS: Final[tuple[str, ...]] = (
    "accepted",
    "description",
    "unit",
    "default",
    "discriminator",
)
"""What a schema says of all kinds of value that it accepts."""


class Model(BaseModel):
    """A set of values that cannot change; unknown names, numbers that are not finite and other types are refused."""

    model_config = ConfigDict(
        frozen=True, strict=True, extra="forbid", allow_inf_nan=False, ser_json_inf_nan="constants"
    )

    def __iter__(self) -> Generator[tuple[str, Any], None, None]:
        """Yield names and values of the fields, and not what has been computed of them."""
        fields = type(self).model_fields
        yield from ((name, value) for name, value in self.__dict__.items() if name in fields)
        yield from (self.__pydantic_extra__ or {}).items()

    def replaced(self: AnyModel, **changes: Any) -> AnyModel:
        """Return a copy with other values, checked like those of a file.

        Args:
            changes: by field; of a model in the model a mapping with the fields that change.

        Raises:
            ConfigError: naming the value and what is accepted.
        """
        content = _with_changes(self, changes)
        with refusals(type(self), content=content):
            return type(self).model_validate(content)


def _with_changes(model: Model, changes: Mapping[str, Any]) -> dict[str, Any]:
    values = dict(model)
    for name, value in changes.items():
        inner = values.get(name)
        if isinstance(inner, Model) and isinstance(value, dict):
            values[name] = _with_changes(inner, value)
        else:
            values[name] = value
    return values


class FileModel(Model):
    """A mapping of a file; it may say where its values come from."""

    about_keys: ClassVar[tuple[str, ...]] = ("provenance", "source", "note")

    provenance: Annotated[
        Provenance | dict[str, Provenance | None] | None,
        Field(
            description="Where the values come from: one word for the whole mapping, or one for each key.",
            json_schema_extra={"accepted": "one of published, derived, assumed, identified"},
        ),
    ] = None
    source: Annotated[
        Any, Field(description="A sentence that names the source, for the mapping or for each key.")
    ] = None
    note: Annotated[Any, Field(description="A remark for readers.")] = None


class Named(FileModel, Generic[Item]):
    """A mapping of a file from free names to values of one kind."""

    model_config = ConfigDict(extra="allow")

    __pydantic_extra__: dict[str, Item] = Field(init=False)

    @property
    def entries(self) -> dict[str, Item]:
        """Return the values by name."""
        return self.__pydantic_extra__

    def __getitem__(self, name: str) -> Item:
        """Return the value of this name."""
        return self.__pydantic_extra__[name]


class Some(Named[Item], Generic[Item]):
    """A mapping from free names to values of one kind, at least one."""

    model_config = ConfigDict(
        json_schema_extra={"minProperties": 1, "accepted": "a mapping with one entry or more"}
    )

    @model_validator(mode="after")
    def _check_some(self: AnyModel) -> AnyModel:
        if not self.__pydantic_extra__:
            raise not_accepted()
        return self


def _require_one(schema: JsonSchema, model: type[OneOf]) -> None:
    schema["oneOf"] = [{"required": [key]} for key in model.one_of]


class OneOf(FileModel):
    """A mapping that has exactly one of some keys."""

    model_config = ConfigDict(json_schema_extra=_require_one)

    one_of: ClassVar[tuple[str, ...]]

    @model_validator(mode="after")
    def _check_one_of(self) -> OneOf:
        given = [key for key in self.one_of if getattr(self, key) is not None]
        if len(given) != 1:
            raise ValueError(
                f"has {' and '.join(given) or 'none'} of {', '.join(self.one_of)}; accepted: one of them"
            )
        return self


def quantity(
    unit: str,
    description: str,
    *,
    gt: float | None = None,
    ge: float | None = None,
    le: float | None = None,
    accepted: str = "",
    path: str = "",
) -> Any:
    """Return the Field of a physical quantity.

    Args:
        unit: "1" for a pure number.
        description: its meaning, a sentence.
        gt: what it is above, if anything.
        ge: its least value.
        le: its largest value.
        accepted: the accepted values in words, where the bounds do not say it.
        path: its name in paths of sweeps, where that is not made of those of its mappings; it stands for the whole
            way from the file's top.
    """
    extra: dict[str, Any] = {"unit": unit}
    if accepted:
        extra["accepted"] = accepted
    if path:
        extra["path"] = path
    return Field(description=description, gt=gt, ge=ge, le=le, json_schema_extra=extra)


def not_accepted() -> PydanticCustomError:
    """Return what a validator of a field raises for a value that is not accepted; `accepted` says in words what is."""
    return PydanticCustomError("not_accepted", "not accepted")


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise not_accepted()
    return value


def _plain_list(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


Row: TypeAlias = Annotated[tuple[float, ...], Field(strict=False)]
"""Numbers, of a list in a file."""
NotZero: TypeAlias = Annotated[
    float,
    AfterValidator(_not_zero),
    Field(json_schema_extra={"not": {"const": 0}, "accepted": "a finite number other than 0"}),
]
Triple: TypeAlias = Annotated[tuple[float, ...], Field(strict=False, min_length=3, max_length=3)]
"""Three numbers, such as those of a place."""
PerJoint: TypeAlias = Annotated[
    tuple[float, ...], Field(strict=False, min_length=1, max_length=MAX_JOINTS)
]
"""A number for each joint."""
Names: TypeAlias = Annotated[tuple[str, ...], Field(strict=False)]
"""Texts, of a list in a file."""
Positive: TypeAlias = Annotated[float, Field(gt=0.0)]
NotNegative: TypeAlias = Annotated[float, Field(ge=0.0)]
RowOf: TypeAlias = Annotated[
    tuple[Item, ...],
    Field(strict=False, min_length=1, max_length=MAX_JOINTS),
    BeforeValidator(_plain_list),
]
"""Values of the joints, or the motors, of an arm: of a list in a file, or of an array in Python."""


@contextmanager
def as_refusal() -> Iterator[None]:
    """Let a validator of a model raise what pydantic collects, for an Rx90Error."""
    try:
        yield
    except Rx90Error as error:
        raise ValueError(str(error)) from None


def refusal(key: str, value: object, accepted: str) -> PydanticCustomError:
    """Return what a validator of a model raises for a value that does not fit the others; `key` is its field."""
    shown = list(value) if isinstance(value, tuple) else value
    context = {"key": key, "value": quoted(shown), "accepted": accepted}
    return PydanticCustomError(_REFUSED, "{key} is {value}; accepted: {accepted}", context)


def check_counts(blocks: Iterable[tuple[str, Any]], count: int, like: str) -> None:
    """Refuse a list of one value for each joint, in blocks by name, that is longer or shorter than the list `like`."""
    for name, block in blocks:
        for key, values in block if isinstance(block, FileModel) else ():
            if isinstance(values, tuple) and values and len(values) != count:
                raise refusal(f"{name}.{key}", values, f"{count} numbers, as many as {like} has")


def read_model(
    model: type[AnyModel],
    path: Path,
    accepted: str = "a mapping of keys to values",
    *,
    first: bool = False,
) -> AnyModel:
    """Read a YAML file.

    Args:
        model: of its content.
        path: of the file.
        accepted: expected content in words, for messages.
        first: whether to read the first of several documents; otherwise there must be one.

    Raises:
        ConfigError: naming file, key, value and what is accepted.
    """
    content = read_yaml(path, accepted, first=first)
    with refusals(model, plain(path), content):
        return model.model_validate(content)


def model_text(values: Model) -> str:
    """Return a model's values as YAML, without those that are defaults; `read_model` gives the same values back."""
    return yaml_text(values.model_dump(mode="json", exclude_defaults=True))


def json_schema(model: type[BaseModel], title: str) -> JsonSchema:
    """Return the JSON schema, draft 2020-12, of a file, for editors: their texts name the units.

    Args:
        model: of the file's content.
        title: of the schema.
    """
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema = _with_units(schema_of(model))
    of_files = schema_of(FileModel)["properties"]
    about = {key: of_files[key] for key in FileModel.about_keys}
    return {**head, **schema, "title": title, "$defs": {**schema.get("$defs", {}), **about}}


def _with_units(value: Any) -> Any:
    """Return a schema whose descriptions end with the unit, with what all mappings may have in one place."""
    if isinstance(value, list):
        return [_with_units(item) for item in value]
    if not isinstance(value, dict):
        return value
    named = {key: _with_units(item) for key, item in value.items()}
    if named.get("default") == math.inf:  # which JSON has no number for
        del named["default"]
    properties = named.get("properties", {})
    for key in FileModel.about_keys:
        if isinstance(properties, dict) and key in properties:
            properties[key] = {"$ref": f"#/$defs/{key}"}
    unit = value.get("unit")
    if isinstance(unit, str) and "description" in value:
        named["description"] = f"{value['description']} [{unit}]"
    return named


def word_of(model: type[BaseModel], field: str, word: str) -> str:
    """Return what the `quantity` of a model's field says as "unit" or "path", empty if it says nothing."""
    extra = model.model_fields[field].json_schema_extra
    return str(extra.get(word, "")) if isinstance(extra, dict) else ""


def unit_at(root: JsonSchema, place: Place, content: Any) -> str:
    """Return the unit of the value, or of the values in a list or mapping, at a place; empty if it has none."""
    for end in range(len(place), 0, -1):
        node = schema_at(root, place[:end], content)
        for kind in (node, *node.get("anyOf", ())):
            for schema in (kind, _resolved(kind.get("items", {}), root)):
                if "unit" in schema:
                    return str(schema["unit"])
    return ""


@cache
def schema_of(model: type[BaseModel]) -> JsonSchema:
    """Return the JSON schema of a model as pydantic makes it, once; nobody may change it."""
    return model.model_json_schema()


@contextmanager
def refusals(model: type[BaseModel], where: str = "", content: Any = None) -> Iterator[None]:
    """Turn the ValidationError of a block into a ConfigError with the first fault.

    Args:
        model: that is validated.
        where: what contains the values, such as a file.
        content: that is validated, if it came from a file.
    """
    try:
        yield
    except ValidationError as error:
        raise ConfigError(fault_lines(model, error, where, content)[0]) from None


def fault_lines(
    model: type[BaseModel], error: ValidationError, where: str = "", content: Any = None
) -> list[str]:
    """Return a line for each fault, with place, value and what is accepted; misspelt keys come first.

    Of many faults the first ones are told, and how many more there are.

    Args:
        model: that was validated.
        error: of pydantic.
        where: what contains the values, such as a file.
        content: that was validated, if it came from a file.
    """
    schema = schema_of(model)
    every = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] != _UNKNOWN_KEY)
    faults = [(fault, _place_of(fault, schema, content)) for fault in every[:_MAX_FAULTS]]
    lines: list[str] = []
    meant: set[Place] = set()
    for fault, place in faults:
        around = schema_at(schema, place[:-1], content).get("properties", {})
        given = value_at(content, place[:-1]) or {}
        if fault["type"] == _UNKNOWN_KEY:
            near = nearest(str(place[-1]), (key for key in around if not _holds(given, key)))
            meant.add((*place[:-1], near))
            lines.append(_unknown_key(place, near, around))
        elif fault["type"] in _MISSING and place in meant:
            continue  # one mistake would be told twice
        elif fault["type"] == _NO_KIND and (
            odd := nearest(str(place[-1]), given.keys() - around.keys())
        ):
            lines.insert(0, _unknown_key((*place[:-1], odd), str(place[-1]), around))
        elif not any(inner != place and inner[: len(place)] == place for _, inner in faults):
            # else of several kinds of value another is meant
            lines.append(_line(schema, fault, place, content))
    if len(every) > _MAX_FAULTS:
        lines.append(f"{len(every) - _MAX_FAULTS:,} more faults, which are not told")
    # Two kinds of a union, or both signs, say the same.
    return [f"{where}: {line}" if where else line for line in dict.fromkeys(lines)]


def _unknown_key(place: Place, near: str, around: JsonSchema) -> str:
    keys = ", ".join(key for key in around if key not in FileModel.about_keys)
    return f"{_path(place)} is not a known key{question(near)}; accepted: {keys}"


def accepted_values(schema: JsonSchema, root: JsonSchema) -> str:
    """Return in words what a JSON schema accepts.

    Args:
        schema: of a value.
        root: the schema that defines what its references stand for.
    """
    schema = _resolved(schema, root)
    kinds = _alternatives(schema)
    kind = str(schema.get("type", ""))
    if "accepted" in schema:
        words = str(schema["accepted"])
    elif "enum" in schema or "const" in schema:
        values = schema.get("enum", [schema.get("const")])
        words = f"one of {', '.join(map(str, values))}" if len(values) > 1 else str(values[0])
    elif kinds:
        words = " or ".join(dict.fromkeys(accepted_values(kind, root) for kind in kinds))
    elif kind in {"number", "integer"}:
        words = _range_in_words("an integer" if kind == "integer" else "a number", schema)
    elif kind == "array":
        words = _list_in_words(schema, root)
    else:
        words = {"string": "a text", "boolean": "true or false", "object": "a mapping"}.get(
            kind, "another value"
        )
    return words


def _range_in_words(noun: str, schema: JsonSchema) -> str:
    ends = {sign: _number_text(schema[key]) for key, sign in _SIGNS.items() if key in schema}
    if not ends:
        return "an integer" if noun == "an integer" else "a finite number"
    if len(ends) == 1:
        return f"{noun} {' '.join(*ends.items())}"
    low, high = ends.values()
    return f"{noun} in {'[' if '>=' in ends else '('}{low}, {high}{']' if '<=' in ends else ')'}"


def _number_text(number: float | None) -> str:
    return str(number) if isinstance(number, int) else f"{number:g}"


def _list_in_words(schema: JsonSchema, root: JsonSchema) -> str:
    item = _resolved(schema.get("items", {}), root)
    nouns = {
        "number": "number",
        "integer": "integer",
        "string": "text",
        "object": "mapping",
        "array": "row",
    }
    noun = nouns.get(str(item.get("type")), "value")
    least = schema.get("minItems", 0)
    most = schema.get("maxItems")
    if most is None:
        text = f"a list of {noun}s" if not least else f"a list of {least} {noun}s or more"
    elif most == MAX_JOINTS:
        text = f"a list with one {noun} per joint"
    elif least == most:
        text = f"a list of {least} {noun}{'' if least == 1 else 's'}"
    else:
        text = f"a list of {least} to {most} {noun}s"
    ranged = {*_SIGNS, "accepted"} & item.keys()
    return f"{text}, each {accepted_values(item, root)}" if ranged else text


def _line(schema: JsonSchema, fault: ErrorDetails, place: Place, content: Any) -> str:
    context = fault.get("ctx", {})
    if fault["type"] == _REFUSED:
        return f"{_path((*place, context['key']))} is {context['value']}; accepted: {context['accepted']}"
    if fault["type"] == "value_error":
        return f"{_path(place)}: {context['error']}" if place else str(context["error"])
    accepted = accepted_values(schema_at(schema, place, content), schema)
    if fault["type"] in _MISSING:
        return f"{_path(place)} is missing; accepted: {accepted}"
    if fault["type"] == "finite_number":
        accepted = accepted.replace("a number", "a finite number", 1)
    value = context["tag"] if fault["type"] == _UNKNOWN_KIND else fault["input"]
    return f"{_path(place)} is {quoted(value)}; accepted: {accepted}"


def _path(place: Place) -> str:
    keys = (f"[{key}]" if isinstance(key, int) else f".{plain(key)}" for key in place)
    return "".join(keys).removeprefix(".") or "the value"


def _place_of(fault: ErrorDetails, schema: JsonSchema, content: Any) -> Place:
    """Return the place of a fault in the file, without what pydantic adds to it, as the names of a union's kinds.

    It is that of a missing key where it would stand, of a kind that is none the key that chooses it.
    """
    if content is None:
        return fault["loc"]
    place: list[str | int] = []
    value = content
    kind = None
    for key in fault["loc"]:
        if key == kind:
            kind = None
        elif _holds(value, key):
            place.append(key)
            value = value[key]
            union = schema_at(schema, tuple(place), content).get("discriminator", {})
            kind = value_at(value, (union.get("propertyName"),))
    if fault["type"] == "missing":
        place.append(fault["loc"][-1])
    elif "discriminator" in fault.get("ctx", {}):
        place.append(fault["ctx"]["discriminator"].strip("'"))
    return tuple(place)


def _holds(value: Any, key: str | int) -> bool:
    if isinstance(value, Mapping):
        return key in value
    has_items = hasattr(value, "__getitem__")  # a list, or an array of numbers
    return isinstance(key, int) and has_items and key < len(value)


def value_at(content: Any, place: Place) -> Any:
    """Return the value at a place of plain data, an empty mapping if there is none."""
    value = content
    for key in place:
        value = value[key] if _holds(value, key) else {}
    return value


def _resolved(schema: JsonSchema, root: JsonSchema) -> JsonSchema:
    """Return a schema whose own reference, if it is one, is replaced by what it stands for."""
    name = schema.get("$ref", "").rpartition("/")[2]
    return {**root.get("$defs", {}).get(name, {}), **schema}


def schema_at(root: JsonSchema, place: Place, content: Any = None) -> JsonSchema:
    """Return the schema of the value at a place, empty for an unknown place.

    Args:
        root: schema of the whole.
        place: of the value.
        content: of the whole, if it is known: tells which of several kinds a value is meant for.
    """
    schema = _meant(root, root, content)
    for key in place:
        content = value_at(content, (key,))
        schema = _meant(_inner(schema, key), root, content)
    return schema


def _alternatives(schema: JsonSchema) -> list[JsonSchema]:
    """Return the schemas of all kinds of value that a schema accepts, but for null; of a single kind none."""
    kinds = schema.get("anyOf") or schema.get("oneOf") or ()
    return [kind for kind in kinds if kind.get("type") != "null"]


def _meant(schema: JsonSchema, root: JsonSchema, value: Any) -> JsonSchema:
    """Return that kind of value which a value is meant for; of values without keys all kinds together."""
    schema = _resolved(schema, root)
    kinds = [_meant(kind, root, value) for kind in _alternatives(schema)]
    if "properties" in schema or not kinds or (len(kinds) > 1 and not isinstance(value, Mapping)):
        return schema
    likest = max(kinds, key=lambda kind: _likeness(kind, value))
    return likest | {key: schema[key] for key in _OF_ALL_KINDS if key in schema}


def _likeness(schema: JsonSchema, value: Any) -> tuple[bool, int]:
    """Return whether a kind is a mapping, and how many keys a mapping shares, but for texts that would be others."""
    if not isinstance(value, Mapping):
        return False, 0
    properties = schema.get("properties", {})
    shared = sum(
        key in properties and properties[key].get("const", inner) == inner
        for key, inner in value.items()
    )
    return schema.get("type") == "object", shared


def _inner(schema: JsonSchema, key: str | int) -> JsonSchema:
    if isinstance(key, int):
        schema = next(
            (kind for kind in schema.get("anyOf", ()) if kind.get("type") == "array"), schema
        )
        items = schema.get("prefixItems", ())
        inner = items[key] if key < len(items) else schema.get("items", {})
    elif schema.get("discriminator", {}).get("propertyName") == key:
        inner = {"enum": list(schema["discriminator"]["mapping"])}
    else:
        inner = schema.get("properties", {}).get(key, schema.get("additionalProperties", {}))
    return inner if isinstance(inner, dict) else {}
