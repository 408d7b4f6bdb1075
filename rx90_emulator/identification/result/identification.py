"""From records to the friction of all elements: the sliding regime first, then presliding with sliding given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from rx90_common.base.errors import IdentificationError
from rx90_common.friction import FrictionElement, FrictionSet
from rx90_emulator.identification.model.estimates import (
    PARAMETERS,
    PRESLIDING,
    SLIDING,
    VISCOUS_EXPONENT,
    ElementEstimate,
    ParameterEstimate,
)
from rx90_emulator.identification.model.rigid_arm import RigidArm
from rx90_emulator.identification.model.robot import RecordedRobot
from rx90_emulator.identification.presliding.fit import PreslidingFit, identify_presliding
from rx90_emulator.identification.presliding.kinds import ElementKind, choose_kinds
from rx90_emulator.identification.records.record import BagSource, JointRecord
from rx90_emulator.identification.result.validation import Validation
from rx90_emulator.identification.sliding.fit import SlidingFit, identify_sliding

_ANY_BRISTLE = {"c0": 1e4, "c1": 0.0}


@dataclass(frozen=True, eq=False)
class IdentifiedElement:
    """One friction element with what is known about each of its parameters.

    Attributes:
        element: values to simulate with.
        estimates: by the names in PARAMETERS, without the viscous exponent where it is 1; those of a part by names
            such as bristles.break_away.
        sources: the bags each parameter rests on.
        given_bristles: whether its bristles are those of the fallback, of another kind than LuGre's, as its c0 is.
    """

    element: FrictionElement
    estimates: dict[str, ParameterEstimate]
    sources: dict[str, tuple[BagSource, ...]]
    given_bristles: bool = False

    @classmethod
    def of(
        cls,
        element: FrictionElement,
        estimates: Mapping[str, ParameterEstimate],
        sources: dict[str, tuple[BagSource, ...]],
        fallback: FrictionElement | None,
    ) -> IdentifiedElement:
        """Return an element with the fallback's bristles where its c0 is the fallback's: they belong together.

        Args:
            element: its own bristles, if it has any, were identified, and stay.
            estimates: of it.
            sources: of the estimates.
            fallback: where values that are not identifiable come from; None without one, or where LuGre's are told.
        """
        part = None if fallback is None else fallback.bristles
        if part is None or element.bristles is not None or _identified(estimates, "c0"):
            return cls(element, dict(estimates), sources)
        unknown = ParameterEstimate.unknown("it goes with c0, which is not identified")
        numbers = {f"{part.name}.{name}": unknown for name in part.numbers()}
        return cls(replace(element, bristles=part), {**estimates, **numbers}, sources, given_bristles=True)

    def value(self, name: str) -> float:
        """Return what the element has under the name of an estimate."""
        part, _, key = name.rpartition(".")
        return float(self.element.parts[part].numbers()[key] if part else getattr(self.element, name))


@dataclass(frozen=True, eq=False)
class FrictionIdentification:
    """The identified friction of an arm.

    Attributes:
        arm: whose elements these are.
        elements: in the order of the arm's.
        sliding: the fit of the sliding regime.
        presliding: the fit of the presliding regime.
        fallback_name: file of the values that stand in for parameters that are not identifiable, if any.
        bags: what was read, by use: sliding, presliding, validation.
        validations: comparisons with bags that were not used.
        kinds: of the elements' bristles; empty where it was not asked for.
        truth: of emulated runs, the elements that made them, by name; empty where none are known.
    """

    arm: RigidArm
    elements: tuple[IdentifiedElement, ...]
    sliding: SlidingFit
    presliding: PreslidingFit
    fallback_name: str | None = None
    bags: tuple[tuple[str, BagSource], ...] = ()
    validations: tuple[Validation, ...] = ()
    kinds: tuple[ElementKind, ...] = ()
    truth: Mapping[str, FrictionElement] = field(default_factory=dict)

    @property
    def lugre(self) -> tuple[FrictionElement, ...]:
        """Return the elements to simulate with."""
        return tuple(one.element for one in self.elements)

    @property
    def friction(self) -> FrictionSet:
        """Return the friction to simulate this project's robot with.

        Raises:
            ConfigError: for another robot's number of elements.
        """
        return FrictionSet(self.arm.element_names, self.lugre)

    @property
    def with_given_bristles(self) -> tuple[str, ...]:
        """Return the elements whose bristles are those of the fallback, of another kind than LuGre's."""
        named = zip(self.arm.element_names, self.elements, strict=True)
        return tuple(name for name, one in named if one.given_bristles)

    @property
    def confirmed(self) -> bool:
        """Return whether every validation agrees; True without any."""
        return all(check.passed for check in self.validations)

    @property
    def told(self) -> tuple[str, ...]:
        """Return the elements of which the bags identify any parameter."""
        named = zip(self.arm.element_names, self.elements, strict=True)
        return tuple(name for name, one in named if any(each.identifiable for each in one.estimates.values()))

    @property
    def scope(self) -> str:
        """Return what a verdict is about, " for joint_3, with 54 of 63 values assumed"; "" where none is assumed."""
        estimates = [each for one in self.elements for each in one.estimates.values()]
        assumed = sum(not each.identifiable for each in estimates)
        return f" for {', '.join(self.told)}, with {assumed} of {len(estimates)} values assumed" if assumed else ""

    @property
    def unidentifiable(self) -> dict[str, dict[str, list[str]]]:
        """Return the parameters that the bags do not identify, by reason and element."""
        lacking: dict[str, dict[str, list[str]]] = {}
        for name, one in zip(self.arm.element_names, self.elements, strict=True):
            for parameter, estimate in one.estimates.items():
                if not estimate.identifiable:
                    lacking.setdefault(estimate.reason, {}).setdefault(name, []).append(parameter)
        return lacking


