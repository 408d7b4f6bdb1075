"""What of a recording is not the arm's, and what it cannot tell: shocks, gaps, smoothed torques, low rates, few rows.

A controller that loses its beat for some milliseconds gives a torque that no model of the arm explains, tens of Nm for
10 to 15 ms, and the parallel filter would spread it over a period of its bandwidth. Such a pulse stands far out of the
torque's usual scatter about its running median, and is over within 30 ms. Where a joint reverses, friction and bristles
give pulses of their own: there it must be half as large as all that the torque does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from rx90_common.base.arrays import Array, Mask
from rx90_emulator.identification.excitation.filtering import Bandwidths, bridged_gap, gaps, smoothed_above
from rx90_emulator.identification.excitation.problem import ExcitationProblem
from rx90_emulator.identification.records import JointRecord

_SHOCK_RATE = 250.0  # samples per second that shocks are sought at, about: means of 4 ms
_SHOCK_WINDOW = 0.06  # s, of the running median: pulses of up to half of it stand out
_SHOCK_OVER_SCATTER = 6.0  # least size over the 97.5th percentile of the scatter
_SHOCK_OVER_RANGE, _REVERSING_SHOCK_OVER_RANGE = 0.1, 0.5  # and over the torque's range; where a joint reverses
_SHOCK_MARGIN = 5e-3  # s, left out on both sides with it
_LOW_RATE = 67.0  # samples per second, of the slowest recordings that intervals are proven for
_SLOW_SPEED, _SLOW_SHARE = 0.05, 0.1  # rad/s, or of the usual speed: below, an element is near a reversal


def without_shocks(record: JointRecord, elements: Array) -> tuple[JointRecord, tuple[str, ...]]:
    """Return a record with the times of its shocks, and in words what was found.

    Args:
        record: of n joints.
        elements: E, joint velocities to those of the friction elements, shape (n_el, n).
    """
    rate = (len(record.time) - 1) / max(float(record.time[-1] - record.time[0]), 1e-9)
    size = max(1, round(rate / _SHOCK_RATE))
    count = len(record.time) // size
    width = round(_SHOCK_WINDOW * rate / size) // 2 * 2 + 1
    if width < 5 or count <= width:  # a pulse would be one sample or none
        return record, ()
    time, velocity, torque = (
        values[: count * size].reshape(count, size, -1).mean(axis=1)
        for values in (record.time, record.velocity, record.torque)
    )
    distance = np.abs(torque - median_filter(torque, size=(width, 1), mode="nearest"))
    reverses = _near_rest(velocity @ elements.T, width) @ (elements != 0.0)
    low, high = np.percentile(torque, (1.0, 99.0), axis=0)
    far = np.zeros(distance.shape, dtype=np.bool_)
    for here, share in ((~reverses, _SHOCK_OVER_RANGE), (reverses, _REVERSING_SHOCK_OVER_RANGE)):
        for joint, rows in enumerate(here.T):
            if rows.any():
                usual = float(np.percentile(distance[rows, joint], 97.5))
                least = max(_SHOCK_OVER_SCATTER * usual, share * float(high[joint] - low[joint]))
                far[:, joint] |= rows & (distance[:, joint] > least)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], far.any(axis=1), [False]]).astype(np.int8)))
    found: list[tuple[float, float]] = []
    texts, half = [], 0.5 * size / rate
    for start, stop in edges.reshape(-1, 2).tolist():
        joint = int(np.argmax(np.where(far[start:stop], distance[start:stop], 0.0).max(axis=0)))
        begin, end = float(time[start, 0]) - half - _SHOCK_MARGIN, float(time[stop - 1, 0]) + half + _SHOCK_MARGIN
        if found and begin <= found[-1][1]:
            found[-1] = (found[-1][0], end)
            continue
        found.append((begin, end))
        height = float(distance[start:stop, joint].max())
        texts.append(f"{height:.3g} Nm at {record.names[joint]} {begin - float(record.time[0]):.3g} s after the begin")
    if not found:
        return record, ()
    lost = 1e3 * sum(end - begin for begin, end in found)
    shown = ", ".join(texts[:6]) + (", ..." if len(texts) > 6 else "")
    what = f"{len(found)} shock{'s' * (len(found) > 1)}"
    text = f"{record.source.name}: {what} of the torque left out, {lost:.0f} ms with margins: {shown}"
    return replace(record, shocks=tuple(found)), (text,)


def _near_rest(velocity: Array, width: int) -> Mask:
    """Return where elements are slow or reverse within a window of so many samples, shape (m, n_el)."""
    least = np.minimum(_SLOW_SPEED, _SLOW_SHARE * np.quantile(np.abs(velocity), 0.9, axis=0))
    turns = np.sign(minimum_filter1d(velocity, width, axis=0)) != np.sign(maximum_filter1d(velocity, width, axis=0))
    return np.asarray(maximum_filter1d((np.abs(velocity) < least) | turns, width, axis=0))


def recording_notes(records: Sequence[JointRecord], bandwidths: Bandwidths) -> tuple[str, ...]:
    """Return, in words, which gaps are bridged or split runs, that torques were smoothed, and which rates are low."""
    found, longest = [], bridged_gap(bandwidths)
    for record in records:
        steps = np.array([record.time[k] - record.time[k - 1] for k in gaps(record.time).tolist()])
        short, name = steps[steps <= longest], record.source.name
        if len(short):
            found.append(
                f"{name}: {len(short)} gap{'s' * (len(short) > 1)} of up to {1e3 * short.max():.3g} ms interpolated, "
                f"short beside the bandwidth of {bandwidths.position:.3g} Hz"
            )
        if len(short) < len(steps):
            found.append(
                f"{name}: {len(steps) - len(short)} gap{'s' * (len(steps) - len(short) > 1)} of up to "
                f"{steps.max():.3g} s split the run; up to {1e3 * longest:.3g} ms would be interpolated"
            )
        rate = (len(record.time) - 1 - len(steps)) / (record.time[-1] - record.time[0] - steps.sum())
        if rate < _LOW_RATE:
            found.append(
                f"warning: {name}: {rate:.3g} samples per second do not tell motion above {0.3 * rate:.3g} Hz, nor "
                f"what is over within {1e3 * 2.0 / rate:.0f} ms of a reversal, as bristles (c0, c1) and narrow "
                f"Stribeck rises; deviations are proven from {_LOW_RATE:g} samples per second on"
            )
    if (edge := smoothed_above(records)) is not None:
        found.append(
            f"the torques were smoothed before they were recorded, from about {edge:.2g} Hz on: what reversals and "
            "faster motion tell is lost, and their noise, which chi^2 compares with, is unknown"
        )
    return tuple(found)


def short_note(problem: ExcitationProblem) -> tuple[str, ...]:
    """Return a warning where there are fewer instants than parameters: nothing averages out over so few."""
    instants = len(np.unique(problem.sample))
    parameters = len(problem.names) + 2 * len(problem.arm.element_names)
    if instants >= parameters:
        return ()
    return (
        f"warning: a short log, {instants} instants for {parameters} parameters: it does not tell single bodies, which "
        "stay near the description's, nor parts of friction beside Coulomb and viscous; deviations are rough",
    )
