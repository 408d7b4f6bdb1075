"""The report of a sweep: one self-contained HTML page on the path error of its runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from rx90_common.base.arrays import Array
from rx90_common.base.errors import SweepError
from rx90_common.base.quoting import plain
from rx90_common.report.page import render_page
from rx90_emulator.loop.parameters import SWITCH
from rx90_emulator.sweep.effects import MainEffect, SweptColumn, main_effect
from rx90_emulator.sweep.plots import distribution, main_effects
from rx90_emulator.sweep.store import about, failures, read_sweep

_PATH_METRICS = "path_error_worst", "path_error_rms", "along_track_worst", "orientation_worst"
_MILLI = 1e3
_MOST_PANELS = 12  # parameters that are drawn
_MOST_DOTS = 8000  # in all panels
_MOST_WORST = 10
_SHOWN_VALUES = 6  # parameters of a worst run


@dataclass(frozen=True, eq=False)
class SweepFigures:
    """What the page shows.

    Attributes:
        about: the metadata of the results.
        table: the results.
        errors: of each run by _PATH_METRICS, mm and mrad, (runs,); NaN of failed runs.
        effects: of the swept parameters on the worst path error, the largest share first.
    """

    about: Mapping[str, Any]
    table: pa.Table
    errors: Mapping[str, Array]
    effects: Sequence[MainEffect]

    @property
    def worst(self) -> Array:
        """Return the largest path error of each run, mm, (runs,)."""
        return self.errors[_PATH_METRICS[0]]

    @classmethod
    def of(cls, file: Path) -> SweepFigures:
        """Read results, finished or not."""
        table = read_sweep(file)
        errors = {name: _MILLI * _numbers(table[name]) for name in _PATH_METRICS}
        worst = errors[_PATH_METRICS[0]]
        if not np.isfinite(worst).any():
            raise SweepError(
                f"{plain(file)}: no run has succeeded; accepted: results with a path error"
            )
        columns = [
            _column(table, field)
            for field in table.schema
            if field.metadata[b"kind"] == b"parameter"
        ]
        effects = [
            effect for effect in (main_effect(column, worst) for column in columns) if effect.runs
        ]
        effects.sort(key=lambda effect: (-np.nan_to_num(effect.share), -np.ptp(effect.means)))
        return cls(about(table.schema, file), table, errors, effects)


def _numbers(column: pa.ChunkedArray) -> Array:
    return np.asarray(pc.cast(column, pa.float64()).fill_null(np.nan).to_numpy())


def _column(table: pa.Table, field: pa.Field) -> SweptColumn:
    unit = SWITCH if pa.types.is_boolean(field.type) else field.metadata[b"unit"].decode()
    meaning, _, _ = field.metadata[b"meaning"].decode().partition(";")
    return SweptColumn(field.name, unit, meaning, _numbers(table[field.name]))


def sweep_page(file: Path) -> str:
    """Return the text of the page on a file of results."""
    figures = SweepFigures.of(file)
    good = np.flatnonzero(np.isfinite(figures.worst))
    order = good[np.argsort(-figures.worst[good], kind="stable")]
    drawn = figures.effects[:_MOST_PANELS]
    # Evenly by their rank, the worst one first.
    shown = order[:: -(-len(order) * max(1, len(drawn)) // _MOST_DOTS)]
    return render_page(
        "rx90_emulator.sweep",
        "sweep.html.j2",
        name=file.name,
        about=figures.about,
        plan=figures.about["plan"],
        done=len(figures.worst),
        good=len(good),
        median=float(np.median(figures.worst[good])),
        percentile=float(np.quantile(figures.worst[good], 0.95)),
        largest=float(figures.worst[order[0]]),
        distribution=distribution(
            {"worst": figures.worst, "RMS": figures.errors[_PATH_METRICS[1]]}
        ),
        effects=main_effects(figures.worst, drawn, shown),
        sampled=len(shown) if len(shown) < len(good) else 0,
        rows=figures.effects,
        worst=list(_runs(figures, order[:_MOST_WORST])),
        errors=failures(figures.table),
    )


def _runs(
    figures: SweepFigures, rows: NDArray[np.intp]
) -> Iterator[tuple[int, str, str, list[float]]]:
    """Yield index, block, values of the parameters of largest effect, and errors, mm and mrad, of some runs."""
    for row in rows.tolist():
        values = []
        for effect in figures.effects:
            name, unit, _, numbers = effect.column
            if unit == SWITCH and np.isfinite(numbers[row]):
                values.append(f"{name} {'on' if numbers[row] else 'off'}")
            elif np.isfinite(numbers[row]):
                values.append(f"{name} {numbers[row]:.4g} {unit.removeprefix('1')}".rstrip())
        if len(values) > _SHOWN_VALUES:
            values[_SHOWN_VALUES:] = [f"and {len(values) - _SHOWN_VALUES} more"]
        run = figures.table.slice(row, 1).to_pylist()[0]
        yield (
            run["index"],
            run["block"],
            ", ".join(values),
            [float(error[row]) for error in figures.errors.values()],
        )
