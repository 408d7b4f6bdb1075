"""Tolerances of values: per field, per topic, per joint; by default not a single bit."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import Final, NamedTuple

from rx90_common.bags.topics import FIELDS, absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, quoted

ANY: Final = "*"
GRAMMAR: Final = "[TOPIC:[JOINT:]]FIELD=VALUE"


class ToleranceRule(NamedTuple):
    """One tolerance in rad, rad/s or Nm, for a field of one or any topic and one or any joint (None)."""

    topic: str | None
    joint: str | None
    field: str
    value: float

    def fits(self, topic: str, joint: str, field: str) -> bool:
        """Return whether it holds for a field of a joint of a topic."""
        return self.field == field and self.topic in (None, topic) and self.joint in (None, joint)


class Tolerances:
    """A list of rules, of the form `[TOPIC:[JOINT:]]FIELD=VALUE`, TOPIC being * for any.

    The most specific rule that fits decides, and among equals the last. From most to least specific: topic and joint,
    topic, joint of any topic, field alone.

    Raises:
        BagError: if a text is not of that form.
    """

    def __init__(self, *texts: str) -> None:
        rules = [_parsed(text) for text in texts]
        self._rules = sorted(rules, key=lambda rule: (rule.topic is not None, rule.joint is not None))

    def of(self, topic: str, joint: str, field: str) -> float:
        """Return the tolerance for a value, 0 where no rule fits."""
        return next((rule.value for rule in reversed(self._rules) if rule.fits(topic, joint, field)), 0.0)

    def check(self, topics: Collection[str], joints: Mapping[str, Collection[str]]) -> None:
        """Refuse rules that fit nothing, as they are misspelt.

        Args:
            topics: the topics of both bags.
            joints: the joints of each topic that is compared.

        Raises:
            BagError: if a rule names a topic of neither bag, or a joint that no compared topic has.
        """
        for rule in self._rules:
            if rule.topic not in (None, *topics):
                raise BagError(f"tolerance for {rule.topic}, which is in neither bag; topics: {listed(sorted(topics))}")
            known = {name for topic, names in joints.items() if rule.topic in (None, topic) for name in names}
            if rule.joint is not None and rule.topic in (None, *joints) and rule.joint not in known:
                there = listed(sorted(known))
                raise BagError(f"tolerance for {rule.joint}, which no compared topic has; joints: {there}")


def _parsed(text: str) -> ToleranceRule:
    key, _, value = text.rpartition("=")
    *place, field = key.split(":")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if field not in FIELDS or len(place) > 2 or not all(place) or not 0.0 <= number < math.inf:
        raise BagError(f"tolerance {quoted(text)}; accepted: {GRAMMAR}, e.g. joint_states:position=1e-6, VALUE >= 0")
    topic = absolute(place[0]) if place and place[0] != ANY else None
    return ToleranceRule(topic, place[1] if len(place) > 1 else None, field, number)