def shown_parameters(result: FrictionIdentification) -> tuple[str, ...]:
    """Return the parameters that tables show: the viscous exponent only where an element has one."""
    return tuple(name for name in PARAMETERS if any(name in one.estimates for one in result.elements))


def identify_records(
    sliding: Sequence[JointRecord],
    presliding: Sequence[JointRecord],
    robot: RecordedRobot,
    progress: Callable[[str], None] = lambda _: None,
    *,
    bristle_kinds: bool = False,
) -> FrictionIdentification:
    """Identify the friction of all elements of an arm from records.

    Args:
        sliding: sweeps at constant velocity.
        presliding: micro-oscillations; without any, c0 and c1 are not identifiable.
        robot: rigid-body model, fallback values and the torques' delay.
        progress: called with the name of each step before it.
        bristle_kinds: whether the kind of each element's bristles is found, too; without, they are LuGre's.

    Returns:
        The result, without bags and validations.

    Raises:
        IdentificationError: if the data do not fit or do not suffice.
    """
    arm = robot.arm
    fallback = robot.fallback or (None,) * len(arm.element_names)
    progress("sliding regime")
    slides = identify_sliding(sliding, arm, zero=robot.zero)
    progress("presliding regime")
    if presliding:
        # The sliding regime of an element does not depend on its c0 and c1.
        known = [_merged(one, {}, other, _ANY_BRISTLE) for one, other in zip(slides.estimates, fallback, strict=True)]
        seven = len(SLIDING)  # a viscous exponent does not show in presliding
        covariances = [estimate.covariance()[:seven, :seven] for estimate in slides.estimates]
        cycles = identify_presliding(presliding, arm, known, robot.torque_delay, covariances, robot.plant_period)
    else:
        reason = "no bag with micro-oscillations was given"
        cycles = PreslidingFit(tuple(ElementEstimate.unknown(n, PRESLIDING, reason) for n in arm.element_names), (), 0)
    kinds = choose_kinds(cycles, arm, progress) if bristle_kinds else ()
    elements = []
    for e, (first, second, other) in enumerate(zip(slides.estimates, cycles.estimates, fallback, strict=True)):
        own, sources = _presliding(second, kinds[e] if kinds else None)
        sources |= dict.fromkeys(first.parameters, first.sources)
        element = replace(_merged(first, own, other, {}), bristles=kinds[e].bristles if kinds else None)
        given = None if kinds and kinds[e].told else other
        elements.append(IdentifiedElement.of(element, {**first.parameters, **own}, sources, given))
    return FrictionIdentification(arm, tuple(elements), slides, cycles, robot.fallback_name, kinds=kinds)


def _identified(estimates: Mapping[str, ParameterEstimate], name: str) -> bool:
    return name in estimates and estimates[name].identifiable


def _presliding(
    lugre: ElementEstimate, kind: ElementKind | None
) -> tuple[dict[str, ParameterEstimate], dict[str, tuple[BagSource, ...]]]:
    """Return the estimates of the presliding regime, and the bags of each: those of other bristles where they are told.

    c0 and c1 belong to the bristles: a stiffness that goes with LuGre's is not that of others.
    """
    if kind is None or kind.trial is None:
        return dict(lugre.parameters), dict.fromkeys(lugre.parameters, lugre.sources)
    return kind.trial.estimates, dict.fromkeys(kind.trial.estimates, kind.sources)


def _merged(
    sliding: ElementEstimate,
    presliding: Mapping[str, ParameterEstimate],
    fallback: FrictionElement | None,
    given: Mapping[str, float],
) -> FrictionElement:
    """Return the element; parameters that are not identifiable come from `given`, else from the fallback."""
    estimates = {**sliding.parameters, **presliding}
    values: dict[str, Any] = dict(given)
    for name in PARAMETERS:
        estimate = estimates.get(name)
        if estimate is not None and estimate.identifiable:
            values[name] = estimate.value
        elif name == VISCOUS_EXPONENT and estimate is None:
            values[name] = 1.0
        elif name not in values:
            if fallback is None:
                reason = "" if estimate is None else f" ({estimate.reason})"
                raise IdentificationError(
                    f"{sliding.element}: {name} is not identifiable from these bags{reason}; accepted: bags from which "
                    "it is, or --fallback with a friction file for such values"
                )
            values[name] = float(getattr(fallback, name))
    for sign in ("positive", "negative"):
        # A fallback's static torque may lie below an identified Coulomb torque.
        values[f"tau_s_{sign}"] = max(values[f"tau_s_{sign}"], values[f"tau_c_{sign}"])
    if fallback is not None:
        values["omega_d"] = fallback.omega_d
    return FrictionElement(**values)
