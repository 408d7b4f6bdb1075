"""Write identified friction as a friction file that the simulation loads as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from rx90_common.base.config import check_numbers
from rx90_common.base.quoting import counted
from rx90_common.friction import FrictionElement
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.identification.estimates import (
    LARGEST,
    PARAMETERS,
    IdentifiedElement,
    ParameterEstimate,
    digits,
)
from rx90_emulator.identification.fitted import ASSUMED
from rx90_emulator.identification.records import BagSource, in_unit
from rx90_emulator.identification.result import FrictionIdentification, Identification

_REMARKS = """\
#
# Identified from recorded bags. `elements` holds the values that the simulation loads. `identification` says how well
# each of them is known: standard deviation, interval at 95 %, bags, and whether the bags identify it. A value that they
# do not identify is taken from elsewhere, and is an assumption.
"""
_NOT_FITTED = ParameterEstimate.unknown("the model that was fitted does not have it")


def sweeps_text(result: FrictionIdentification) -> str:
    """Return the text of the file of an identification from sweeps; errors as in `friction_text`."""
    names = result.arm.element_names
    speeds = {}
    fit = {}
    for name, curve in result.curves.items():
        size = np.abs(curve.velocity)
        speeds[name] = [digits(float(size.min()), 3), digits(float(size.max()), 3)]
        goodness = {"rms": curve.rms, "share": curve.share, "chi2": curve.chi2}
        fit[name] = {key: digits(value, 4) for key, value in goodness.items()}
    sweeps = {use.bag.path.name: use.text(names) for use in result.sliding.usage}
    return friction_text(result, names, {"speeds": speeds, "sweeps": sweeps, "fit": fit})


def friction_text(
    result: Identification,
    names: Sequence[str],
    about: Mapping[str, Any],
    joints: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
) -> str:
    """Return the text of a file with the identified elements.

    Args:
        result: of the identification.
        names: of the elements.
        about: what the file says of the identification as a whole, as plain data.
        joints: torques beside links and friction, as in `FrictionFile.joints`.
    """
    date = result.date.isoformat(timespec="seconds")
    fallback = result.robot.fallback_name or ASSUMED
    used = [bag for element in result.elements for bags in element.sources.values() for bag in bags]
    labels = {bag: f"bag_{number}" for number, bag in enumerate(dict.fromkeys(used), 1)}
    bags = {
        label: {"path": str(bag.path), "sha256": bag.sha256, "recorded": bag.recorded}
        for bag, label in labels.items()
    }
    notes = result.element_notes
    written = {}
    parameters = {}
    for name, its_name, identified in zip(
        names, result.arm.element_names, result.elements, strict=True
    ):
        element = _rounded(identified)
        written[name] = element.replaced(note=notes.get(its_name))
        parameters[name] = _provenance(identified, element, labels, date, fallback)
    unit = {} if result.unit == "Nm" else {"unit": result.unit}
    identification = {"date": date, "bags": bags, **unit, **about, "parameters": parameters}
    check_numbers(identification, LARGEST, "identification")
    bags_used = counted(len(labels), "bag")
    source = f"{bags_used}, {date}; omega_d is not identified, it is at most that of {fallback}"
    file = FrictionFile.of(
        {"provenance": {"omega_d": "assumed"}, **written},
        provenance="identified",
        source=source,
        joints=dict(joints),
        identification=identification,
    )
    return in_unit(file.text(_REMARKS), result.unit)


def _rounded(identified: IdentifiedElement) -> FrictionElement:
    """Return an element with the identified values rounded to six digits, without the remarks of a fallback's file."""
    values = {key: digits(value) for key, value in identified.element.parameters.items()}
    element = identified.element.with_parameters(values)
    return element.replaced(provenance=None, source=None)


def _provenance(
    identified: IdentifiedElement,
    element: FrictionElement,
    labels: Mapping[BagSource, str],
    date: str,
    fallback: str,
) -> dict[str, Any]:
    """Return value, deviation, bags and origin of each parameter of an element."""
    parameters = {}
    for name in PARAMETERS:
        estimate = identified.estimates.get(name, _NOT_FITTED)
        content: dict[str, Any] = {"provenance": "assumed", "value": element.parameters[name]}
        if not estimate.identifiable:
            content |= {"identifiable": False, "reason": estimate.reason, "taken_from": fallback}
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
