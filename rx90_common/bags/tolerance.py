"""Tolerances of values: per field, per topic, per joint; by default not a single bit."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from pydantic import Field

from rx90_common.bags.topics import FIELDS, absolute
from rx90_common.base.errors import BagError
from rx90_common.base.models import FileModel, Named, quantity, read_model
from rx90_common.base.quoting import quoted

ANY: Final = "*"
GRAMMAR: Final = "[TOPIC:[JOINT:]]FIELD=VALUE"


class JointTolerances(FileModel):
    """How far the values of a joint may differ."""

    position: Annotated[float | None, quantity("rad", "How far a position may differ.", ge=0.0)] = None
    velocity: Annotated[float | None, quantity("rad/s", "How far a velocity may differ.", ge=0.0)] = None
    effort: Annotated[float | None, quantity("Nm", "How far an effort may differ.", ge=0.0)] = None

    def rules(self, topic: str | None, joint: str | None) -> list[ToleranceRule]:
        """Return those that are stated, for a topic and a joint, None for any."""
        stated = {"position": self.position, "velocity": self.velocity, "effort": self.effort}
        return [ToleranceRule(topic, joint, name, value) for name, value in stated.items() if value is not None]


class TopicTolerances(JointTolerances):
    """How far the values of a topic may differ."""

    joints: Annotated[Named[JointTolerances], Field(description="Tolerances of single joints.")] = Named()


class TolerancesFile(Named[TopicTolerances]):
    """How far values of two bags may differ, by topic; * stands for any."""


@dataclass(frozen=True)
class ToleranceRule:
    """One tolerance in rad, rad/s, Nm or °C, for a field of one or any topic and one or any joint (None)."""

    topic: str | None
    joint: str | None
    field: str
    value: float

    def __post_init__(self) -> None:
        if self.field not in FIELDS:
            raise BagError(f"tolerance for the field {quoted(self.field)}; accepted: {', '.join(FIELDS)}")
        if not (math.isfinite(self.value) and self.value >= 0.0):
            raise BagError(f"tolerance {self.value} for {self.field}; accepted: a finite number >= 0")


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
        fitting = [r.value for r in self._rules
                   if r.field == field and r.topic in (None, topic) and r.joint in (None, joint)]  # fmt: skip
        return fitting[-1] if fitting else 0.0

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
            known = {name for topic, names in joints.items() if rule.topic in (None, topic) for name in names}
            if rule.joint is not None and rule.topic in (None, *joints) and rule.joint not in known:
                there = ", ".join(sorted(known))
                raise BagError(f"tolerance for {rule.joint}, which no compared topic has; joints: {there}")


def parse_rule(text: str) -> ToleranceRule:
    """Read `[TOPIC:[JOINT:]]FIELD=VALUE`; TOPIC may be * for any."""
    key, equals, value = text.rpartition("=")
    parts = key.split(":")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not equals or len(parts) > 3 or not all(parts) or math.isnan(number):
        raise BagError(f"tolerance {quoted(text)}; accepted: {GRAMMAR}, e.g. joint_states:position=1e-6")
    topic = None if len(parts) == 1 or parts[0] == ANY else absolute(parts[0])
    return ToleranceRule(topic, parts[1] if len(parts) == 3 else None, parts[-1], number)


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
    """
    rules: list[ToleranceRule] = []
    for name, tolerances in read_model(TolerancesFile, path).entries.items():
        topic = None if name == ANY else absolute(name)
        rules += tolerances.rules(topic, None)
        for joint, of_joint in tolerances.joints.entries.items():
            rules += of_joint.rules(topic, joint)
    return rules
