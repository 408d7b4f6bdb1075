"""Draw the schematics of the friction rig's two boards that docs/howto/rig_build.md shows.

    python -m tools.rig_schematics      # docs/images/rig_*.svg; needs `pip install schemdraw`

Wires with the same name are connected. The values are computed on that page.
"""

from __future__ import annotations

from pathlib import Path

import schemdraw
from schemdraw import elements as elm

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
_PITCH = 0.62  # of an IC's pins


def _chip(
    drawing: schemdraw.Drawing,
    at: tuple[float, float],
    title: str,
    left: str,
    right: str,
    width: float = 4.2,
) -> None:
    """Draw an IC with named nets at its pins; a pin is `number name net`, pins are separated by commas, top first."""
    sides = [[pin.split() for pin in side.split(",")] for side in (left, right)]
    pins = [
        elm.IcPin(
            name=pin[1],
            pin=pin[0].strip("-"),
            side=side,
            slot=f"{rows - row}/{rows}",
            anchorname=f"{side}{row}",
        )
        for side, rows, column in (
            ("left", max(map(len, sides)), sides[0]),
            ("right", max(map(len, sides)), sides[1]),
        )
        for row, pin in enumerate(column)
    ]
    size = (width, _PITCH * (max(map(len, sides)) + 1))
    chip = drawing.add(
        elm.Ic(pins=pins, size=size, pinspacing=_PITCH, leadlen=0.6, lsize=10, plblsize=8)
        .at(at)
        .label(title, "top")
    )
    for side, column in zip(("left", "right"), sides, strict=True):
        for row, pin in enumerate(column):
            net = " ".join(pin[2:])
            if net:
                drawing.add(
                    elm.Label()
                    .at(getattr(chip, f"{side}{row}"))
                    .label(net, side, fontsize=9, ofst=0.25 if side == "left" else 0.05)
                )


def _amplifier(drawing: schemdraw.Drawing, at: tuple[float, float], title: str) -> elm.Element:
    amplifier = drawing.add(elm.Opamp(leads=True).right().at(at))
    drawing.add(elm.Label().at((at[0] + 1.6, at[1])).label(title, "center", fontsize=9))
    return amplifier


def processor(drawing: schemdraw.Drawing) -> None:
    """Draw processor, converters, reference and serial line of the source's board."""
    _chip(
        drawing, (0, 0), "U1 AT89S52 (89C51)",
        "40 VCC +5V,31 EA +5V,9 RST 10 µF to +5V + 10k to GND,"
        "19 XTAL1 11.0592 MHz + 33 pF,18 XTAL2 11.0592 MHz + 33 pF,"
        "10 RXD U5 pin 12,11 TXD U5 pin 11,12 INT0 U6 pin 2,13 P3.3,14 P3.4 STAGE_OFF,20 GND GND",
        "1 P1.0 D0,2 P1.1 D1,3 P1.2 D2,4 P1.3 D3,5 P1.4 D4,6 P1.5 D5,7 P1.6 D6,8 P1.7 D7,"
        "21..28 P2.0-7 A0..A7",
    )  # fmt: skip
    _chip(
        drawing, (10.5, 0), "U2 DAC0808",
        "12 A8 D0,11 A7 D1,10 A6 D2,9 A5 D3,8 A4 D4,7 A3 D5,6 A2 D6,5 A1 D7",
        "13 VCC +5V,14 VREF+ R1 2.49k to VREF,15 VREF- R2 2.49k to GND,4 IOUT IDAC,"
        "16 COMP 100 nF to VEE,3 VEE -12V,2 GND GND",
    )  # fmt: skip
    _chip(
        drawing, (10.5, -9.2), "U3 ADC0804",
        "1 CS GND,2 RD GND,3 WR GO,5 INTR GO,4 CLKIN 150 pF to GND,19 CLKR R3 10k to CLKIN,6 VIN+ VADC,7 VIN- GND,"
        "8 AGND GND,10 DGND GND,9 VREF/2 VHALF,20 VCC +5V",
        "18 DB0 A0 (P2.0),17 DB1 A1,16 DB2 A2,15 DB3 A3,14 DB4 A4,13 DB5 A5,12 DB6 A6,11 DB7 A7 (P2.7)",
    )  # fmt: skip
    _chip(
        drawing,
        (0, -4.2),
        "U5 MAX232",
        "11 T1IN TXD,12 R1OUT RXD",
        "14 T1OUT DE-9 pin 2,13 R1IN DE-9 pin 3",
        3.4,
    )
    _chip(drawing, (0, -7.4), "U6 74HC14", "1 1A encoder A + 4.7k to +5V", "2 1Y INT0", 3.4)
    drawing.add(
        elm.Label()
        .at((-3.5, -8.9))
        .label("Start-up of U3: GO is pulled low once", "right", fontsize=10)
    )
    gate = drawing.add(elm.Capacitor().at((-3.2, -10.6)).right().length(2.2).label("1 µF", "top"))
    drawing.add(elm.Label().at(gate.start).label("+5V", "left", fontsize=9))
    drawing.add(elm.Resistor().at(gate.end).down().length(1.8).label("100k", "bottom"))
    drawing.add(elm.Ground())
    switch = drawing.add(
        elm.NFet()
        .at((gate.end[0] + 1.2, gate.end[1] + 0.1))
        .anchor("gate")
        .theta(0)
        .reverse()
        .label("Q3 2N7000", "right")
    )
    drawing.add(elm.Line().at(gate.end).to(switch.gate))
    drawing.add(elm.Ground().at(switch.source))
    drawing.add(elm.Label().at(switch.drain).label("GO", "top", fontsize=9))


