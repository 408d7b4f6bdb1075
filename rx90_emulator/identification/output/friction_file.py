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
    PRESLIDING,
    IdentifiedElement,
    ParameterEstimate,
    digits,
)
from rx90_emulator.identification.fitted import ASSUMED
from rx90_emulator.identification.records import in_unit
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
    speeds = {}
    for name, curve in result.curves.items():
        size = np.abs(curve.velocity)
        speeds[name] = [digits(float(size.min()), 3), digits(float(size.max()), 3)]
    return friction_text(result, result.arm.element_names, {"speeds": speeds})


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
    used = [(use, bag) for use, bag in result.bags if use != "validation"]
    labels = {f"bag_{number}": use for number, (use, _) in enumerate(used, 1)}
    bags = {
        label: {"path": str(bag.path), "sha256": bag.sha256, "recorded": bag.recorded}
        for label, (_, bag) in zip(labels, used, strict=True)
    }
    written = {}
    parameters = {}
    for name, identified in zip(names, result.elements, strict=True):
        element = _rounded(identified)
        written[name] = element
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
    return element.replaced(provenance=None, source=None, note=None)


def _provenance(
    identified: IdentifiedElement,
    element: FrictionElement,
    labels: Mapping[str, str],
    date: str,
    fallback: str,
) -> dict[str, Any]:
    """Return value, deviation, bags and origin of each parameter of an element; labels of bags have their uses."""
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
        other = "sliding" if name in PRESLIDING else "presliding"
        known = name in identified.estimates
        bags = [label for label, use in labels.items() if known and use != other]
        parameters[name] = content | {"bags": bags, "date": date}
    return parameters
