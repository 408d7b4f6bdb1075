"""From records to a complete friction set: sliding first, then presliding with the sliding regime given."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rx90_common.base.errors import IdentificationError
from rx90_common.friction import LuGreElement
from rx90_emulator.identification.estimate import PARAMETERS, PRESLIDING, ElementEstimate, Estimate, Source
from rx90_emulator.identification.presliding.fit import PreslidingFit, identify_presliding
from rx90_emulator.identification.records.record import JointRecord
from rx90_emulator.identification.rigid_arm import RigidArm
from rx90_emulator.identification.sliding.fit import SlidingFit, identify_sliding

_ANY_BRISTLE = {"c0": 1e4, "c1": 0.0}


@dataclass(frozen=True, eq=False)
class IdentifiedElement:
    """One friction element with what is known about each of its parameters.

    Attributes:
        element: values to simulate with.
        estimates: by the names in PARAMETERS.
        sources: the bags each parameter rests on.
    """

    element: LuGreElement
    estimates: dict[str, Estimate]
    sources: dict[str, tuple[Source, ...]]


@dataclass(frozen=True, eq=False)
class Identification:
    """The result.

    Attributes:
        arm: whose elements these are.
        elements: in the order of the arm's.
        sliding: the fit of the sliding regime.
        presliding: the fit of the presliding regime.
    """

    arm: RigidArm
    elements: tuple[IdentifiedElement, ...]
    sliding: SlidingFit
    presliding: PreslidingFit

    @property
    def lugre(self) -> tuple[LuGreElement, ...]:
        """Return the elements to simulate with."""
        return tuple(one.element for one in self.elements)


def identify(
    sliding: Sequence[JointRecord],
    presliding: Sequence[JointRecord],
    arm: RigidArm,
    fallback: Sequence[LuGreElement] | None,
    torque_delay: float = 0.0,
    step: Callable[[str], None] = lambda _: None,
    plant_period: float | None = None,
) -> Identification:
    """Identify all elements of an arm.

    Args:
        sliding: sweeps at constant velocity.
        presliding: micro-oscillations; without any, c0 and c1 are not told.
        arm: rigid-body model.
        fallback: elements whose values stand in for what the data do not tell, and whose omega_d is taken over; None
            to refuse such data.
        torque_delay: how much later than its stamp a recorded torque acted, s.
        step: called with a word before each step.
        plant_period: as in `identify_presliding`.

    Raises:
        IdentificationError: if the data do not fit or do not suffice.
    """
    step("sliding regime")
    slid = identify_sliding(sliding, arm)
    # Not yet known parameters are irrelevant for the sliding part of an element.
    known = [_merged(est, None, _standing(fallback, e), _ANY_BRISTLE) for e, est in enumerate(slid.estimates)]
    step("presliding regime")
    covariances = [estimate.covariance() for estimate in slid.estimates]
    bent = (
        identify_presliding(presliding, arm, known, torque_delay, covariances, plant_period)
        if presliding
        else _not_bent(arm)
    )
    elements = []
    for e, (first, second) in enumerate(zip(slid.estimates, bent.estimates, strict=True)):
        element = _merged(first, second, _standing(fallback, e), {})
        estimates = {**first.parameters, **second.parameters}
        sources = dict.fromkeys(first.parameters, first.sources) | dict.fromkeys(second.parameters, second.sources)
        elements.append(IdentifiedElement(element, estimates, sources))
    return Identification(arm, tuple(elements), slid, bent)


def _not_bent(arm: RigidArm) -> PreslidingFit:
    unknown = dict.fromkeys(PRESLIDING, Estimate.unknown("no bag with micro-oscillations was given"))
    nothing = np.full((len(PRESLIDING), len(PRESLIDING)), np.nan)
    return PreslidingFit(tuple(ElementEstimate(name, unknown, nothing, ()) for name in arm.element_names), (), 0)


def _standing(fallback: Sequence[LuGreElement] | None, index: int) -> LuGreElement | None:
    return None if fallback is None else fallback[index]


def _merged(
    sliding: ElementEstimate,
    presliding: ElementEstimate | None,
    fallback: LuGreElement | None,
    given: dict[str, float],
) -> LuGreElement:
    """Return the element; what the data do not tell comes from the fallback."""
    estimates = {**sliding.parameters, **({} if presliding is None else presliding.parameters)}
    values = dict(given)
    for name in PARAMETERS:
        estimate = estimates.get(name)
        if estimate is not None and estimate.identifiable:
            values[name] = estimate.value
        elif name not in values:
            if fallback is None:
                reason = "" if estimate is None else f" ({estimate.reason})"
                raise IdentificationError(
                    f"{sliding.element}: the bags do not tell {name}{reason}; accepted: bags that do, or "
                    "--fallback with a friction file for such values"
                )
            values[name] = float(getattr(fallback, name))
    for sign in ("positive", "negative"):
        # A fallback's static torque may lie below an identified Coulomb torque.
        values[f"tau_s_{sign}"] = max(values[f"tau_s_{sign}"], values[f"tau_c_{sign}"])
    if fallback is not None:
        values["omega_d"] = fallback.omega_d
    return LuGreElement(**values)
