"""A friction file whose elements have every part that is off in the shipped ones."""

from pathlib import Path
from typing import Any

import rx90_emulator as rx
from rx90_common.friction.parts.load import LoadPart
from rx90_common.friction.parts.ripple import RipplePart
from rx90_common.friction.parts.scatter import ScatterPart
from rx90_common.friction.parts.temperature import TemperaturePart

TEMPERATURE = TemperaturePart(
    reference=40.0, lowest=20.0, highest=90.0, start=30.0, ambient=25.0, capacity=0.5, resistance=10.0,
    viscous_scale=20.0, viscous_floor=0.3, speed_slope=0.02, static_slope=0.01,
)  # fmt: skip
PARTS: dict[str, Any] = {
    "load": LoadPart(driving=0.05, driven=0.1),
    "ripple": RipplePart(motor_harmonic=(2.0,), motor_amplitude=(0.1,)),
    "scatter": ScatterPart(deviation=0.05, correlation_time=0.2),
    "temperature": TEMPERATURE,
}


def write_with_parts(shipped: Path, written: Path) -> Path:
    file = rx.FrictionFile.read(shipped)
    elements = {name: element.replaced(**PARTS) for name, element in file.elements.entries.items()}
    written.write_text(file.replaced(elements=elements).text(), encoding="utf-8")
    return written
