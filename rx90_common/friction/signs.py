"""Values for each sign of the velocity; a file has both, or one for both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Generic, TypeVar

from pydantic import (
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema

from rx90_common.base.models import FileModel, JsonSchema

SIGNS = ("positive", "negative")
"""Of the velocity, in the order in which everything keeps them; v = 0 counts as positive."""

Value = TypeVar("Value")


class BySign(FileModel, Generic[Value]):
    """A value for each sign of the velocity."""

    positive: Value
    negative: Value

    @property
    def both(self) -> tuple[Value, Value]:
        """Return the values in the order of SIGNS."""
        return self.positive, self.negative

    @model_validator(mode="before")
    @classmethod
    def _for_both(cls, value: Any) -> Any:
        if isinstance(value, cls) or (
            isinstance(value, Mapping) and not value.keys().isdisjoint(SIGNS)
        ):
            return value
        if isinstance(value, BySign):
            return {"positive": value.positive, "negative": value.negative}
        return dict.fromkeys(SIGNS, value)

    @model_serializer(mode="wrap")
    def _once_if_equal(self, dump: SerializerFunctionWrapHandler) -> Any:
        content = dump(self)
        return (
            content["positive"] if content == dict.fromkeys(SIGNS, content["positive"]) else content
        )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchema:
        """Return the schema of one value, or of a mapping with both."""
        mapping = handler(core_schema)
        return {"anyOf": [handler.resolve_ref_schema(mapping)["properties"]["positive"], mapping]}
