"""Tolerances of values: per field, per topic, per joint; by default not a single bit."""

from __future__ import annotations

import math
from collections.abc import Collection

from rx90_common.bags.topics import FIELDS, absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, quoted

ANY = "*"
GRAMMAR = "[TOPIC:[JOINT:]]FIELD=VALUE"


class Tolerances:
    """Tolerances in rad, rad/s or Nm, of the form `[TOPIC:[JOINT:]]FIELD=VALUE`, TOPIC and JOINT being * for any.

    The last one that fits decides.

    Raises:
        BagError: if a text is not of that form.
    """

    def __init__(self, *texts: str) -> None:
        self._rules: list[tuple[str, str, str, float]] = []
        for text in texts:
            key, _, value = text.rpartition("=")
            *place, field = key.split(":")
            try:
                number = float(value)
            except ValueError:
                number = math.nan
            if (
                field not in FIELDS
                or len(place) > 2
                or not all(place)
                or not 0.0 <= number < math.inf
            ):
                accepted = f"{GRAMMAR}, e.g. joint_states:position=1e-6, VALUE >= 0"
                raise BagError(f"tolerance {quoted(text)}; accepted: {accepted}")
            topic, joint = [*place, ANY, ANY][:2]
            self._rules.append((topic if topic == ANY else absolute(topic), joint, field, number))

    def of(self, topic: str, joint: str, field: str) -> float:
        """Return the tolerance for a value, 0 where none fits."""
        for rule_topic, rule_joint, rule_field, number in reversed(self._rules):
            if rule_topic in (ANY, topic) and rule_joint in (ANY, joint) and rule_field == field:
                return number
        return 0.0

    def check(self, topics: Collection[str], joints: Collection[str]) -> None:
        """Refuse tolerances that name none of these, as they are misspelt.

        Raises:
            BagError: if one names another topic or joint.
        """
        for topic, joint, _, _ in self._rules:
            if topic not in (ANY, *topics):
                raise BagError(
                    f"tolerance for {topic}, which is not compared; topics: {listed(topics)}"
                )
            if joint not in (ANY, *joints):
                raise BagError(
                    f"tolerance for {joint}, which no compared topic has; joints: {listed(sorted(joints))}"
                )
