"""Write identified friction as a friction file that the simulation loads as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import Any

import numpy as np

from rx90_common.base.config import check_numbers
from rx90_common.base.quoting import counted
from rx90_common.friction import FrictionElement
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
from rx90_emulator.identification.records import BagSource, in_unit
from rx90_emulator.identification.result import FrictionIdentification

_REMARKS = """\
#
# Identified from recorded bags. `elements` holds the values that the simulation loads. `identification` says how well
# each of them is known: standard deviation, interval at 95 %, bags, and whether the bags identify it. A value that they
# do not identify is taken from elsewhere, and is an assumption.
"""
_NOT_FITTED = ParameterEstimate.unknown("the model that was fitted does not have it")


@dataclass(frozen=True, eq=False)
class FileFacts:
    """What a friction file says beside its elements.

    Attributes:
        fallback: file of the values that replace parameters that are not identifiable, if any.
        date: of the identification; by default the present.
        joints: torques beside links and friction, as in `FrictionFile.joints`.
        notes: why an element's values cannot be trusted, by its name.
        about: of the identification as a whole, as plain data.
        unit: of the torques, if they are currents.
    """

    fallback: str | None = None
    date: datetime | None = None
    joints: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)
    about: Mapping[str, Any] = field(default_factory=dict)
    unit: str = "Nm"


def friction_text(result: FrictionIdentification) -> str:
    """Return the text of the file of an identification from sweeps; errors as in `elements_text`."""
    names = result.arm.element_names
    speeds = {}
    fit = {}
    for name, curve in result.curves.items():
        size = np.abs(curve.velocity)
        speeds[name] = [digits(float(size.min()), 3), digits(float(size.max()), 3)]
        fit[name] = {
            "rms": digits(curve.rms, 4),
            "share": digits(curve.share, 4),
            "chi2": digits(curve.chi2, 4),
        }
    used = {use.bag.path.name: use.text(names) for use in result.sliding.usage}
    facts = FileFacts(
        fallback=result.robot.fallback_name or ASSUMED,
        about={"speeds": speeds, "sweeps": used, "fit": fit},
    )
    return elements_text(names, result.elements, facts)


def elements_text(
    names: Sequence[str], elements: Sequence[IdentifiedElement], facts: FileFacts = FileFacts()
) -> str:
    """Return the text of a file with these elements.

    Args:
        names: of the elements.
        elements: identified values of each.
        facts: on the identification.
    """
    date = (facts.date or datetime.now(timezone.utc)).isoformat(timespec="seconds")
    used = [bag for element in elements for bags in element.sources.values() for bag in bags]
    labels = {bag: f"bag_{number}" for number, bag in enumerate(dict.fromkeys(used), 1)}
    bags = {
        label: {"path": str(bag.path), "sha256": bag.sha256, "recorded": bag.recorded}
        for bag, label in labels.items()
    }
    written = {}
    parameters = {}
    for name, identified in zip(names, elements, strict=True):
        element = _rounded(identified)
        written[name] = element.replaced(note=facts.notes.get(name))
        parameters[name] = _provenance(identified, element, labels, date, facts.fallback)
    unit = {} if facts.unit == "Nm" else {"unit": facts.unit}
    identification = {"date": date, "bags": bags, **unit, **facts.about, "parameters": parameters}
    check_numbers(identification, LARGEST, "identification")
    source = f"{counted(len(labels), 'bag')}, {date}; omega_d is not identified"
    if facts.fallback is not None:
        source += f", it is at most that of {facts.fallback}"
    file = FrictionFile.of(
        {"provenance": {"omega_d": "assumed"}, **written},
        provenance="identified",
        source=source,
        joints=dict(facts.joints),
        identification=identification,
    )
    return in_unit(file.text(_REMARKS), facts.unit)


def _rounded(identified: IdentifiedElement) -> FrictionElement:
    """Return an element with the identified values rounded to six digits, without the remarks of a fallback's file."""
    values = {key: digits(value) for key, value in identified.element.parameters.items()}
    return identified.element.with_parameters(values).replaced(provenance=None, source=None)


def _provenance(
    identified: IdentifiedElement,
    element: FrictionElement,
    labels: Mapping[BagSource, str],
    date: str,
    fallback: str | None,
) -> dict[str, Any]:
    """Return value, deviation, bags and origin of each parameter of an element."""
    parameters = {}
    for name in PARAMETERS:
        estimate = identified.estimates.get(name, _NOT_FITTED)
        content: dict[str, Any] = {"provenance": "assumed", "value": element.parameters[name]}
        if not estimate.identifiable:
            taken = None if estimate.reason == NOT_IN_MODEL else fallback
            content |= {"identifiable": False, "reason": estimate.reason, "taken_from": taken}
        elif estimate.deviation:  # otherwise given, not estimated
            interval = [digits(bound) for bound in estimate.bounds]
            content |= {
                "provenance": "identified",
                "deviation": digits(estimate.deviation),
                "interval": interval,
            }
        bags = [labels[bag] for bag in identified.sources.get(name, ())]
        parameters[name] = content | {"bags": bags, "date": date}
    return parameters
