"""How the columns of a table are called, and what the mapping file beside a CSV file says of them."""

from __future__ import annotations

import re
from typing import Any, Final

from rx90_common.bags.joint_series import JointSeries
from rx90_common.base.config import yaml_text

TIME: Final = "time [s]"
STAMP: Final = "stamp [ns]"


def columns(series: JointSeries) -> list[tuple[str, str, str]]:
    """Return joint, field and name of each column, such as `joint_1 position [rad]`, in the order of a message."""
    told = series.quantities
    return [(joint, field, f"{joint} {told[field]}") for field in series.fields for joint in series.names]


def array_name(topic: str, quantity: str) -> str:
    """Return the name of an array: letters, digits and _, such as `joint_states_velocity_rad_s`.

    Args:
        topic: with or without the leading slash.
        quantity: with its unit, such as `velocity [rad/s]`, or any other word.
    """
    words = f"{topic.removeprefix('/')} {quantity}".replace("^", "")
    name = re.sub(r"[^A-Za-z0-9]+", "_", words).strip("_")
    return name if name[:1].isalpha() else f"topic_{name}"


def mapping_text(series: JointSeries) -> str:
    """Return the mapping file by which the CSV file of a series becomes a bag again."""
    content: dict[str, Any] = {"names": list(series.names)}
    count = len(series.names)
    for k, field in enumerate(series.fields):
        first = 2 + k * count
        content[field] = {"columns": list(range(first, first + count)), "unit": series.units[field]}
    document = {
        "exact": True,
        "delimiter": ",",
        "decimal": ".",
        "header": 1,
        "time": {"column": 1, "unit": "s"},
        "topics": {series.topic: content},
    }
    return yaml_text(document)
