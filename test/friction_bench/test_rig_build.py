"""The page that a rig is built from: its parts give the rig file's scales, its table of figures is the firmware's."""

import re
import runpy
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from needs import need
from rig_conformance import Player, armed

from friction_bench.rig.emulated import EmulatedRig, NativeBoard, VirtualPort
from friction_bench.rig.messages import CommandResult
from friction_bench.rig.plant import Shaft, turn
from friction_bench.rig.rig_file import load_rig

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("howto/rig_build", "howto/rig_wiring", "howto/rig_calibration", "reference/rig_protocol")
PAGE = "\n".join((ROOT / f"docs/{name}.md").read_text(encoding="utf-8") for name in NAMES)
UNITS = {"k": 1e3, "": 1.0}


def parts(drawing: str) -> dict[str, float]:
    text = (ROOT / "docs/images" / drawing).read_text(encoding="utf-8")
    found = re.findall(r">(R\w+) ([\d.]+)(k| Ω)(?= |<)", text)
    return {name: float(value) * UNITS[unit.replace(" Ω", "")] for name, value, unit in found}


def test_drawn_parts_give_the_scales_and_the_voltages_of_the_checklist() -> None:
    """Ohm's law through both boards as drawn: the scales within 0.1 %, and what the page says to measure."""
    rig = load_rig(ROOT / "config/rig/gm8224.yaml")
    r, nano = parts("rig_8051.svg") | parts("rig_power.svg"), parts("rig_nano.svg")
    load = nano["R1"] + nano["R2"]
    half = (r["R15"] + r["R16"]) / (r["R14"] + r["R15"] + r["R16"])
    gain = r["RS"] * (1.0 + r["R11"] / r["R10"])
    scale, limit = map(int, re.findall(r"-DADC_FULL_SCALE=(\d+)u -DCURRENT_LIMIT_CODE=(\d+)u", PAGE)[0])
    assert limit == int(1.05 * 0.18 / (scale * 1e-5) * 255)
    for set_point, sensed, volts_per_ampere, adc_full_scale in (
        (5.0 / r["R1"] * r["R4"], 10.0 * half, gain, rig.torque.adc_full_scale),
        (5.0 * load / (10e3 + load), 5.0, 450e-6 * nano["R3"], scale * 1e-5),
    ):
        amperes = set_point * 255 / 256 / volts_per_ampere
        assert amperes * rig.emulation.motor.torque_constant == pytest.approx(rig.torque.dac_full_scale, rel=1e-3)
        measured = sensed * 255 / 256 / volts_per_ampere
        assert measured * rig.emulation.motor.torque_constant == pytest.approx(adc_full_scale, rel=1e-3)
        low, high = set_point * 57 / 256, set_point * 114 / 256
        assert PAGE.count(f"| {low:.3f}, {high:.3f} V |") == 2
        assert f"| {amperes * 57 / 255:.3f}, {amperes * 114 / 255:.3f} A |" in PAGE
    base, diode, feedback = 0.7, 0.7, r["R6"] + r["R5"]
    off = (5.0 / r["R9"] + base / r["R8"] + diode / feedback) / (1.0 / r["R9"] + 1.0 / r["R8"] + 1.0 / feedback)
    assert f"| {off:.2f} ± 0.5 V |" in PAGE


def test_table_of_figures_is_that_of_the_sources() -> None:
    """Each figure that the compiler may be given stands in the page's table with its default, and no other does."""
    sources = [path for path in (ROOT / "firmware").rglob("*.[ch]") if path.is_file()]
    text = "\n".join(path.read_text(encoding="utf-8") for path in sources)
    names = re.findall(r"#ifndef (\w+)\n#define \1 (\w+)", text)
    assert dict(re.findall(r"^\| `(\w+)` \| `(\w+)` \|", PAGE, re.MULTILINE)) == dict(names)
    assert len(names) >= 14


def make(target: str, folder: Path, defines: str) -> subprocess.CompletedProcess[str]:
    need(target)
    command = ["make", "-s", "-C", str(ROOT / "firmware"), target, f"OUT={folder}", f"DEFINES={defines}"]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_a_library_made_with_other_figures_follows_them(tmp_path: Path) -> None:
    """Made anew with another torque limit and scale, the firmware greets with both, obeys code 100 and refuses 101."""
    library, defines = tmp_path / "librig_native.so", "-DTORQUE_LIMIT_CODE=100u -DDAC_FULL_SCALE=30000u"
    built = []
    for figures, limit, scale in (("-DTORQUE_LIMIT_CODE=239u", 239, 0.2), (defines, 100, 0.3), (defines, 100, 0.3)):
        done = make("native", tmp_path, figures)
        assert done.returncode == 0, done.stderr
        built.append(library.stat().st_mtime_ns)
        player = armed(NativeBoard(19200, library))
        assert (player.hello.torque_limit_code, player.hello.dac_full_scale) == (limit, pytest.approx(scale))
    assert built[0] != built[1] == built[2]
    for code, result in ((100, CommandResult.OK), (101, CommandResult.RANGE)):
        player.do_send({"torque": code})
        player.do_beat(60)
        assert (player.board.dac, player.reports[-1].result) == (100, result)


