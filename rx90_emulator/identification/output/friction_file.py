"""Write what was identified as a friction file that the simulation loads as it is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from typing import Any

from rx90_common.base.config import check_numbers
from rx90_common.base.errors import IdentificationError
from rx90_common.base.quoting import plain
from rx90_common.friction import FrictionElement
from rx90_common.friction.element import FRICTION_UNITS
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.friction.parts.bristles import BristlesPart
from rx90_emulator.identification.estimates import LARGEST, PARAMETERS, IdentifiedElement, ParameterEstimate
from rx90_emulator.identification.identify import FrictionIdentification
from rx90_emulator.identification.presliding.kinds import ElementKind
from rx90_emulator.identification.records import BagSource
from rx90_emulator.identification.sliding.fit import SlidingFit

_REMARKS = """\
#
# Identified from recorded bags. `elements` holds the values that the simulation loads. `identification` says how well
# each of them is known: standard deviation, interval at 95 %, bags, and whether the bags identify it. A value that they
# do not identify is taken from elsewhere, and is an assumption.
"""
_LARGEST = {"Nm": 1e6, "rad/s": 1e4, "1": 1e3, "Nm/rad": 1e12, "Nm s/rad": 1e9, "Nm (s/rad)^alpha": 1e6}
"""Of values with these units: orders of magnitude beyond any arm's, and no result of a fit that went well."""
_NOT_FITTED = ParameterEstimate.unknown("the model that was fitted does not have it")


def friction_text(result: FrictionIdentification, now: datetime | None = None) -> str:
    """Return the file's text.

    Args:
        result: what was identified.
        now: date of the identification; by default the present.

    Raises:
        ConfigError: for values or deviations that are not finite, or absurd.
    """
    return elements_text(
        result.arm.element_names, result.elements, result.fallback_name, now, result.sliding, result.kinds
    )


def elements_text(
    names: Sequence[str],
    elements: Sequence[IdentifiedElement],
    fallback_name: str | None,
    now: datetime | None = None,
    sliding: SlidingFit | None = None,
    kinds: Sequence[ElementKind] = (),
) -> str:
    """Return the text of a file with these elements.

    Args:
        names: of the elements.
        elements: what was identified of each.
        fallback_name: file of the values that stand in for parameters that are not identifiable, if any.
        now: date of the identification; by default the present.
        sliding: fit of sweeps, whose use of the bags and goodness go into the file; None without sweeps.
        kinds: how the kind of each element's bristles was chosen; empty where it was not asked for.

    Raises:
        IdentificationError: for a value that no arm has, or that is no number.
        ConfigError: for a deviation that is absurd.
    """
    for name, one in zip(names, elements, strict=True):
        _check(name, one)
    date = (now or datetime.now(timezone.utc)).isoformat(timespec="seconds")
    sources: dict[BagSource, str] = {}
    for bags in (*(bags for one in elements for bags in one.sources.values()), *(kind.sources for kind in kinds)):
        for bag in bags:
            sources.setdefault(bag, f"bag_{len(sources) + 1}")
    source = f"{len(sources)} bags, {date}; omega_d is not identified"
    identification = {
        "date": date,
        "bags": {
            label: {"path": str(bag.path), "sha256": bag.sha256, "recorded": bag.recorded}
            for bag, label in sources.items()
        },
        **({} if sliding is None else _sweeps(sliding, names, sources)),
        **({"bristles": {kind.element: _kind(kind, sources) for kind in kinds}} if kinds else {}),
        "parameters": {
            name: _provenance(one, sources, date, fallback_name) for name, one in zip(names, elements, strict=True)
        },
    }
    check_numbers(identification, LARGEST, "identification")
    return FrictionFile(
        {name: _rounded_element(one) for name, one in zip(names, elements, strict=True)},
        "identified",
        source if fallback_name is None else f"{source}, it is that of {fallback_name}",
        identification,
        about=_notes(names, elements, fallback_name, kinds),
    ).text(_REMARKS)


def _notes(
    names: Sequence[str], elements: Sequence[IdentifiedElement], fallback_name: str | None, kinds: Sequence[ElementKind]
) -> dict[str, dict[str, str]]:
    """Return what is said of the bristles of each element where they were looked for, or are the fallback's."""
    said = {kind.element: f"bristles: {kind.text}" for kind in kinds}
    for name, one in zip(names, elements, strict=True):
        if one.given_bristles:
            taken = f"as its c0 those of {fallback_name}, assumed"
            said[name] = f"{said[name]}; {taken}" if name in said else f"bristles: {taken}"
    return {name: {"note": text} for name, text in said.items()}


