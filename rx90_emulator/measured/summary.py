"""The comparison as a table for the terminal."""

from __future__ import annotations

import math

from rx90_emulator.measured.comparison import MeasuredComparison

_COLUMNS = (
    f"{'torque RMS':>12}{'of measured':>13}{'worst':>11}{'of largest':>12}{'compared':>10}"
    f"{'position RMS':>15}{'worst':>12}"
)


def measured_summary(result: MeasuredComparison) -> str:
    """Return set-points, filters and lag, a row for each joint, and the verdict."""
    width = max(8, *(len(name) + 1 for name in result.names))
    rows = zip(
        result.names,
        result.torque_rms,
        result.torque_share,
        result.torque_worst,
        result.worst_share,
        result.compared_share,
        result.position_rms,
        result.position_worst,
        strict=True,
    )
    table = [
        f"{name:<{width}} {_number(rms, 8)} Nm {_percent(share):>12} {_number(worst, 7)} Nm {_percent(worst_share):>11}"
        f"{part:>10.0%}{1e3 * position:>10.3f} mrad{1e3 * farthest:>7.3f} mrad"
        for name, rms, share, worst, worst_share, part, position, farthest in rows
    ]
    return "\n".join([*facts(result), f"{'joint':<{width}}{_COLUMNS}", *table, verdict(result)])


def facts(result: MeasuredComparison) -> tuple[str, ...]:
    """Return what was simulated and how it was compared, a sentence each."""
    bands, which = result.bandwidths, "later" if result.lag >= 0.0 else "earlier"
    return (
        f"set-points: {result.setpoints}",
        f"torques and positions are compared below {bands.torque:.3g} Hz ({bands.reason})",
        f"the simulated motion is {abs(result.lag) * 1e3:.3f} ms {which}, which is taken out",
        *(
            f"{name}'s motor is at its limit in {share:.1%} of the simulated time"
            for name, share in zip(result.names, result.saturated, strict=True)
            if share > 0.0
        ),
        *result.remarks,
    )


def verdict(result: MeasuredComparison) -> str:
    """Return the verdict, with what decides and its limits."""
    limits = result.tolerances
    share = [-1.0 if math.isnan(one) else float(one) for one in result.torque_share]
    joint, farthest = share.index(max(share)), int(result.position_worst.argmax())
    return (
        f"{result.source.path}: {'agrees' if result.passed else 'DOES NOT AGREE'}: torque RMS of all joints "
        f"{result.total_share:.2%} (limit {limits.total_torque:.3g}), largest {max(share):.2%} "
        f"({result.names[joint]}, limit {limits.torque:.3g}); position "
        f"{1e3 * result.position_worst[farthest]:.3f} mrad ({result.names[farthest]}, limit "
        f"{1e3 * limits.position:.4g} mrad)"
    )


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.2%}"


def _number(value: float, width: int) -> str:
    return f"{'-':>{width}}" if math.isnan(value) else f"{value:>{width}.3f}"
