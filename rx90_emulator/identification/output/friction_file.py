"""Write what was identified as a friction file that the simulation loads as it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import yaml

from rx90_common.friction import LuGreElement
from rx90_emulator.identification.model.estimates import PARAMETERS, ParameterEstimate
from rx90_emulator.identification.records.record import BagSource
from rx90_emulator.identification.result.identification import FrictionIdentification, IdentifiedElement

_HEAD = """\
# LuGre friction, joint side, SI units (equations 17 to 19), identified from recorded bags.
# `elements` holds the values that the simulation loads. `identification` says for each of them how well it is known:
# standard deviation, interval at 95 %, the bags it rests on, and whether the data tell it at all; where they do not,
# the value stands in from elsewhere and is an assumption.
"""


def friction_text(result: FrictionIdentification, now: datetime | None = None) -> str:
    """Return the file's text.

    Args:
        result: what was identified.
        now: date of the identification; by default the present.
    """
    date = (now or datetime.now(timezone.utc)).isoformat(timespec="seconds")
    fallback_name = result.fallback_name
    sources: dict[BagSource, str] = {}
    for one in result.elements:
        for bags in one.sources.values():
            for bag in bags:
                sources.setdefault(bag, f"bag_{len(sources) + 1}")
    names = result.arm.element_names
    content = {
        "provenance": "identified",
        "source": f"{len(sources)} bags, {date}; omega_d is not identified"
        + ("" if fallback_name is None else f", it is that of {fallback_name}"),
        "elements": {name: _values(one.element) for name, one in zip(names, result.elements, strict=True)},
        "identification": {
            "date": date,
            "bags": {
                label: {"path": str(bag.path), "sha256": bag.sha256, "recorded": _date_of(bag.path)}
                for bag, label in sources.items()
            },
            "parameters": {
                name: _provenance(one, sources, date, fallback_name)
                for name, one in zip(names, result.elements, strict=True)
            },
        },
    }
    return _HEAD + yaml.dump(content, Dumper=_Dumper, sort_keys=False, width=118)


class _Dumper(yaml.SafeDumper):
    """Writes floats so that YAML 1.1 and 1.2 read the same, and short mappings on one line."""


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    text = f"{value:.6g}"
    mantissa, _, exponent = text.partition("e")
    if exponent and "." not in mantissa:
        text = f"{mantissa}.0e{exponent}"
    elif "." not in text and not exponent:
        text += ".0"
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(float, _represent_float)


def _values(element: LuGreElement) -> dict[str, Any]:
    values: dict[str, Any] = {
        key: {sign: getattr(element, f"{key}_{sign}") for sign in ("positive", "negative")}
        for key in ("tau_c", "tau_s")
    }
    values |= {key: getattr(element, key) for key in ("omega_s", "delta", "c0", "c1", "c2")}
    if math.isfinite(element.omega_d):
        values["omega_d"] = element.omega_d
    return values


def _provenance(
    one: IdentifiedElement, labels: dict[BagSource, str], date: str, fallback_name: str | None
) -> dict[str, Any]:
    return {
        name: _parameter(
            getattr(one.element, name), one.estimates[name], [labels[bag] for bag in one.sources[name]], date,
            fallback_name,
        )
        for name in PARAMETERS
    }  # fmt: skip


def _parameter(
    value: float, estimate: ParameterEstimate, bags: Sequence[str], date: str, fallback_name: str | None
) -> dict[str, Any]:
    if not estimate.identifiable:
        return {
            "provenance": "assumed", "value": value, "identifiable": False, "reason": estimate.reason,
            "taken_from": fallback_name, "bags": list(bags), "date": date,
        }  # fmt: skip
    return {
        "provenance": "identified",
        "value": value,
        "deviation": estimate.deviation,
        "interval": list(estimate.bounds),
        "bags": list(bags),
        "date": date,
    }


def _date_of(path: Path) -> str:
    """Return when a bag's newest file was written: simulated bags carry no wall time."""
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    newest = max((file.stat().st_mtime for file in files), default=0.0)
    return datetime.fromtimestamp(newest, timezone.utc).isoformat(timespec="seconds")
