"""One element's friction as each simulator gets it: differences.

    python -m benchmarks.exported_friction [--friction FILE] [--element joint_1]

The element, by default of the RX90B, is given two signs and a viscous exponent, which most simulators cannot hold.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.report import arguments, print_table
from rx90_common.description.robot_files import DEFAULT_ROBOT, RobotFiles
from rx90_common.friction.friction_file import FrictionFile
from rx90_emulator.export.export import Export, export_robot
from rx90_emulator.export.targets import TARGETS
from rx90_emulator.loop.setup import load_setup

SPEEDS = (1e-3, 1.0)
"""In use, rad/s."""
SIGNS_APART, EXPONENT = 0.9, 0.8
"""Of the element: tau_c and tau_s of negative over those of positive velocity, viscous exponent."""


def exports(friction: FrictionFile, name: str) -> list[Export]:
    """Return the exports of a robot with a changed element."""
    element = friction.elements[name]
    harder = element.replaced(
        tau_c={
            "positive": element.tau_c.positive,
            "negative": SIGNS_APART * element.tau_c.positive,
        },
        tau_s={
            "positive": element.tau_s.positive,
            "negative": SIGNS_APART * element.tau_s.positive,
        },
        alpha=EXPONENT,
    )
    changed = friction.replaced(elements={**friction.elements.entries, name: harder})
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "friction.yaml"
        file.write_text(changed.text(), encoding="utf-8")
        setup = load_setup(friction=file)
        return [export_robot(setup, target, speeds=SPEEDS) for target in TARGETS]


def main() -> None:
    """Print the differences."""
    options = arguments(
        __doc__, ("--friction", None, "friction file"), ("--element", "joint_1", "element")
    )
    friction = FrictionFile.read(options.friction or RobotFiles.named(DEFAULT_ROBOT).friction)
    rows = []
    for export in exports(friction, options.element):
        (fit,) = [fit for fit in export.fits if fit.name == options.element]
        away = "/".join(f"{torque:.3g}" for torque in dict.fromkeys(fit.break_away[1]))
        rows.append(
            (
                export.target.name,
                f"{fit.largest:.3g}",
                f"{fit.rms:.3g}",
                away,
                f"{fit.stiffness[1]:.3g}",
            )
        )
    print_table(("target", "largest Nm", "RMS Nm", "break-away Nm", "presliding Nm/rad"), rows)


if __name__ == "__main__":
    main()