@pytest.mark.parametrize(
    ("target", "defines", "reason"),
    [
        *(
            ("native", f"-D{define}", rf'#error "[^"]*{define.partition("=")[0]}[^"]*accepted')
            for define in (
                "TORQUE_LIMIT_CODE=241", "CURRENT_LIMIT_CODE=255", "WATCHDOG_TICKS=1", "MAX_SPEED=0", "SCALE_UNIT=50",
                "PULSED=2", "COUNTS_PER_REV=70000",
            )
        ),
        ("native", "-DTORQUE_LIMITCODE=100u", "DEFINES: TORQUE_LIMITCODE; accepted: .*TORQUE_LIMIT_CODE"),
        *(
            pytest.param("mcs51", defines, rf'#error "[^"]*{name}[^"]*accepted', marks=pytest.mark.firmware)
            for name, defines in {"ADC_PORT": "-DDAC_PORT=P2", "STAGE_OFF": "-DSTAGE_OFF=P3_2"}.items()
        ),
    ],
)  # fmt: skip
def test_a_figure_that_cannot_be_kept_ends_the_build(target: str, defines: str, reason: str, tmp_path: Path) -> None:
    """A figure out of range, a name that no source knows, or a pin for two signals is refused with what is accepted."""
    done = make(target, tmp_path, defines)
    assert done.returncode != 0
    assert re.search(reason, done.stderr)
    assert not list(tmp_path.glob("*.so"))


def test_the_page_s_command_builds_what_the_source_s_rig_asks_for() -> None:
    """The figures of the page's command are those of the shipped rig file, whose host refuses any other firmware."""
    text = (ROOT / "docs/explanation/rig_measurement.md").read_text(encoding="utf-8")
    (words,) = re.findall(r'make firmware DEFINES="([^"]*)"', text)
    figures = {name: int(value) for name, value in re.findall(r"-D(\w+)=(\d+)u?", words)}
    assert figures == load_rig(ROOT / "config/rig/source.yaml").firmware_figures


@pytest.mark.parametrize("scale", [1.0, 0.92])
def test_known_weight_finds_the_scale_within_the_page_s_uncertainty(
    scale: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page's program on a rig whose amplifier is off by 8 %: 255 tau / c is its scale within twice 0.35 %."""
    rig = load_rig(ROOT / "config/rig/gm8224.yaml")
    emulated = EmulatedRig(rig, 1)
    weight, shaft, lever = 0.0981, Shaft(0.1 * 0.1**2, 0.004, 1e-3), [0.0, 0.0]

    def advance(command: float, dt: float) -> int:
        before = int(lever[0] / rig.angle_step)
        lever[:] = turn(lever[0], lever[1], scale * command - weight, shaft, dt)
        if not 0.0 < lever[0] < 0.05:
            lever[:] = min(max(lever[0], 0.0), 0.05), 0.0
        return abs(int(lever[0] / rig.angle_step) - before)

    monkeypatch.setattr(emulated.plant, "advance", advance)
    monkeypatch.setattr("friction_bench.rig.serial_port.SerialPort", lambda *_: VirtualPort(emulated))
    monkeypatch.chdir(ROOT)
    program = tmp_path / "calibrate.py"
    program.write_text(re.findall(r"```python\n(from pathlib.*?)```", PAGE, re.DOTALL)[0])
    runpy.run_path(str(program))
    rows = [tuple(map(int, line.split())) for line in capsys.readouterr().out.splitlines()]
    codes, counts = zip(*rows, strict=True)
    changes = [k for k in range(1, len(rows)) if counts[k] != counts[k - 1]]
    top = codes.index(max(codes))
    up, down = codes[changes[0]], next(codes[k] for k in changes if k > top)
    assert 5 <= up - down <= 15  # the friction, 0.004 Nm, hinders it once and helps once
    assert 255 * weight / ((up + down) / 2) == pytest.approx(scale * rig.torque.dac_full_scale, rel=2 * 0.0035)


def at_torque(player: Player, code: int) -> None:
    player.do_send({"torque": code})
    player.do_beat(60)
    assert player.reports[-1].result == CommandResult.OK


@pytest.mark.firmware
def test_moved_pins_of_the_8051_act_and_the_old_ones_do_not(tmp_path: Path, make_board: Callable[..., Any]) -> None:
    """In s51 the program drives DAC and stage and reads the ADC at the moved pins, none at the old ones."""
    assert make("mcs51", tmp_path, "-DSTAGE_OFF=P3_6 -DDAC_PORT=P2 -DADC_PORT=P1").returncode == 0
    board = make_board("mcs51", binary=tmp_path / "rig_mcs51.ihx")
    board.adc_port, board.dac_port, board.stage = 1, 2, 0x40
    assert board.port(3) & 0x40  # active low: off
    player = armed(board)
    player.adc = 77
    at_torque(player, 90)
    assert (board.port(2), board.port(1)) == (90, 0xFF)
    assert (board.port(3) & 0x40, board.port(3) & 0x10) == (0, 0x10)
    assert player.reports[-1].adc == 77
    player.do_send("stop")
    player.do_run(60)
    assert board.port(2) == 0
    assert board.port(3) & 0x40


@pytest.mark.firmware
def test_moved_pins_of_the_nano_act_and_the_old_ones_do_not(tmp_path: Path, make_board: Callable[..., Any]) -> None:
    """In simavr the program switches the stage at A2, reads the current at A6, and leaves pin 12 an input."""
    assert make("avr", tmp_path, "-DSTAGE_PIN=16 -DADC_CHANNEL=6").returncode == 0
    board = make_board("avr", binary=tmp_path / "rig_avr.hex")
    board.sense(6)
    Player(board).do_run(50)
    direction, port, direction_b = 0x27, 0x28, 0x24  # DDRC, PORTC, DDRB
    assert board.register(direction) & 4
    assert board.register(port) & 4  # active low: off
    player = armed(board)
    player.adc = 77
    at_torque(player, 90)
    assert board.register(port) & 4 == 0
    assert board.register(direction_b) & 0x10 == 0
    assert (board.dac, player.reports[-1].adc) == (90, 77)
    player.do_send("stop")
    player.do_run(60)
    assert board.register(port) & 4
    assert board.dac == 0