def power(drawing: schemdraw.Drawing) -> None:
    """Draw the analog part and power stage of the source's board."""
    _stage(drawing, _regulator(drawing))
    _sensing(drawing)


def _regulator(drawing: schemdraw.Drawing) -> tuple[float, float]:
    """Draw what compares set and sensed current; return where its output, the base of the TIP120, is."""
    # U4A: the DAC's current becomes a voltage.
    first = _amplifier(drawing, (0, 0), "U4A")
    drawing.add(elm.Line().at(first.in1).left().length(1))
    drawing.add(elm.Label().label("IDAC", "left", fontsize=9))
    drawing.add(elm.Line().at(first.in1).up().length(1.3))
    drawing.add(elm.Resistor().tox(first.out).label("R4 2.00k", "top"))
    drawing.add(elm.Line().toy(first.out))
    drawing.add(elm.Ground().at(first.in2))
    drawing.add(elm.Line().at(first.out).right().length(0.6))
    drawing.add(elm.Label().label("VSET", "right", fontsize=9))
    # U4B: integrates set minus sensed; TIP120 drives the motor.
    second = _amplifier(drawing, (9.4, 0), "U4B")
    drawing.add(elm.Label().at(second.in2).label("VSET", "left", fontsize=9, ofst=0.25))
    drawing.add(elm.Line().at(second.in1).up().length(0.8))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Resistor().at(node.center).left().length(2).label("R5 10k", "bottom"))
    drawing.add(elm.Label().label("VSENSE", "left", fontsize=9))
    drawing.add(elm.Capacitor().at(node.center).tox(second.out).label("C1 270 nF", "top"))
    drawing.add(elm.Line().toy(second.out))
    drawing.add(elm.Line().at(node.center).up().length(0.9))
    drawing.add(elm.Resistor().left().length(2).label("R6 100k", "top"))
    drawing.add(elm.Diode().left().reverse().length(1.6).label("D2 1N4148", "top"))
    drawing.add(elm.Label().label("STAGE_OFF", "left", fontsize=9))
    drawing.add(elm.Resistor().at(second.out).right().length(2.6).label("R7 1.0k", "top"))
    base = drawing.add(elm.Dot()).center
    return (base[0], base[1])


