"""Everything that excitation runs say, as one YAML file for programs and for the record."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from rx90_common.base.arrays import Array
from rx90_common.base.config import check_numbers, yaml_text
from rx90_emulator.identification.estimates import LARGEST, ParameterEstimate
from rx90_emulator.identification.excitation.friction.cross_validation import CrossValidation
from rx90_emulator.identification.excitation.friction.selection import ModelRow
from rx90_emulator.identification.excitation.result import BaseParameter, ExcitationIdentification
from rx90_emulator.identification.excitation.torques import RunTorques, misfits
from rx90_emulator.identification.output.excitation_report import gain_warnings

_HEAD = """\
# Parameters identified from excitation runs, joint side, SI units; deviation: standard deviation, HAC.
# A base parameter is the combination of inertial parameters in `group`: m mass, mx .. mz first moments, Ixx .. Izz
# inertia about the origin of the link's joint, Ia rotor through its gear, k spring, offset of the torque; numbers are
# those of the joints from the base. The robot's own files in this folder hold what the simulation loads.
"""


def parameters_text(result: ExcitationIdentification, date: datetime, versions: Mapping[str, str]) -> str:
    """Return the file's text.

    Args:
        result: what was identified.
        date: of the identification.
        versions: of interpreter and libraries.
    """
    friction = result.friction
    bandwidths = result.problem.runs[0].bandwidths
    other = "least_squares" if result.instruments.biased else "instrumental_variables"
    content = {
        "date": date.isoformat(timespec="seconds"),
        "versions": dict(versions),
        "bags": [
            {"path": str(bag.path), "use": use, "sha256": bag.sha256, "duration": _rounded(bag.duration)}
            for use, bag in result.bags
        ],
        "bandwidths": {
            "position": _rounded(bandwidths.position),
            "torque": _rounded(bandwidths.torque),
            "reason": bandwidths.reason,
        },
        "base_parameters": {one.name: _base(one, other) for one in result.base},
        "friction": {
            name: {parameter: _estimate(estimate) for parameter, estimate in one.estimates.items()}
            for name, one in zip(result.problem.arm.element_names, result.elements, strict=True)
        },
        "models": [_model(row) for row in friction.models],
        "fit": {run.source.path.name: _torques(run) for run in result.torques},
        "validation": {
            one.torques.source.path.name: {
                "confirmed": one.passed,
                **_torques(one.torques),
                "relative_with_consistent_inertias": _rounded(one.consistent.total_share),
            }
            for one in result.validations
        },
        "estimator": "instrumental variables" if result.instruments.biased else "least squares",
        "instrumental_variables": result.instruments.reason,
        **_gains(result),
        "not_determined": list(result.undetermined),
        "misfits": misfits(result.speeds),
        "drifts": [one.text for one in result.trends],
        "remarks": [*friction.remarks, *gain_warnings(result)],
        "correlation": {"names": list(friction.names), "matrix": _correlation(friction.fit.covariance)},
    }
    check_numbers(content, LARGEST)
    return _HEAD + yaml_text(content)


def _rounded(value: float) -> float:
    """Return six digits: what is beyond them is far below any standard deviation."""
    return float(f"{value:.6g}")


def _estimate(estimate: ParameterEstimate) -> dict[str, Any]:
    if not estimate.identifiable:
        return {"identifiable": False, "reason": estimate.reason}
    return {"value": _rounded(estimate.value), "deviation": _rounded(estimate.deviation)}


def _gains(result: ExcitationIdentification) -> dict[str, Any]:
    """Return by what recorded torques were multiplied; nothing where it was not identified."""
    if result.gains is None:
        return {}
    factors, deviations = result.gains.factor.tolist(), result.gains.deviation.tolist()
    content = {
        name: {"true_over_recorded": _rounded(factor), "deviation": _rounded(deviation)}
        if math.isfinite(deviation)
        else {"identifiable": False, "reason": "the payload does not tell it; 1 is taken"}
        for name, factor, deviation in zip(result.problem.arm.names, factors, deviations, strict=True)
    }
    return {"drive_gains": content}


def _base(one: BaseParameter, other: str) -> dict[str, Any]:
    content = {"unit": one.unit, "group": one.group, **_estimate(one.estimate), "consistent": _rounded(one.consistent)}
    if one.other is not None:
        content[other] = _estimate(one.other)
    return content


def _model(row: ModelRow) -> dict[str, Any]:
    content = {
        "name": row.name,
        "parameters": row.parameters,
        "relative_error": _rounded(row.relative_all),
        "cross_validated_by_blocks": _check(row.by_blocks),
        "kept": row.kept,
        "reason": row.reason,
    }
    if row.by_runs is not None:
        content["cross_validated_by_runs"] = _check(row.by_runs)
    return content


def _check(check: CrossValidation) -> dict[str, Any]:
    return {"relative_error": _rounded(check.relative), "gain": _rounded(check.gain),
            "gain_deviation": _rounded(check.gain_deviation)}  # fmt: skip


def _torques(run: RunTorques) -> dict[str, Any]:
    joints = {
        name: {"rms": _rounded(rms), "relative": _rounded(share)}
        | ({} if math.isnan(chi) else {"chi_square": _rounded(chi)})
        for name, rms, share, chi in zip(run.names, run.rms, run.share, run.chi_square, strict=True)
        if math.isfinite(rms)
    }
    return {"relative": _rounded(run.total_share), "joints": joints}


def _correlation(covariance: Array) -> list[list[float | None]]:
    """Return rows of the correlation to three digits; None where a parameter is not determined."""
    deviation = [math.sqrt(value) if 0.0 < value < math.inf else math.nan for value in covariance.diagonal().tolist()]
    rows: list[list[float | None]] = []
    for row, one in zip(covariance.tolist(), deviation, strict=True):
        shares = [value / (one * other) for value, other in zip(row, deviation, strict=True)]
        rows.append([None if math.isnan(share) else round(share, 3) for share in shares])
    return rows
