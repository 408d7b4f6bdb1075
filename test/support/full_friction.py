"""A friction file whose elements have every part that is off in the shipped ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import rx90_emulator as rx

PARTS: dict[str, Any] = {
    "load": rx.LoadPart(0.05, 0.1),
    "ripple": rx.RipplePart(motor_harmonic=(2.0,), motor_amplitude=(0.1,)),
    "scatter": rx.ScatterPart(0.05, 0.2),
    "temperature": rx.TemperaturePart(40.0, 20.0, 90.0, 30.0, 25.0, 0.5, 10.0, 20.0, 0.3, 0.02, 0.01),
}


def write_with_parts(shipped: Path, written: Path) -> Path:
    """Write a friction file with these parts in each of its elements; return its path."""
    file = rx.FrictionFile.read(shipped)
    elements = {name: replace(element, **PARTS) for name, element in file.elements.items()}
    written.write_text(replace(file, elements=elements).text(), encoding="utf-8")
    return written
