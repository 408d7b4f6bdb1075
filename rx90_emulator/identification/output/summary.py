"""The result as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rx90_emulator.identification.estimate import PARAMETERS
from rx90_emulator.identification.identify import Identification
from rx90_emulator.identification.output.validation import Validation
from rx90_emulator.identification.output.wording import value_and_deviation


def summary(result: Identification, checks: Sequence[Validation]) -> str:
    """Return values with standard deviations, what the bags do not tell, and the verdicts."""
    width = max(10, *(len(name) + 1 for name in result.arm.element_names))
    lines = [f"{'element':<{width}}" + "".join(f"{name:>22}" for name in PARAMETERS)]
    untold: dict[str, dict[str, list[str]]] = {}
    for name, one in zip(result.arm.element_names, result.elements, strict=True):
        cells = []
        for parameter in PARAMETERS:
            estimate = one.estimates[parameter]
            told = " +- ".join(value_and_deviation(estimate)) if estimate.identifiable else "not told"
            cells.append(f"{told:>22}")
            if not estimate.identifiable:
                untold.setdefault(estimate.reason, {}).setdefault(name, []).append(parameter)
        lines.append(f"{name:<{width}}" + "".join(cells))
    reasons = [f"not told: {_which(names)}: {reason}" for reason, names in untold.items()]
    return "\n".join([*lines, *reasons, *(_verdict(check) for check in checks)])


def _which(untold: Mapping[str, Sequence[str]]) -> str:
    """Return parameters with the elements that lack them, elements that lack the same ones together."""
    together: dict[str, list[str]] = {}
    for name, parameters in untold.items():
        together.setdefault(", ".join(parameters), []).append(name)
    return "; ".join(f"{parameters} of {', '.join(names)}" for parameters, names in together.items())


def _verdict(check: Validation) -> str:
    limits = check.tolerances
    joint = int(check.rms_share.argmax())
    worst = int(check.worst_share.argmax())
    tip = (
        "no set-points, so no tip path"
        if not len(check.tip_distance)
        else f"tip worst {check.tip_worst * 1e6:.2f} um (limit {limits.tip * 1e6:g}), RMS {check.tip_rms * 1e6:.2f} um"
    )
    return (
        f"validation {check.source}: {'confirmed' if check.passed else 'NOT CONFIRMED'}: torque RMS "
        f"{check.rms_share[joint]:.2%} ({check.names[joint]}, limit {limits.torque:.0%}), worst "
        f"{check.worst_share[worst]:.2%} ({check.names[worst]}, limit {limits.worst_torque:.0%}); {tip}"
    )