def _stage(drawing: schemdraw.Drawing, base: tuple[float, float]) -> None:
    """Draw TIP120, motor, flyback diode, sense resistor and the enable that takes the base away."""
    power_transistor = drawing.add(
        elm.BjtNpn()
        .at((base[0] + 1.6, base[1]))
        .anchor("base")
        .theta(0)
        .label("Q1 TIP120\n(Darlington)", "right")
    )
    drawing.add(elm.Line().at(base).to(power_transistor.base))
    drawing.add(elm.Line().at(power_transistor.collector).up().length(0.5))
    low = drawing.add(elm.Dot())
    motor = drawing.add(elm.Motor().at(low.center).up().length(2.2).label("M", "center"))
    high = drawing.add(elm.Dot().at(motor.end))
    drawing.add(elm.Line().at(low.center).right().length(1.8))
    drawing.add(elm.Diode().up().toy(high.center).label("D1 SB560", "bottom"))
    drawing.add(elm.Line().tox(high.center))
    drawing.add(elm.Switch().at(high.center).up().length(1.6).label("S1 emergency stop", "bottom"))
    drawing.add(elm.Fuse().up().length(1.6).label("F1 6.3 A slow", "bottom"))
    drawing.add(elm.Vdd().label("+24V"))
    drawing.add(elm.Line().at(power_transistor.emitter).down().length(0.6))
    sense = drawing.add(elm.Dot())
    drawing.add(elm.Line().at(sense.center).right().length(1.2))
    drawing.add(elm.Label().label("SENSE", "right", fontsize=9))
    drawing.add(
        elm.Resistor().at(sense.center).down().length(2).label("RS 0.100 Ω 5 W 1 %", "bottom")
    )
    drawing.add(elm.Ground())
    clamp = drawing.add(
        elm.BjtNpn()
        .at((base[0] - 0.75, base[1] - 2.4))
        .anchor("base")
        .theta(0)
        .label("Q2 BC547B", "right")
    )
    drawing.add(elm.Line().at(clamp.collector).toy(base))
    drawing.add(elm.Ground().at(clamp.emitter))
    drawing.add(elm.Resistor().at(clamp.base).left().length(2.2).label("R8 10k", "top"))
    off = drawing.add(elm.Dot())
    drawing.add(elm.Label().at(off.center).label("STAGE_OFF", "left", fontsize=9))
    drawing.add(elm.Resistor().at(off.center).down().length(1.8).label("R9 10k", "bottom"))
    drawing.add(elm.Label().label("+5V", "bottom", fontsize=9))


def _sensing(drawing: schemdraw.Drawing) -> None:
    """Draw the sense amplifier, four wires to its resistor, and the ADC's reference."""
    third = _amplifier(drawing, (0.6, -6.6), "U4C")
    drawing.add(elm.Label().at(third.in2).label("SENSE", "left", fontsize=9, ofst=0.25))
    drawing.add(elm.Line().at(third.in1).up().length(0.9))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Resistor().at(node.center).left().length(1.9).label("R10 2.00k", "bottom"))
    drawing.add(elm.Label().label("GND at RS", "left", fontsize=9))
    drawing.add(elm.Resistor().at(node.center).tox(third.out).label("R11 16.0k", "top"))
    drawing.add(elm.Line().toy(third.out))
    drawing.add(elm.Line().at(node.center).up().length(0.9))
    drawing.add(elm.Resistor().left().length(1.9).label("R12 2.2M", "top"))
    drawing.add(elm.Label().label("wiper of RV1 10k\nfrom +12V to -12V", "left", fontsize=9))
    drawing.add(elm.Line().at(third.out).right().length(0.4))
    sensed = drawing.add(elm.Dot().label("VSENSE", "bottom", fontsize=9))
    drawing.add(elm.Resistor().at(sensed.center).right().length(2.2).label("R13 1.0k", "top"))
    reading = drawing.add(elm.Dot())
    drawing.add(elm.Line().at(reading.center).right().length(1.8))
    drawing.add(elm.Label().label("VADC", "right", fontsize=9))
    drawing.add(elm.Capacitor().at(reading.center).down().length(1.6).label("100 nF", "bottom"))
    drawing.add(elm.Ground())
    drawing.add(
        elm.Schottky()
        .at((reading.center[0] + 1, reading.center[1]))
        .up()
        .length(1.5)
        .label("BAT85", "bottom")
    )
    drawing.add(elm.Label().label("+5V", "top", fontsize=9))
    # U4D: half of the ADC's span.
    fourth = _amplifier(drawing, (14.4, -6.6), "U4D")
    drawing.add(elm.Line().at(fourth.in1).up().length(0.9))
    drawing.add(elm.Line().tox(fourth.out))
    drawing.add(elm.Line().toy(fourth.out))
    drawing.add(elm.Line().at(fourth.out).right().length(0.5))
    drawing.add(elm.Label().label("VHALF", "right", fontsize=9))
    drawing.add(elm.Line().at(fourth.in2).left().length(0.5))
    middle = drawing.add(elm.Dot())
    drawing.add(elm.Resistor().at(middle.center).left().length(2).label("R14 10.0k", "top"))
    drawing.add(elm.Label().label("VREF 5.000 V", "left", fontsize=9))
    drawing.add(elm.Resistor().at(middle.center).down().length(1.8).label("R15 10.0k", "bottom"))
    drawing.add(elm.Resistor().down().length(1.8).label("R16 82 Ω", "bottom"))
    drawing.add(elm.Ground())