def _sweeps(sliding: SlidingFit, names: Sequence[str], labels: Mapping[BagSource, str]) -> dict[str, Any]:
    """Return what was used of each bag of sweeps, and how well the curves fit."""
    named = zip(names, sliding.quality, strict=True)
    return {
        "sweeps": {labels[use.bag]: use.text(names) for use in sliding.usage if use.bag in labels},
        "fit": {name: one.content for name, one in named if one is not None},
    }


def _kind(kind: ElementKind, labels: Mapping[BagSource, str]) -> dict[str, Any]:
    """Return how the kind of an element's bristles was chosen."""
    found: dict[str, Any] = {"decision": kind.decision}
    if kind.reason:
        found["reason"] = kind.reason
    if kind.choice is not None:
        found["tried"] = {
            trial.family.name: {"missed": _rounded(trial.missed), "behind": _rounded(trial.behind)}
            for trial in kind.choice.trials
        }
        found["bags"] = [labels[bag] for bag in kind.sources]
    return found


def _check(name: str, one: IdentifiedElement) -> None:
    for parameter in FRICTION_UNITS:
        value = getattr(one.element, parameter)
        most = math.inf if parameter == "omega_d" else _LARGEST[FRICTION_UNITS[parameter]]
        estimate = one.estimates.get(parameter)
        spread = estimate.deviation if estimate is not None and estimate.identifiable else 0.0
        if not (value <= most and math.isfinite(spread)):
            raise IdentificationError(
                f"{plain(name)}: {parameter} came out as {value:.3g} +- {spread:.2g}; accepted: up to {most:g} "
                f"{FRICTION_UNITS[parameter]}, with a finite deviation; nothing is written"
            )


def _provenance(
    one: IdentifiedElement, labels: dict[BagSource, str], date: str, fallback_name: str | None
) -> dict[str, Any]:
    element = _rounded_element(one)
    values = vars(element) | {
        f"{name}.{key}": value for name, part in element.parts.items() for key, value in part.numbers().items()
    }
    names = [*PARAMETERS, *(name for name in one.estimates if name not in PARAMETERS)]
    bags = {name: [labels[bag] for bag in one.sources.get(name, ())] for name in names}
    estimates = {name: one.estimates.get(name, _NOT_FITTED) for name in names}
    # A part that is not known is left out, whatever the fallback has: its values are 0. But bristles go with c0.
    from_there = [name for name in names if "." not in name or (one.given_bristles and name.startswith("bristles."))]
    taken = {name: fallback_name if name in from_there else None for name in names}
    return {name: _parameter(values.get(name, 0.0), estimates[name], bags[name], date, taken[name]) for name in names}


def _parameter(
    value: float, estimate: ParameterEstimate, bags: Sequence[str], date: str, fallback_name: str | None
) -> dict[str, Any]:
    if not estimate.identifiable:
        return {
            "provenance": "assumed", "value": value, "identifiable": False, "reason": estimate.reason,
            "taken_from": fallback_name, "bags": list(bags), "date": date,
        }  # fmt: skip
    if not estimate.deviation:  # given, not estimated
        return {"provenance": "assumed", "value": value, "bags": list(bags), "date": date}
    return {
        "provenance": "identified",
        "value": value,
        "deviation": _rounded(estimate.deviation),
        "interval": [_rounded(bound) for bound in estimate.bounds],
        "bags": list(bags),
        "date": date,
    }


def _rounded(value: float) -> float:
    """Return six digits: what is beyond them is far below any standard deviation."""
    return float(f"{value:.6g}")


def _rounded_element(one: IdentifiedElement) -> FrictionElement:
    element = one.element
    values: dict[str, Any] = {name: _rounded(getattr(element, name)) for name in FRICTION_UNITS}
    if element.bristles is not None and not one.given_bristles:
        values["bristles"] = _rounded_bristles(element.bristles)
    return replace(element, **values)


def _rounded_bristles(bristles: BristlesPart) -> BristlesPart:
    """Return them with six digits; numbers of a list still sum to 1."""
    values: dict[str, Any] = {}
    for name, value in vars(bristles).items():
        if isinstance(value, tuple):
            digits = [_rounded(each) for each in value]
            largest = digits.index(max(digits))  # a small one could be less than what rounding the others leaves
            digits[largest] = round(1.0 - math.fsum(digits[:largest] + digits[largest + 1 :]), 12)
            values[name] = tuple(digits)
        else:
            values[name] = _rounded(value)
    return replace(bristles, **values)
