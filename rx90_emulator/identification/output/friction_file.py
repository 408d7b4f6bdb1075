"""Write identified friction as a friction file that the simulation loads as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from types import MappingProxyType
from typing import Any

import numpy as np

from rx90_common.base.config import check_numbers
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.identification.estimates import (
    LARGEST,
    NOT_IN_MODEL,
    PARAMETERS,
    IdentifiedElement,
    ParameterEstimate,
    digits,
)
from rx90_emulator.identification.identify import FrictionIdentification
from rx90_emulator.identification.records import BagSource, in_unit
from rx90_emulator.identification.rows.filtering import Bandwidths

_REMARKS = """\
#
# Identified from recorded bags. `elements` holds the values that the simulation loads. `identification` says how well
# each of them is known: standard deviation, interval at 95 %, bags, and whether the bags identify it. A value that they
# do not identify is taken from elsewhere, and is an assumption.
"""
_LARGEST = {"Nm": 1e6, "rad/s": 1e4, "1": 1e3, "Nm/rad": 1e12, "Nm s/rad": 1e9, "Nm (s/rad)^alpha": 1e6}
"""Largest values with these units: orders of magnitude beyond any arm, which only a failed fit gives."""
_NONE: Mapping[str, Any] = MappingProxyType({})
_NOT_FITTED = ParameterEstimate.unknown("the model that was fitted does not have it")


def friction_text(result: FrictionIdentification) -> str:
    """Return the text of the file of an identification from sweeps; errors as in `elements_text`."""
    return elements_text(result.arm.element_names, result.elements, result.fallback_name, result=result)


def elements_text(
    names: Sequence[str],
    elements: Sequence[IdentifiedElement],
    fallback_name: str | None,
    now: datetime | None = None,
    result: FrictionIdentification | None = None,
    joints: Mapping[str, Mapping[str, float]] = _NONE,
    bandwidths: Bandwidths | None = None,
    unit: str = "Nm",
    warnings: Mapping[str, str] = _NONE,
    speeds: Mapping[str, tuple[float, float]] = _NONE,
) -> str:
    """Return the text of a file with these elements.

    Args:
        names: of the elements.
        elements: identified values of each.
        fallback_name: file of the values that replace parameters that are not identifiable, if any.
        now: date of the identification; by default the present.
        result: from sweeps, whose use of the bags and goodness of fit are written into the file.
        joints: torques beside links and friction, as in `FrictionFile.joints`.
        bandwidths: of excitation runs, which a validation of the file uses again.
        unit: of the torques, if they are currents.
        warnings: why an element's values cannot be trusted, by its name.
        speeds: least and greatest speed with data, rad/s, by element; with `result` those of its sweeps.
    """
    date = (now or datetime.now(timezone.utc)).isoformat(timespec="seconds")
    named = dict(zip(names, elements, strict=True))
    rounded = {name: _rounded(name, one) for name, one in named.items()}
    used = [bags for one in elements for bags in one.sources.values()]
    labels = {bag: f"bag_{k}" for k, bag in enumerate(dict.fromkeys(bag for bags in used for bag in bags), 1)}
    notes = dict(warnings)
    for name, one in named.items():
        if one.given_bristles:
            before = f"{notes[name]}; " if name in notes else ""
            notes[name] = f"{before}bristles: as its c0 those of {fallback_name}, assumed"
    bags = {label: {"path": str(b.path), "sha256": b.sha256, "recorded": b.recorded} for b, label in labels.items()}
    identification: dict[str, Any] = {"date": date, "bags": bags}
    if unit != "Nm":
        identification["unit"] = unit
    if bandwidths is not None:
        identification["bandwidths"] = {"position": float(bandwidths.position), "torque": float(bandwidths.torque)}
    if result is not None:
        curves = zip(names, result.sliding.curves, strict=True)
        sizes = {name: np.abs(curve.velocity) for name, curve in curves if curve is not None}
        speeds = {name: (float(size.min()), float(size.max())) for name, size in sizes.items()}
    if speeds:
        identification["speeds"] = {name: [digits(speed, 3) for speed in pair] for name, pair in speeds.items()}
    if result is not None:
        usage = result.sliding.usage
        fits = zip(names, result.sliding.quality, strict=True)
        identification["sweeps"] = {labels[use.bag]: use.text(names) for use in usage if use.bag in labels}
        identification["fit"] = {name: one.content for name, one in fits if one is not None}
    identification["parameters"] = {
        name: _provenance(one, rounded[name], labels, date, fallback_name) for name, one in named.items()
    }
    check_numbers(identification, LARGEST, "identification")
    source = f"{len(labels)} bag{'s' * (len(labels) != 1)}, {date}; omega_d is not identified"
    source += "" if fallback_name is None else f", it is at most that of {fallback_name}"
    noted = {name: element.replaced(note=notes.get(name)) for name, element in rounded.items()}
    file = FrictionFile.of(
        {"provenance": {"omega_d": "assumed"}, **noted},
        provenance="identified",
        source=source,
        joints=dict(joints),
        identification=identification,
    )
    text = file.text(_REMARKS)
    return in_unit(text, unit)


def _rounded(name: str, one: IdentifiedElement) -> FrictionElement:
    """Return an element with the identified values rounded to six digits; refuse values that no arm has."""
    for parameter, unit in FRICTION_UNITS.items():
        value = one.element.parameters[parameter]
        estimate = one.estimates.get(parameter)
        most = math.inf if parameter == "omega_d" else _LARGEST[unit]
        spread = estimate.deviation if estimate is not None and estimate.identifiable else 0.0
        if not (value <= most and math.isfinite(spread)):
            raise IdentificationError(
                f"{plain(name)}: {parameter} came out as {value:.3g} +- {spread:.2g}; accepted: up to {most:g} {unit}, "
                "with a finite deviation; nothing is written"
            )
    element = one.element.with_parameters({key: digits(value) for key, value in one.element.parameters.items()})
    return element.replaced(provenance=None, source=None)  # of a fallback's file


def _provenance(
    one: IdentifiedElement, element: FrictionElement, labels: dict[BagSource, str], date: str, fallback_name: str | None
) -> dict[str, Any]:
    """Return value, deviation, bags and origin of each parameter of an element."""
    values = element.parameters | {
        f"{name}.{key}": value for name, part in element.parts.items() for key, value in part.numbers().items()
    }
    found = {}
    for name in dict.fromkeys((*PARAMETERS, *one.estimates)):
        estimate = one.estimates.get(name, _NOT_FITTED)
        content = {"provenance": "assumed", "value": values.get(name, 0.0)}
        if not estimate.identifiable:
            there = estimate.reason != NOT_IN_MODEL
            content |= {
                "identifiable": False,
                "reason": estimate.reason,
                "taken_from": fallback_name if there else None,
            }
        elif estimate.deviation:  # otherwise given, not estimated
            interval = [digits(bound) for bound in estimate.bounds]
            content |= {"provenance": "identified", "deviation": digits(estimate.deviation), "interval": interval}
        found[name] = content | {"bags": [labels[bag] for bag in one.sources.get(name, ())], "date": date}
    return found
