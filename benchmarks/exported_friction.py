"""One element's friction as each simulator gets it: differences, and the curves beside the identified interval.

    python -m benchmarks.exported_friction [--friction FILE] [--element joint_1] [--plot docs/images/export.png]

Without a file the bags of `rx90_experiment run --engine` are made, and the friction identified from them: two minutes.
The identified element is given two signs and a viscous exponent, which most simulators cannot hold.
"""

from __future__ import annotations

import dataclasses
import tempfile
from pathlib import Path

from benchmarks.report import PLOT, arguments, print_table
from rx90_common.base.errors import ConfigError
from rx90_common.friction.friction_file import FrictionFile
from rx90_common.report.picture import write_picture
from rx90_common.report.plot import Panel, Plot
from rx90_emulator.cli.frame import run
from rx90_emulator.export.export import Export, export_plot, export_robot
from rx90_emulator.export.targets import TARGETS
from rx90_emulator.loop.setup import load_setup

SPEEDS = (1e-3, 1.0)
"""In use, rad/s."""
SIGNS_APART, EXPONENT = 0.9, 0.8
"""Of the element in the picture: tau_c and tau_s of negative over those of positive velocity, viscous exponent."""


def identified() -> FrictionFile:
    """Return the friction identified from the bags of the engine."""
    with tempfile.TemporaryDirectory() as folder:
        bags, file = Path(folder) / "bags", Path(folder) / "friction.yaml"
        for words in (["rx90_experiment", "run", "--engine", "--output", str(bags)],
                      ["rx90_identify", str(bags), "--output", str(file)]):  # fmt: skip
            if run(words[0], words[1:]):
                raise ConfigError(f"{words[0]} failed; accepted: a series that is confirmed")
        return FrictionFile.read(file)


def exports(friction: FrictionFile, name: str) -> tuple[FrictionFile, list[Export]]:
    """Return the friction with a changed element, and the exports of a robot with it."""
    one = friction.elements[name]
    harder = dataclasses.replace(
        one,
        tau_c_negative=SIGNS_APART * one.tau_c_positive,
        tau_s_negative=SIGNS_APART * one.tau_s_positive,
        alpha=EXPONENT,
    )
    changed = dataclasses.replace(friction, elements={**friction.elements, name: harder})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "friction.yaml"
        file.write_text(changed.text(), encoding="utf-8")
        setup = load_setup(friction=file)
        return changed, [export_robot(setup, target, speeds=SPEEDS) for target in TARGETS]


def main() -> None:
    """Print the differences; draw the curves where asked for."""
    options = arguments(__doc__, ("--friction", None, "identified friction"), ("--element", "joint_1", "element"), PLOT)
    friction = identified() if options.friction is None else FrictionFile.read(options.friction)
    changed, found = exports(friction, options.element)
    rows, panels = [], []
    for export in found:
        (fit,) = [fit for fit in export.fits if fit.name == options.element]
        away = "/".join(f"{torque:.3g}" for torque in dict.fromkeys(fit.break_away[1]))
        rows.append((export.target.name, f"{fit.largest:.3g}", f"{fit.rms:.3g}", away, f"{fit.stiffness[1]:.3g}"))
        plot = export_plot(dataclasses.replace(export, fits=(fit,)), changed)
        panels += [dataclasses.replace(one, title=export.target.name) for one in plot.panels if isinstance(one, Panel)]
    print_table(("target", "largest Nm", "RMS Nm", "break-away Nm", "presliding Nm/rad"), rows)
    if options.plot is not None:
        write_picture(Plot(panels, columns=3, height=2.6), options.plot)


if __name__ == "__main__":
    main()
