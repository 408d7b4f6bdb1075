"""The report on an identification from excitation runs: one self-contained HTML page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.friction.parameters import FRICTION_UNITS
from rx90_common.report.page import render_page
from rx90_emulator.identification.excitation.friction.estimates import FrictionCurve
from rx90_emulator.identification.excitation.instruments import remark
from rx90_emulator.identification.excitation.result import ExcitationIdentification
from rx90_emulator.identification.excitation.torques import misfits
from rx90_emulator.identification.model.estimates import ParameterEstimate
from rx90_emulator.identification.output.excitation.plots import (
    binned,
    correlation_plot,
    curve_plots,
    spectra_plot,
    speed_plot,
    time_plot,
    torque_plot,
)
from rx90_emulator.identification.output.excitation.robot import torque_constants
from rx90_emulator.identification.output.excitation.summary import friction_columns, gain_warnings, kept_parts, lacking

_CLOSE = 0.95  # correlation from which two parameters are named


def report_page(
    result: ExcitationIdentification, date: datetime, versions: Mapping[str, str], files: Sequence[str]
) -> str:
    """Return the page's text.

    Args:
        result: what was identified.
        date: of the identification.
        versions: of interpreter and libraries.
        files: names of the robot's files, and last what is to be said about them.
    """
    names = result.problem.arm.element_names
    rows = [friction_columns(one.estimates) for one in result.elements]
    shown = list(dict.fromkeys(name for row in rows for name, one in row.items() if one.identifiable))
    checked = [one.torques for one in result.validations]
    longest = max(result.torques, key=lambda run: run.source.duration)
    curves = result.friction.curves()
    return render_page(
        "rx90_emulator.identification.output.excitation",
        "excitation.html.j2",
        result=result,
        date=date.strftime("%Y-%m-%d %H:%M UTC"),
        files=files,
        versions=", ".join(f"{name} {number}" for name, number in versions.items()),
        friction=list(zip(names, rows, strict=True)),
        shown=[(name, _unit(name)) for name in shown],
        kept=kept_parts(result),
        lacking=lacking(result),
        runs=[*(("fitted", run) for run in result.torques), *(("not used", run) for run in checked)],
        drawn=[(run, torque_plot(run)) for run in (checked[:2] or [longest])],
        curves=curve_plots(curves, _measured(result, curves)),
        spectra=spectra_plot(checked or result.torques),
        by_speed=speed_plot(result.speeds),
        misfits=misfits(result.speeds),
        closed_loop=remark(result.instruments),
        other="least squares" if result.instruments.biased else "instruments",
        gains=gain_rows(result),
        gain_warnings=gain_warnings(result),
        by_time=time_plot(result.torques, result.friction.blocks.length),
        correlation=correlation_plot(result.friction.names, result.friction.fit.covariance),
        close=_close(result.friction.names, result.friction.fit.covariance),
        runs_named=[run.source.path.name for run in checked or result.torques],
    )


def gain_rows(result: ExcitationIdentification) -> list[tuple[str, tuple[str, str] | None, str]]:
    """Return for each motor its name, gain with deviation if it was identified, and the torque constant if it has."""
    if result.gains is None:
        return []
    constants = torque_constants(result)
    names, count = result.problem.arm.names, len(result.gains.factor)
    written = [""] * count if constants is None else [f"{value:.4g}" for value in constants.value]
    pairs = zip(result.gains.factor.tolist(), result.gains.deviation.tolist(), strict=True)
    found = [ParameterEstimate(*pair).texts() if math.isfinite(pair[1]) else None for pair in pairs]
    return list(zip(names, found, written, strict=True))


def _unit(name: str) -> str:
    plain = name.rstrip("+-")
    return FRICTION_UNITS.get(plain) or FRICTION_UNITS.get(f"{plain}_positive", "")


def _measured(result: ExcitationIdentification, curves: Sequence[FrictionCurve]) -> list[Array]:
    """Return points beside the curve of each joint's own element: the curve and the residual, means in bins."""
    problem, friction = result.problem, result.friction
    residual = problem.torque - friction.predicted
    points = []
    for number, curve in enumerate(curves):
        rows = np.flatnonzero((problem.joint == number) & ~problem.reversal)
        bins = binned(problem.velocity[rows, number], residual[rows])
        low, high = (curve.velocity.min(), curve.velocity.max()) if len(curve.velocity) else (0.0, 0.0)
        bins = bins[(bins[:, 0] >= low) & (bins[:, 0] <= high)]
        torque = np.interp(bins[:, 0], curve.velocity, curve.torque) if len(bins) else np.empty(0)
        points.append(np.column_stack([bins[:, 0], torque + bins[:, 1]]))
    return points


def _close(names: Sequence[str], covariance: Array) -> list[tuple[str, str, float]]:
    """Return pairs of parameters that the runs hardly tell apart, the closest first."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.nan_to_num(covariance / np.outer(deviation, deviation))
    pairs = [
        (names[i], names[j], float(correlation[i, j]))
        for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > _CLOSE, 1)), strict=True)
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))[:20]
