"""Parameters of a friction element as they are typed: one value, or one for each sign of the velocity."""

from __future__ import annotations

from collections.abc import Sequence

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import quoted
from rx90_common.friction import FrictionElement
from rx90_common.friction.parameters import FRICTION_PARAMETERS


def typed_values(element: FrictionElement, factor: float = 1.0) -> tuple[str, ...]:
    """Return what one would type for an element whose values are times a factor, in the order of the table."""
    texts = []
    for parameter in FRICTION_PARAMETERS:
        words = [f"{getattr(element, name) * factor:.6g}" for name in parameter.attributes]
        texts.append(" ".join(words if len(set(words)) > 1 else words[:1]))
    return tuple(texts)


def read_values(texts: Sequence[str]) -> dict[str, float]:
    """Return the attributes of FrictionElement that the fields say, in the order of the table.

    Raises:
        ConfigError: for what is no number, naming parameter, text and what is accepted.
    """
    values: dict[str, float] = {}
    for parameter, text in zip(FRICTION_PARAMETERS, texts, strict=True):
        try:
            numbers = [float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            numbers = []
        if len(numbers) == 1:
            numbers *= len(parameter.attributes)
        if len(numbers) != len(parameter.attributes):
            pair = ", or two for the signs of the velocity" if parameter.signed else ""
            raise ConfigError(f"{parameter.name} is {quoted(text)}; accepted: {parameter.accepted}{pair}")
        values |= zip(parameter.attributes, numbers, strict=True)
    return values
