"""How far values may differ: per field, per topic, per joint; by default not by a single bit."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from rx90_common.bags.topics import SERIES_FIELDS, USUAL_UNITS, absolute
from rx90_common.base.config import load_yaml
from rx90_common.base.entries import LEFT_OUT, Number
from rx90_common.base.errors import BagError
from rx90_common.base.groups import Entries, Group
from rx90_common.base.quoting import quoted

ANY: Final = "*"
GRAMMAR: Final = "[TOPIC:[JOINT:]]FIELD=VALUE"

_JOINTS = "joints"
_LIMITS = {
    name: Number(f"How far a {name} may differ.", unit, low=0.0, default=LEFT_OUT) for name, unit in USUAL_UNITS.items()
}

TOLERANCES = Entries(
    "How far values of two bags may differ, by topic; * stands for any.",
    of=Group(
        "Tolerances of a topic.",
        keys={
            **_LIMITS,
            _JOINTS: Entries(
                "Tolerances of single joints.", of=Group("Tolerances of a joint.", keys=_LIMITS), default=LEFT_OUT
            ),
        },
    ),
)
"""What a file of tolerances holds."""


@dataclass(frozen=True)
class ToleranceRule:
    """One tolerance in rad, rad/s, Nm or °C, for a field of one or any topic and one or any joint (None)."""

    topic: str | None
    joint: str | None
    field: str
    value: float

    def __post_init__(self) -> None:
        if self.field not in SERIES_FIELDS:
            raise BagError(f"tolerance for the field {quoted(self.field)}; accepted: {', '.join(SERIES_FIELDS)}")
        if not (math.isfinite(self.value) and self.value >= 0.0):
            raise BagError(f"tolerance {self.value} for {self.field}; accepted: a finite number >= 0")

    def fits(self, topic: str, joint: str, field: str) -> bool:
        """Return whether the rule speaks of this value."""
        return self.field == field and self.topic in (None, topic) and self.joint in (None, joint)


class Tolerances:
    """A list of rules; the most specific one that fits decides, and among equals the last.

    From most to least specific: topic and joint, topic, joint of any topic, field alone.
    """

    def __init__(self, rules: Iterable[ToleranceRule] = ()) -> None:
        self._rules = sorted(rules, key=lambda rule: (rule.topic is not None, rule.joint is not None))

    @classmethod
    def parse(cls, *texts: str) -> Tolerances:
        """Return the rules that texts such as `position=1e-6` or `joint_states:joint_1:effort=0.1` state.

        Raises:
            BagError: if a text is not of the form `[TOPIC:[JOINT:]]FIELD=VALUE`, TOPIC being * for any.
        """
        return cls(map(parse_rule, texts))

    def of(self, topic: str, joint: str, field: str) -> float:
        """Return the tolerance for a value, 0 where no rule fits."""
        return next((r.value for r in reversed(self._rules) if r.fits(topic, joint, field)), 0.0)

    def check(self, topics: Collection[str], joints: Mapping[str, Collection[str]]) -> None:
        """Refuse rules that fit nothing, as they are misspelt.

        Args:
            topics: the topics of both bags.
            joints: the joints of each topic that is compared.

        Raises:
            BagError: if a rule names a topic of neither bag, or a joint that no compared topic has.
        """
        for rule in self._rules:
            if rule.topic is not None and rule.topic not in topics:
                there = ", ".join(sorted(topics))
                raise BagError(f"tolerance for {rule.topic}, which is in neither bag; topics: {there}")
            if rule.joint is None or (rule.topic is not None and rule.topic not in joints):
                continue
            known = {n for t, names in joints.items() if rule.topic in (None, t) for n in names}
            if rule.joint not in known:
                there = ", ".join(sorted(known))
                raise BagError(f"tolerance for {rule.joint}, which no compared topic has; joints: {there}")


def parse_rule(text: str) -> ToleranceRule:
    """Read `[TOPIC:[JOINT:]]FIELD=VALUE`; TOPIC may be * for any.

    Raises:
        BagError: if the text is not of that form.
    """
    key, equals, value = text.rpartition("=")
    parts = key.split(":")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not equals or len(parts) > 3 or not all(parts) or math.isnan(number):
        raise BagError(f"tolerance {quoted(text)}; accepted: {GRAMMAR}, e.g. joint_states:position=1e-6")
    topic = parts[0] if len(parts) > 1 and parts[0] != ANY else None
    joint = parts[1] if len(parts) == 3 else None
    return ToleranceRule(None if topic is None else absolute(topic), joint, parts[-1], number)


def load_rules(path: Path) -> list[ToleranceRule]:
    """Read a YAML file of tolerances.

    ```yaml
    "*":                      # any topic
      velocity: 1.0e-6
    joint_states:
      position: 1.0e-9
      joints:
        joint_1: {position: 1.0e-8}
    ```

    Raises:
        ConfigError: if the file cannot be read or holds anything else.
    """
    rules: list[ToleranceRule] = []
    for name, given in TOLERANCES.read(load_yaml(path)).items():
        topic = None if name == ANY else absolute(name)
        rules += _field_rules(given, topic, None)
        for joint, own in given.get(_JOINTS, {}).items():
            rules += _field_rules(own, topic, joint)
    return rules


def _field_rules(given: Mapping[str, float], topic: str | None, joint: str | None) -> list[ToleranceRule]:
    return [ToleranceRule(topic, joint, field, given[field]) for field in SERIES_FIELDS if field in given]
