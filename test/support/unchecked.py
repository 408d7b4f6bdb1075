"""Models with values that no file could have, past all checks."""

from typing import Any, TypeVar

from rx90_common.base.models import Model

AnyModel = TypeVar("AnyModel", bound=Model)


def unchecked(model: AnyModel, **changes: Any) -> AnyModel:
    """Return a copy with other values, of a model in the model by a mapping of its fields."""
    values = {name: getattr(model, name) for name in type(model).model_fields}
    for name, change in changes.items():
        values[name] = unchecked(values[name], **change) if isinstance(change, dict) else change
    return type(model).model_construct(**values)