def nano(drawing: schemdraw.Drawing) -> None:
    """Draw the board of today: Arduino Nano, resistor ladder, DRV8874 carrier."""
    _chip(
        drawing, (0, 0), "U1 Arduino Nano",
        "- USB host,- VIN 7-9V,- D2 encoder A,- D3,- D12 STAGE_OFF,- A0 VADC,- GND GND,- 5V +5V",
        "- D4 b0,- D5 b1,- D6 b2,- D7 b3,- D8 b4,- D9 b5,- D10 b6,- D11 b7",
    )  # fmt: skip
    _chip(
        drawing, (7.6, 0), "RN1 R-2R 10k/20k",
        "- b0 b0,- b1 b1,- b2 b2,- b3 b3,- b4 b4,- b5 b5,- b6 b6,- b7 b7",
        "- OUT VSET,- GND GND", 3.0,
    )  # fmt: skip
    _chip(
        drawing, (15.2, 0), "U2 DRV8874 carrier",
        "- VM +24V (F1; S1),- EN +5V,- PH +5V,- PMODE GND,- IMODE GND,- nSLEEP AWAKE,- VREF VSET,- GND GND",
        "- OUT1 motor +,- OUT2 motor -,- IPROPI VIP", 3.4,
    )  # fmt: skip
    drawing.add(
        elm.Label()
        .at((3.6, -0.7))
        .label("R7 ... R14: 10k from each of D4 ... D11 to GND", "right", fontsize=10)
    )
    drawing.add(elm.Label().at((-2, -2.2)).label("Set-point", "right", fontsize=10))
    drawing.add(elm.Label().at((-1, -3.4)).label("VSET", "left", fontsize=9, ofst=0.25))
    drawing.add(elm.Line().at((-1, -3.4)).right().length(0.8))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Resistor().at(node.center).down().length(1.8).label("R1 15.0k", "top"))
    drawing.add(elm.Resistor().down().length(1.8).label("R2 150 Ω", "top"))
    drawing.add(elm.Ground())
    drawing.add(elm.Line().at(node.center).right().length(1.6))
    drawing.add(elm.Capacitor().down().length(1.8).label("100 nF", "bottom"))
    drawing.add(elm.Ground())
    drawing.add(elm.Label().at((6, -2.2)).label("Current sense", "right", fontsize=10))
    drawing.add(elm.Label().at((6, -3.4)).label("VIP", "left", fontsize=9))
    drawing.add(elm.Line().at((6, -3.4)).right().length(0.8))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Resistor().at(node.center).down().length(2).label("R3 1.50k", "top"))
    drawing.add(elm.Ground())
    drawing.add(elm.Resistor().at(node.center).right().length(2.2).label("R4 10k", "top"))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Capacitor().at(node.center).down().length(2).label("100 nF", "bottom"))
    drawing.add(elm.Ground())
    drawing.add(elm.Line().at(node.center).right().length(1.4))
    drawing.add(elm.Label().label("VADC", "right", fontsize=9))
    drawing.add(elm.Label().at((14, -2.2)).label("Enable", "right", fontsize=10))
    switch = drawing.add(
        elm.NFet().at((17, -4.4)).anchor("gate").theta(0).reverse().label("Q1 2N7000", "right")
    )
    drawing.add(elm.Line().at(switch.gate).left().length(1.4))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Label().at(node.center).label("STAGE_OFF", "left", fontsize=9))
    drawing.add(elm.Resistor().at(node.center).up().length(1.6).label("R5 10k", "top"))
    drawing.add(elm.Label().label("+5V", "top", fontsize=9))
    drawing.add(elm.Ground().at(switch.source))
    drawing.add(elm.Line().at(switch.drain).up().length(0.3))
    node = drawing.add(elm.Dot())
    drawing.add(elm.Resistor().at(node.center).up().length(1.4).label("R6 10k", "bottom"))
    drawing.add(elm.Label().label("+5V", "top", fontsize=9))
    drawing.add(elm.Line().at(node.center).right().length(2))
    drawing.add(elm.Label().label("AWAKE", "right", fontsize=9))


def main() -> None:
    """Draw all three."""
    schemdraw.use("svg")
    drawings = (processor, "rig_8051"), (power, "rig_power"), (nano, "rig_nano")
    for draw, name in drawings:
        with schemdraw.Drawing(
            file=str(IMAGES / f"{name}.svg"), show=False, fontsize=10, unit=2, bgcolor="white"
        ) as drawing:
            drawing.config(margin=1)  # the extent of long names is estimated too small
            draw(drawing)


if __name__ == "__main__":
    main()
