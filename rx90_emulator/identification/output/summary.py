"""The result as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rx90_emulator.identification.presliding.kinds import ElementKind, decisions
from rx90_emulator.identification.result.identification import FrictionIdentification, shown_parameters
from rx90_emulator.identification.result.validation import Validation


def identification_summary(result: FrictionIdentification) -> str:
    """Return values with deviations, true ones below, what is not identifiable and why, and the verdicts."""
    width = max(10, *(len(name) + 1 for name in result.arm.element_names))
    parameters, others = shown_parameters(result), []
    lines = [f"{'element':<{width}}" + "".join(f"{name:>22}" for name in parameters)]
    for name, one in zip(result.arm.element_names, result.elements, strict=True):
        if name not in result.told:
            others.append(name)
            continue
        cells = []
        for parameter in parameters:
            estimate = one.estimates.get(parameter)
            if estimate is None:
                cells.append(f"{'1':>22}")
                continue
            text = " +- ".join(estimate.texts()) if estimate.identifiable else "not identifiable"
            cells.append(f"{text:>22}")
        lines.append(f"{name:<{width}}" + "".join(cells))
        if name in result.truth:
            true = (f"{getattr(result.truth[name], parameter):.6g}" for parameter in parameters)
            lines.append(f"{'  true':<{width}}" + "".join(f"{value:>22}" for value in true))
    if others:
        lines.append(f"{', '.join(others)}: nothing identified")
    reasons = [f"not identifiable: {which(names)}: {reason}" for reason, names in result.unidentifiable.items()]
    verdicts = [_verdict(check, result.scope) for check in result.validations]
    return "\n".join([*lines, *reasons, *_kinds(result.kinds), *_given(result), *_fit(result), *verdicts])


def _kinds(kinds: Sequence[ElementKind]) -> list[str]:
    """Return what each kind of bristles misses in micro-oscillations that it was not fitted to, and the decisions."""
    compared = [kind for kind in kinds if kind.choice is not None]
    lines = []
    if compared:
        width = max(10, *(len(kind.element) + 1 for kind in kinds))
        families = [trial.family.name for kind in compared[:1] if kind.choice for trial in kind.choice.trials]
        lines.append("bristles: missed of the friction torque (standard errors behind the best kind)")
        lines.append(f"{'element':<{width}}" + "".join(f"{name:>25}" for name in families))
        for kind in compared:
            assert kind.choice is not None
            cells = [f"{trial.missed:.1%} ({trial.behind:.1f})" for trial in kind.choice.trials]
            lines.append(f"{kind.element:<{width}}" + "".join(f"{cell:>25}" for cell in cells))
    return [*lines, *(f"bristles of {names}: {text}" for names, text in decisions(kinds))]


def _given(result: FrictionIdentification) -> list[str]:
    """Return in a line whose bristles are the fallback's, of another kind than LuGre's."""
    names = ", ".join(result.with_given_bristles)
    return [f"bristles of {names}: as c0 those of {result.fallback_name}, assumed"] if names else []


def _fit(result: FrictionIdentification) -> list[str]:
    """Return how well the curves fit, and what was used of each bag of sweeps."""
    names = result.arm.element_names
    named = zip(names, result.sliding.quality, strict=True)
    quality = [line for name, one in named if one is not None for line in one.lines(name)]
    zeros = result.sliding.zeros
    noticed = [zeros.text] if zeros is not None and zeros.text else []
    return [*quality, *noticed, *(f"{use.bag.path}: {use.text(names)}" for use in result.sliding.usage)]


def check_summary(checks: Sequence[Validation]) -> str:
    """Return a table of the joints and the verdict for each bag that a friction file was held against."""
    lines = []
    for check in checks:
        width = max(8, *(len(name) + 1 for name in check.names))
        lines.append(f"{'joint':<{width}}{'RMS, Nm':>10}{'of torque':>11}{'worst, Nm':>11}{'of largest':>12}")
        rows = zip(check.names, check.rms, check.rms_share, check.worst, check.worst_share, strict=True)
        lines += [
            f"{name:<{width}} {rms:>9.3f} {rms_share:>10.2%} {worst:>10.3f} {worst_share:>11.2%}"
            for name, rms, rms_share, worst, worst_share in rows
        ]
        if check.zeros is not None and check.zeros.text:
            lines.append(check.zeros.text)
        lines.append(_verdict(check))
    return "\n".join(lines)


def which(lacking: Mapping[str, Sequence[str]]) -> str:
    """Return parameters with the elements that lack them, elements that lack the same ones together."""
    together: dict[str, list[str]] = {}
    for name, parameters in lacking.items():
        together.setdefault(", ".join(parameters), []).append(name)
    return "; ".join(f"{parameters} of {', '.join(names)}" for parameters, names in together.items())


def _verdict(check: Validation, scope: str = "") -> str:
    limits = check.tolerances
    joint = int(check.rms_share.argmax())
    worst = int(check.worst_share.argmax())
    tip = (
        "no set-points, so no tip path"
        if not len(check.tip_distance)
        else f"tip worst {check.tip_worst * 1e6:.2f} um (limit {limits.tip * 1e6:g}), RMS {check.tip_rms * 1e6:.2f} um"
    )
    return (
        f"validation {check.source}: {'confirmed' if check.passed else 'NOT CONFIRMED'}{scope}: torque RMS "
        f"{check.rms_share[joint]:.2%} ({check.names[joint]}, limit {limits.torque:.0%}), worst "
        f"{check.worst_share[worst]:.2%} ({check.names[worst]}, limit {limits.worst_torque:.0%}); {tip}"
    )
