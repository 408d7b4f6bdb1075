"""From the identified friction to elements that can be simulated: what the runs do not tell is assumed, and marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement
from rx90_emulator.identification.excitation.load_parts import LoadParts
from rx90_emulator.identification.model.estimates import ElementEstimate, ParameterEstimate
from rx90_emulator.identification.result.identification import IdentifiedElement

_PRESLIDING = 2.5e-4  # rad, deflection at break-away where no c0 is known: that of the shipped RX90B's large joints
ASSUMED_BRISTLES = "no file: bristles that break away after 0.25 mrad are assumed"
"""Where c0, c1 and omega_d come from without a fallback, in words."""
_RELAXATION = 1e-3  # s, c1 over c0 where no c1 is known, as there
_FADES = 1.0  # rad/s, omega_d beside such a c1: the element is passive then at every speed
_STRIBECK = {"omega_s": 0.1, "delta": 1.0}  # of no effect while tau_s = tau_c


def simulated_elements(
    estimates: Sequence[ElementEstimate],
    fallback: Sequence[FrictionElement] | None,
    loads: LoadParts | None = None,
) -> tuple[IdentifiedElement, ...]:
    """Return the elements with values for all parameters.

    A part that the model does not have is switched off: tau_s = tau_c, alpha = 1. Bristles, which an arm needs to stand
    still, come from the fallback, else from the presliding distance of large joints; both are assumptions.

    Args:
        estimates: by the names of FrictionElement.
        fallback: elements in the same order; None if there are none.
        loads: the load parts; None where they were not asked for.

    Raises:
        IdentificationError: for an element without an identified Coulomb torque, if there is no fallback.
    """
    others = fallback or (None,) * len(estimates)
    found = []
    for number, (one, other) in enumerate(zip(estimates, others, strict=True)):
        element, known = _element(one.element, one.parameters, other), dict(one.parameters)
        if loads is not None:
            element, known = replace(element, load=loads.part(number)), known | loads.estimates(number)
        found.append(IdentifiedElement.of(element, known, dict.fromkeys(known, one.sources), other))
    return tuple(found)


def _element(name: str, known: Mapping[str, ParameterEstimate], other: FrictionElement | None) -> FrictionElement:
    found: dict[str, Any] = {parameter: one.value for parameter, one in known.items() if one.identifiable}
    for sign in ("positive", "negative"):
        coulomb = f"tau_c_{sign}"
        if found.get(coulomb, 0.0) <= 0.0:
            if other is None:
                reason = known[coulomb].reason if coulomb in known and not known[coulomb].identifiable else "it is 0"
                raise IdentificationError(
                    f"{name}: {coulomb} is not identifiable from these runs ({reason}); accepted: runs in which it is, "
                    "or --fallback with a friction file for such values"
                )
            found[coulomb] = float(getattr(other, coulomb))
        found[f"tau_s_{sign}"] = max(found.get(f"tau_s_{sign}", 0.0), found[coulomb])
    for parameter, value in _STRIBECK.items():
        found.setdefault(parameter, value)
    found.setdefault("c2", 0.0)
    mean = 0.5 * (found["tau_c_positive"] + found["tau_c_negative"])
    found.setdefault("c0", mean / _PRESLIDING if other is None else other.c0)
    if "c1" not in found:
        found["c1"] = found["c0"] * _RELAXATION if other is None else other.c1
        found["omega_d"] = _FADES if other is None else other.omega_d
    return FrictionElement(**found)
