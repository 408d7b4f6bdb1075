"""Tolerances of values: per field, per topic, per joint; by default not a single bit."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Final

from rx90_common.bags.topics import FIELDS, absolute
from rx90_common.base.errors import BagError
from rx90_common.base.quoting import listed, quoted

ANY: Final = "*"
GRAMMAR: Final = "[TOPIC:[JOINT:]]FIELD=VALUE"


class Tolerances:
    """Tolerances in rad, rad/s or Nm, of the form `[TOPIC:[JOINT:]]FIELD=VALUE`, TOPIC being * for any.

    The most specific one that fits decides, and among equals the last. From most to least specific: topic and joint,
    topic, joint of any topic, field alone.

    Raises:
        BagError: if a text is not of that form.
    """

    def __init__(self, *texts: str) -> None:
        self._values: dict[tuple[str | None, str | None, str], float] = {}
        for text in texts:
            key, _, value = text.rpartition("=")
            *place, field = key.split(":")
            try:
                number = float(value)
            except ValueError:
                number = math.nan
            if field not in FIELDS or len(place) > 2 or not all(place) or not 0.0 <= number < math.inf:
                accepted = f"{GRAMMAR}, e.g. joint_states:position=1e-6, VALUE >= 0"
                raise BagError(f"tolerance {quoted(text)}; accepted: {accepted}")
            topic = absolute(place[0]) if place and place[0] != ANY else None
            self._values[topic, place[1] if len(place) > 1 else None, field] = number

    def of(self, topic: str, joint: str, field: str) -> float:
        """Return the tolerance for a value, 0 where none fits."""
        for key in ((topic, joint, field), (topic, None, field), (None, joint, field), (None, None, field)):
            if key in self._values:
                return self._values[key]
        return 0.0

    def check(self, topics: Collection[str], joints: Collection[str]) -> None:
        """Refuse tolerances that name none of these, as they are misspelt.

        Raises:
            BagError: if one names another topic or joint.
        """
        for topic, joint, _ in self._values:
            if topic not in (None, *topics):
                raise BagError(f"tolerance for {topic}, which is not compared; topics: {listed(topics)}")
            if joint not in (None, *joints):
                raise BagError(f"tolerance for {joint}, which no compared topic has; joints: {listed(sorted(joints))}")
