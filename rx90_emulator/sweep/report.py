"""The report of a sweep: one self-contained HTML page on the path error of its runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import SweepError
from rx90_common.base.quoting import plain
from rx90_common.report.page import render_page
from rx90_common.report.plot import COLOURS, GREY, INK, Curve, Dots, Level, Mark, Panel, Plot
from rx90_emulator.loop.parameters import SWITCH
from rx90_emulator.sweep.store import about, failures, read_sweep

_PATH_METRICS = "path_error_worst", "path_error_rms", "along_track_worst", "orientation_worst"
_MILLI = 1e3
_MOST_PANELS = 12  # parameters that are drawn
_MOST_ROWS = 40  # parameters in the table
_MOST_DOTS = 8000  # in all panels
_MOST_WORST = 10
_SHOWN_VALUES = 6  # parameters of a worst run
_MOST_LEVELS = 12  # different values that are levels by themselves; more are put into bins
_BINS = 8


@dataclass(frozen=True, eq=False)
class MainEffect:
    """Means of a metric over the runs that share a value of a parameter, or lie in one part of its range.

    Attributes:
        name: of the parameter's column.
        values: mean value of the parameter at each level, increasing, (levels,).
        means: mean of the metric there, (levels,).
        runs: number of runs that set the parameter.
        share: of the metric's variance over these runs that the levels explain, adjusted for their number (epsilon
            squared; Kelley 1935); 0 where chance alone would explain as much, NaN with one level.
    """

    name: str
    values: Array
    means: Array
    runs: int
    share: float

    @property
    def span(self) -> float:
        """Return the largest mean less the smallest."""
        return float(np.ptp(self.means))


def main_effect(name: str, values: Array, metric: Array) -> MainEffect:
    """Return the main effect of a parameter.

    Args:
        name: of it.
        values: of each run, (runs,); NaN where a run does not set it.
        metric: of each run, (runs,); NaN where it failed.
    """
    known = np.isfinite(values) & np.isfinite(metric)
    x, y = values[known], metric[known]
    distinct = np.unique(x)
    if len(distinct) <= _MOST_LEVELS:
        level = np.searchsorted(distinct, x)
    else:
        level = np.searchsorted(np.quantile(x, np.arange(1, _BINS) / _BINS), x, side="right")
    _, level, counts = np.unique(level, return_inverse=True, return_counts=True)
    means, centres = (np.bincount(level, weights=each) / counts for each in (y, x))
    within = float(np.sum((y - means[level]) ** 2))
    total = float(np.sum((y - y.mean()) ** 2)) if len(y) else 0.0
    share = np.nan
    if len(counts) > 1:
        # With one run at each level there is nothing to tell their scatter from the effect.
        scatter = within * (len(y) - 1) / (len(y) - len(counts)) if len(y) > len(counts) else 0.0
        share = max(0.0, 1.0 - scatter / total) if total else 0.0
    return MainEffect(name, centres, means, len(y), share)


class SweptColumn(NamedTuple):
    """A swept parameter: name of its column, unit ("" for a switch), what it sets, and values, NaN if not set."""

    name: str
    unit: str
    meaning: str
    values: Array


@dataclass(frozen=True, eq=False)
class SweepFigures:
    """What the page shows.

    Attributes:
        about: the metadata of the results.
        index: number of each run.
        block: of each run.
        worst: path error, mm; NaN of failed runs.
        rms: as worst.
        along: largest distance from the set-point along the path, mm; NaN in results that do not have it.
        turned: largest orientation error, mrad; likewise.
        columns: the swept parameters.
        effects: on the worst path error, the largest share first.
        errors: kinds of failures with counts and an example.
    """

    about: Mapping[str, Any]
    index: NDArray[np.int64]
    block: Sequence[str]
    worst: Array
    rms: Array
    along: Array
    turned: Array
    columns: Mapping[str, SweptColumn]
    effects: Sequence[MainEffect]
    errors: Sequence[tuple[str, int, str]]

    @classmethod
    def of(cls, file: Path) -> SweepFigures:
        """Read results, finished or not.

        Raises:
            SweepError: if there are none, they cannot be read, or no run of them has succeeded.
        """
        table = read_sweep(file)
        worst, rms, along, turned = (_MILLI * _numbers(table, name) for name in _PATH_METRICS)
        if not np.isfinite(worst).any():
            raise SweepError(f"{plain(file)}: no run has succeeded; accepted: results with a path error")
        parameters = [field for field in table.schema if field.metadata[b"kind"] == b"parameter"]
        columns = {field.name: _column(table, field) for field in parameters}
        effects = [main_effect(name, column.values, worst) for name, column in columns.items()]
        effects = sorted((one for one in effects if one.runs), key=lambda one: (-np.nan_to_num(one.share), -one.span))
        return cls(about(table.schema, file), table["index"].to_numpy(), table["block"].to_pylist(), worst, rms,
                   along, turned, columns, effects, failures(table))  # fmt: skip


def _numbers(table: pa.Table, name: str) -> Array:
    if name not in table.column_names:
        return np.full(len(table), np.nan)
    column = pc.cast(table[name], pa.float64())
    return np.asarray(column.fill_null(np.nan).to_numpy(), dtype=np.float64)


def _column(table: pa.Table, field: pa.Field) -> SweptColumn:
    unit, meaning = (field.metadata[key].decode() for key in (b"unit", b"meaning"))
    if pa.types.is_boolean(field.type):
        table, unit = pa.table({field.name: pc.cast(table[field.name], pa.int8())}), SWITCH
    return SweptColumn(field.name, unit, meaning.partition(";")[0], _numbers(table, field.name))


def sweep_page(file: Path) -> str:
    """Return the text of the page on a file of results.

    Raises:
        SweepError: as `SweepFigures.of`.
    """
    figures = SweepFigures.of(file)
    good = figures.worst[np.isfinite(figures.worst)]
    drawn = figures.effects[:_MOST_PANELS]
    shown = _sampled(figures.worst, _MOST_DOTS // max(1, len(drawn)))
    return render_page(
        "rx90_emulator.sweep",
        "sweep.html.j2",
        name=file.name,
        about=figures.about,
        plan=figures.about["plan"],
        provenance=figures.about.get("provenance", {}),
        done=len(figures.worst),
        good=len(good),
        median=float(np.median(good)),
        percentile=float(np.quantile(good, 0.95)),
        largest=float(good.max()),
        worst_run=int(figures.index[int(np.nanargmax(figures.worst))]),
        distribution=distribution_plot(figures),
        effects=effects_plot(figures, drawn, shown) if drawn else None,
        sampled=len(shown) if len(shown) < len(good) else 0,
        rows=[(one, figures.columns[one.name]) for one in figures.effects[:_MOST_ROWS]],
        left_out=max(0, len(figures.effects) - _MOST_ROWS),
        panels=len(drawn),
        worst=list(_worst_runs(figures)),
        errors=figures.errors,
    )


def distribution_plot(figures: SweepFigures) -> Plot:
    """Show which share of the runs stays below a path error, for the worst and the RMS error of each run."""
    curves: list[Curve | Level] = [Level(0.5, "median", GREY, "dotted")]
    for values, label, colour in ((figures.worst, "worst", COLOURS[1]), (figures.rms, "RMS", COLOURS[0])):
        known = np.sort(values[np.isfinite(values)])
        share = np.arange(1, len(known) + 1) / len(known)
        curves.append(Curve(np.repeat(known, 2)[1:], np.repeat(share, 2)[:-1], label, colour, 1.4))
    title = "Path error of a run"
    return Plot([Panel(curves, title, "path error, mm", "share of runs at or below", from_zero=True)], height=2.8)


def effects_plot(figures: SweepFigures, effects: Sequence[MainEffect], shown: NDArray[np.intp]) -> Plot:
    """Show the worst path error of runs against each parameter, with the means that are its main effect."""
    panels = []
    for one in effects:
        column = figures.columns[one.name]
        unit = {SWITCH: " (0 off, 1 on)", "1": ""}.get(column.unit, f", {column.unit}")
        rows = shown[np.isfinite(column.values[shown])]
        marks: list[Mark] = [
            Dots(column.values[rows], figures.worst[rows], "runs", COLOURS[5]),
            Curve(one.values, one.means, "mean", INK, 1.8, dots=True),
        ]
        panels.append(Panel(marks, "", f"{one.name}{unit}", "worst path error, mm"))
    return Plot(panels, columns=min(2, len(panels)), height=2.4)


def _sampled(worst: Array, most: int) -> NDArray[np.intp]:
    """Return runs to be drawn as dots: all, or every so many and the worst ones."""
    good = np.flatnonzero(np.isfinite(worst))
    if len(good) <= most:
        return good
    top = good[np.argsort(worst[good])[-min(50, most // 2) :]]
    spread = good[np.linspace(0, len(good) - 1, most - len(top)).astype(np.intp)]
    return np.unique(np.concatenate([top, spread]))


def _worst_runs(figures: SweepFigures) -> list[tuple[int, str, str, list[float]]]:
    """Return the worst runs: index, block, values of the parameters of largest effect, and path errors, mm and mrad."""

    def text(column: SweptColumn, value: float) -> str:
        if column.unit == SWITCH:
            return f"{column.name} {'on' if value else 'off'}"
        return f"{column.name} {value:.4g}{'' if column.unit == '1' else f' {column.unit}'}"

    good = np.flatnonzero(np.isfinite(figures.worst))
    order = good[np.argsort(-figures.worst[good], kind="stable")][:_MOST_WORST]
    columns, found = [figures.columns[one.name] for one in figures.effects], []
    for row in order.tolist():
        values = [text(c, c.values[row]) for c in columns if np.isfinite(c.values[row])]
        more = [f"and {len(values) - _SHOWN_VALUES} more"] * (len(values) > _SHOWN_VALUES)
        shown = ", ".join([*values[:_SHOWN_VALUES], *more])
        errors = [float(each[row]) for each in (figures.worst, figures.rms, figures.along, figures.turned)]
        found.append((int(figures.index[row]), figures.block[row], shown, errors))
    return found
