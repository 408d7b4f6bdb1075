"""Write identified friction as a friction file that the simulation loads as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np

from rx90_common.base.config import check_numbers
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import counted, plain
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
from rx90_emulator.identification.fitted import ASSUMED
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
_NOT_FITTED = ParameterEstimate.unknown("the model that was fitted does not have it")


@dataclass(frozen=True, eq=False)
class FileFacts:
    """What a friction file says beside its elements.

    Attributes:
        date: of the identification; by default the present.
        joints: torques beside links and friction, as in `FrictionFile.joints`.
        warnings: why an element's values cannot be trusted, by its name.
        speeds: least and greatest speed with data, rad/s, by element.
        sweeps: what was used of each bag of sweeps, in words.
        fit: goodness of fit by element, as plain data.
        bandwidths: of excitation runs, which a validation of the file uses again.
        unit: of the torques, if they are currents.
    """

    date: datetime | None = None
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    warnings: Mapping[str, str] = field(default_factory=dict)
    speeds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    sweeps: Mapping[BagSource, str] = field(default_factory=dict)
    fit: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    bandwidths: Bandwidths | None = None
    unit: str = "Nm"


def friction_text(result: FrictionIdentification) -> str:
    """Return the text of the file of an identification from sweeps; errors as in `elements_text`."""
    names = result.arm.element_names
    sliding = result.sliding
    speeds = {}
    for name, curve in zip(names, sliding.curves, strict=True):
        if curve is not None:
            size = np.abs(curve.velocity)
            speeds[name] = (float(size.min()), float(size.max()))
    facts = FileFacts(
        speeds=speeds,
        sweeps={use.bag: use.text(names) for use in sliding.usage},
        fit={name: fit.content for name, fit in zip(names, sliding.quality, strict=True) if fit is not None},
    )
    return elements_text(names, result.elements, result.fallback_name or ASSUMED, facts)


def elements_text(
    names: Sequence[str],
    elements: Sequence[IdentifiedElement],
    fallback_name: str | None,
    facts: FileFacts = FileFacts(),
) -> str:
    """Return the text of a file with these elements.

    Args:
        names: of the elements.
        elements: identified values of each.
        fallback_name: file of the values that replace parameters that are not identifiable, if any.
        facts: on the identification.
    """
    date = (facts.date or datetime.now(timezone.utc)).isoformat(timespec="seconds")
    named = dict(zip(names, elements, strict=True))
    rounded = {name: _rounded(name, element) for name, element in named.items()}
    used = [bag for element in elements for bags in element.sources.values() for bag in bags]
    labels = {bag: f"bag_{k}" for k, bag in enumerate(dict.fromkeys(used), 1)}
    notes = dict(facts.warnings)
    for name, element in named.items():
        if element.given_bristles:
            bristles = f"bristles: as its c0 those of {fallback_name}, assumed"
            notes[name] = f"{notes[name]}; {bristles}" if name in notes else bristles
    identification: dict[str, Any] = {
        "date": date,
        "bags": {
            label: {"path": str(bag.path), "sha256": bag.sha256, "recorded": bag.recorded}
            for bag, label in labels.items()
        },
    }
    if facts.unit != "Nm":
        identification["unit"] = facts.unit
    if facts.bandwidths is not None:
        position, torque, _ = facts.bandwidths
        identification["bandwidths"] = {"position": float(position), "torque": float(torque)}
    if facts.speeds:
        identification["speeds"] = {name: [digits(speed, 3) for speed in pair] for name, pair in facts.speeds.items()}
    if facts.sweeps:
        identification["sweeps"] = {labels[bag]: text for bag, text in facts.sweeps.items() if bag in labels}
        identification["fit"] = dict(facts.fit)
    identification["parameters"] = {
        name: _provenance(element, rounded[name], labels, date, fallback_name) for name, element in named.items()
    }
    check_numbers(identification, LARGEST, "identification")
    source = f"{counted(len(labels), 'bag')}, {date}; omega_d is not identified"
    if fallback_name is not None:
        source += f", it is at most that of {fallback_name}"
    noted = {name: element.replaced(note=notes.get(name)) for name, element in rounded.items()}
    file = FrictionFile.of(
        {"provenance": {"omega_d": "assumed"}, **noted},
        provenance="identified",
        source=source,
        joints=dict(facts.joints),
        identification=identification,
    )
    return in_unit(file.text(_REMARKS), facts.unit)


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
