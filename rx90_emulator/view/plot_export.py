"""A plot of the page as files: the picture, and the table of what is drawn."""

from __future__ import annotations

import csv
import io
from itertools import zip_longest

import numpy as np

from rx90_common.base.arrays import Array
from rx90_common.base.errors import Rx90Error
from rx90_common.process.files import write_text
from rx90_common.report.picture import write_picture
from rx90_common.report.plot import Curve, Panel, Plot
from rx90_emulator.view.changes import from_user
from rx90_emulator.view.output import ExistingFileError
from rx90_emulator.view.page import Page
from rx90_emulator.view.widgets import sentence

_HEIGHT = 3.0  # inches


class PlotExport:
    """Fields that write one of the page's plots, as it is at that moment, beneath the page's folder.

    Args:
        page: to build in, within a tab, once all its plots are there.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._plot = page.gui.add_dropdown("plot", tuple(page.panels))
        self._name = page.gui.add_text("file, without .png or .csv", "plot")
        for suffix in (".png", ".csv"):
            button = page.gui.add_button(f"Write the {suffix[1:].upper()}")
            button.on_click(from_user(lambda suffix=suffix: self._write(suffix), page))  # type: ignore[misc]
        self._replace = page.gui.add_button("Replace the file that is there", color="red", visible=False)
        self._replace.on_click(from_user(self._confirm, page))
        self._refused = "", ""  # what "Replace" confirms: name and suffix
        self._done = page.gui.add_html("")

    def _confirm(self) -> None:
        if self._replace.visible:
            self._write(self._refused[1], confirmed=self._refused[0])

    def _write(self, suffix: str, confirmed: str = "") -> None:
        name = f"{self._name.value}{suffix}"
        self._replace.visible = False
        try:
            path = self._page.output.path_for(name, replace=name == confirmed)
            panel = self._page.panels[self._plot.value]()
            if suffix == ".csv":
                write_text(path, table(panel))
            else:
                write_picture(Plot([panel], height=_HEIGHT), path)
        except ExistingFileError as error:
            self._refused, self._replace.visible = (name, suffix), True
            self._done.content = sentence(str(error), wrong=True)
        except Rx90Error as error:
            self._done.content = sentence(str(error), wrong=True)
        else:
            self._done.content = sentence(f"written: {path}")


def table(panel: Panel) -> str:
    """Return the curves of a panel as CSV: the abscissa of the first, each ordinate, and each abscissa of its own."""
    columns: list[tuple[str, list[str]]] = []
    first = None
    for curve in panel.marks:
        if not isinstance(curve, Curve):
            continue
        if first is None or not np.array_equal(first, curve.x):
            columns.append((panel.x_label if first is None else f"{curve.label}: {panel.x_label}", _texts(curve.x)))
        first = curve.x if first is None else first
        columns.append((f"{curve.label}: {panel.y_label}" if curve.label else panel.y_label, _texts(curve.y)))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([name for name, _ in columns])
    writer.writerows(zip_longest(*(values for _, values in columns), fillvalue=""))
    return text.getvalue()


def _texts(values: Array) -> list[str]:
    """Return numbers so that they are read back to the bit; nothing where there is none."""
    return ["" if np.isnan(value) else repr(float(value)) for value in values]
