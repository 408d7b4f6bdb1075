"""The bring-up check, by emulated hands and meters: a good board passes, each fault is found by its step."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import tty
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from processes import TIMEOUT, command
from rig_bench import PatientRig, greeted

from friction_bench.experiment import bring_up, dialogue
from friction_bench.experiment.bring_up import BIPOLAR_STEPS, DIRECTION, STEPS, BringUp
from friction_bench.experiment.dialogue import (
    BIPOLAR_BOARDS,
    BOARDS,
    HIGH,
    LONGEST_HOLD,
    OF_PROCESSOR,
    Comparison,
)
from friction_bench.rig.client import RigClient
from friction_bench.rig.emulated import EmulatedRig
from friction_bench.rig.messages import PROCESSORS
from friction_bench.rig.rig_file import Rig, load_rig
from rx90_common.base.share import SHIPPED_RIG, config_path
from rx90_emulator.cli.frame import run

LINE, IDLE, ENABLE, SET_POINT, LIMIT, WATCHDOG, ENCODER, SENSE, CURRENT = STEPS
PAGE = Path(__file__).resolve().parents[2] / "docs/howto/rig_build.md"
CLAMPED = 10.0
"""Coulomb friction of a shaft that is clamped, Nm."""


class Hands:
    """A person whose shaft is the emulated plant's, and whose meters show what the board's pins and the motor do.

    Attributes:
        meters: factors of what is measured, by the beginning of its name.
        sense: the answer to whether the shaft turned in the sense asked for; None for the true one.
        line: whether the direction's line says backward, by whether the firmware does.
        armed_when_asked: questions before which the stage was on although it asks to be switched on.
    """

    def __init__(self, client: RigClient, board: str = "8051") -> None:
        self.emulated: EmulatedRig = client.port.emulated
        self.board = (BIPOLAR_BOARDS if client.rig.bipolar else BOARDS)[board]
        self.meters: dict[str, float] = {}
        self.line = lambda backward: backward
        self.sense: str | None = None
        self._angle = 0.0
        self.armed_when_asked: list[str] = []
        self._free = list(self.emulated.plant._shafts)
        self.clamp(True)

    def clamp(self, clamped: bool) -> None:
        """Clamp the shaft, or let it go."""
        held = [shaft._replace(coulomb=CLAMPED) for shaft in self._free]
        self.emulated.plant._shafts = held if clamped else list(self._free)

    def turn(self, sign: int) -> None:
        """Turn the motor's shaft once by hand, in 0.2 s."""
        for _ in range(100):
            self.emulated.plant.angle += sign * 2.0 * 3.14159265 / 100
            self.emulated.advance(0.002)

    def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
        """Do what is asked, or measure."""
        board, plant = self.emulated.board, self.emulated.plant
        if question.startswith("Did it turn"):
            turned = (plant.angle - self._angle) * (-1.0 if "negative" in question else 1.0)
            return self.sense or ("y" if turned > 0.0 else "n")
        if "[Enter, or s" in question:
            if board.stage_on or board.dac:
                self.armed_when_asked.append(question)
            self.clamp(not question.startswith("Apply the torque"))
            self._angle = plant.angle
            if question.startswith("Turn it once"):
                self.turn(-1 if "negative" in question else 1)
                for _ in range(15):  # before Enter is pressed what the rig reported meanwhile is read
                    meanwhile()
            return ""
        torque = 0.0
        for _ in range(8):  # what a meter averages
            meanwhile()
            torque += plant.torque / 8
        assert plant.parameters.torque_constant
        current = torque / plant.parameters.torque_constant
        values = {
            self.board.enable: self.board.on if board.stage_on else self.board.off,
            "VSET": self.board.set_point * abs(board.dac) / 255,
            self.board.sense: self.board.gain * abs(current),
            "current": current,
        }
        backward = self.line(board.dac < 0)
        values |= {name: HIGH * (backward is not forward) for name, forward in self.board.directions.items()}
        name = next(name for name in values if question.startswith(name))
        return f"{values[name] * self.meters.get(name, 1.0):.4f}"


def check(client: RigClient, tamper: Callable[[Hands], object] = lambda _: None, board: str = "8051") -> BringUp:
    """Check a rig that somebody has tampered with, whose processor stands on a board."""
    hands = Hands(client, board)
    tamper(hands)
    bring_up_check = BringUp(client, hands)
    bring_up_check.run()
    assert hands.armed_when_asked == [] or "Enable" in failed(bring_up_check)
    return bring_up_check


def failed(found: BringUp) -> dict[str, str]:
    """Return why each failed step failed."""
    return {one.title: "; ".join(one.reasons) for one in found.results if one.verdict == "failed"}


@pytest.mark.parametrize(
    ("bipolar", "target"),  # one of the slow simulators: transcripts hold all targets to both stages
    [(False, "native"), (True, "native"), pytest.param(True, "avr", marks=pytest.mark.firmware)],
)
def test_a_good_board_passes(
    bipolar: bool,
    target: str,
    make_board: Callable[..., Any],
    bipolar_firmware: Callable[[str], Path],
    rig: Rig,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With each stage, and a binary in place of the native core, all steps pass without a reason against one.

    The board's figures are those of the processor that greets.

    Of a stage for both signs the direction's line and the current backward are among what is measured.
    """
    for name, fewer in (("LISTENED_TICKS", 10), ("SETTLING_TICKS", 5), ("AVERAGED_TICKS", 10)):
        monkeypatch.setattr(bring_up, name, fewer)  # simulators are slow
    rig = replace(rig, plant=replace(rig.plant, coulomb=0.004))  # turns at a low code
    if bipolar:
        rig = replace(rig, stage="bipolar", counts_down=True)
    else:  # as the 8051's binary greets, which is slow
        monkeypatch.setattr(dialogue, "PROCESSORS", ("mcs51",))
    client = greeted(rig, board=make_board(target, binary=bipolar_firmware(target) if bipolar else None))
    found = check(client, board=OF_PROCESSOR.get(target, "8051"))
    assert {one.title: one.reasons for one in found.results} == {
        title: [] for title in (BIPOLAR_STEPS if bipolar else STEPS)
    }
    assert found.verdict == "passed"
    assert PROCESSORS[client.hello.processor] == target
    if bipolar:
        checked = {one.name for step in found.results for one in step.quantities}
        assert {"ADC code at code 57", "ADC code at code -57", "current at code -114"} <= checked
        assert {f"{line} at code {code}" for line in found.board.directions for code in (57, -57)} <= checked


def wrap(hands: Hands, name: str, change: Callable[[Any], Any]) -> None:
    """Change what a method of the plant returns."""
    original = getattr(hands.emulated.plant, name)
    setattr(hands.emulated.plant, name, lambda *arguments: change(original(*arguments)))


def drive(hands: Hands, change: Callable[[float], float]) -> None:
    """Change the torque that the stage makes of its set-point and direction."""
    original = hands.emulated.plant.advance
    hands.emulated.plant.advance = lambda torque, dt: original(change(torque), dt)  # type: ignore[method-assign]


UNIPOLAR, BOTH_WAYS = SHIPPED_RIG, "rig/bipolar.yaml"
BOARD_FAULTS: dict[str, tuple[str, Callable[[Hands], object], dict[str, str]]] = {
    "no encoder": (
        UNIPOLAR,
        lambda hands: wrap(hands, "advance", lambda _: 0),
        {ENCODER: "no counts", SENSE: "0 counts up to code 114"},
    ),
    "half the edges": (
        UNIPOLAR,
        lambda hands: setattr(hands.emulated.plant, "_scale", hands.emulated.plant._scale / 2),
        {ENCODER: "found 252: WRONG"},
    ),
    "open encoder line that counts along": (
        UNIPOLAR,
        lambda hands: wrap(hands, "advance", lambda edges: edges + 1),
        {IDLE: "encoder counts", ENCODER: "WRONG"},
    ),
    "set-point 20 % high": (
        UNIPOLAR,
        lambda hands: (hands.meters.update(VSET=1.2), setattr(hands.emulated.plant, "_gain", 1.2)),
        {SET_POINT: "VSET at code 57", CURRENT: "ADC code at code 114"},
    ),
    "sense resistor 20 % low": (
        UNIPOLAR,
        lambda hands: hands.meters.update(current=1.2),
        {CURRENT: "current at code 57: expected 0.9935 ± 0.08 A"},
    ),
    "converter's reference 20 % low": (
        UNIPOLAR,
        lambda hands: wrap(hands, "current_reading", lambda torque: 1.2 * torque),
        {CURRENT: "ADC code at code 57"},
    ),
    "motor's leads exchanged": (UNIPOLAR, lambda hands: setattr(hands, "sense", "n"), {SENSE: "exchange the motor's"}),
    "direction's line open behind the board's point": (
        BOTH_WAYS,
        lambda hands: drive(hands, abs),
        {SENSE: "turns the shaft in the positive sense whatever its sign", CURRENT: "current at code -57"},
    ),
    "direction's line stuck": (
        BOTH_WAYS,
        lambda hands: (drive(hands, abs), setattr(hands, "line", lambda _: False)),
        {DIRECTION: "is high whatever the sign", SENSE: "whatever its sign", CURRENT: "current at code -114"},
    ),
    "direction's line stuck at ground": (
        BOTH_WAYS,
        lambda hands: (drive(hands, lambda torque: -abs(torque)), setattr(hands, "line", lambda _: True)),
        {DIRECTION: "is low whatever the sign", SENSE: "in the negative sense whatever", CURRENT: "current at code 57"},
    ),
    "directions exchanged": (
        BOTH_WAYS,
        lambda hands: (drive(hands, lambda torque: -torque), setattr(hands, "line", lambda back: not back)),
        {DIRECTION: "are exchanged", SENSE: "or FORWARD and BACKWARD", CURRENT: "current at code -57"},
    ),
    "leads of a motor that turns both ways exchanged": (
        BOTH_WAYS,
        lambda hands: drive(hands, lambda torque: -torque),
        {SENSE: "the motor's leads are exchanged", CURRENT: "current at code 57"},
    ),
    "4 % less backward": (
        BOTH_WAYS,
        lambda hands: drive(hands, lambda torque: torque if torque > 0.0 else 0.96 * torque),
        {CURRENT: "ADC code at code -114 less that at code 114"},
    ),
    "no torque backward": (
        BOTH_WAYS,
        lambda hands: drive(hands, lambda torque: max(0.0, torque)),
        {SENSE: "up to code -114", CURRENT: "ADC code at code -57: expected 45.6"},
    ),
}


@pytest.mark.parametrize("name", BOARD_FAULTS)
def test_a_fault_of_the_board_is_found_by_its_step(name: str) -> None:
    """Each fault fails the steps that show it, with its cause or quantity, and no other step."""
    rig, tamper, expected = BOARD_FAULTS[name]
    found = failed(check(greeted(load_rig(config_path(rig))), tamper))
    assert found.keys() == expected.keys()
    for step, text in expected.items():
        assert text in found[step]


FIRMWARE_FAULTS = {
    "no watchdog": (UNIPOLAR, "trip(FAULT_WATCHDOG);", ";", {WATCHDOG: "the watchdog does not act"}),
    "slow watchdog": (UNIPOLAR, ">= WATCHDOG_TICKS", ">= WATCHDOG_TICKS + 5u", {WATCHDOG: "found 240: WRONG"}),
    "high torque": (UNIPOLAR, "if (code > TORQUE_LIMIT_CODE)", "if (0)", {LIMIT: "TORQUE code 230: obeyed"}),
    "high ramp": (UNIPOLAR, "end > TORQUE_LIMIT_CODE", "0", {LIMIT: "RAMP code 230: obeyed"}),
    "stage stays on": (
        UNIPOLAR, "    hal_stage(0);\n    drive(0);", "    drive(0);", {ENABLE: "off again", WATCHDOG: "after that"},
    ),
    "stage never on": (
        UNIPOLAR, "    drive(0);\n    hal_stage(1);", "    drive(0);", {ENABLE: "with the stage on"},
    ),
    "deaf direction": (
        BOTH_WAYS, "    steer(frame_rx[3]);", "",
        {DIRECTION: "sent was code -57, the rig reports 57", SENSE: "", CURRENT: ""},
    ),
    "direction stuck": (
        BOTH_WAYS, "    hal_reverse(back);", "", {DIRECTION: "is high whatever the sign", SENSE: "", CURRENT: ""},
    ),
    "high torque backward": (
        BOTH_WAYS, "    if (code > TORQUE_LIMIT_CODE)", "    if (code > TORQUE_LIMIT_CODE && !frame_rx[3])",
        {LIMIT: "TORQUE code -230: obeyed"},
    ),
    "high ramp backward": (
        BOTH_WAYS, "|| end > TORQUE_LIMIT_CODE", "|| (end > TORQUE_LIMIT_CODE && !(frame_rx[5] & WAY_BACKWARD))",
        {LIMIT: "RAMP code -230: obeyed"},
    ),
}  # fmt: skip
"""By rig, text of core/rig.c and what stands in its place."""


@pytest.mark.parametrize("name", FIRMWARE_FAULTS)
def test_a_fault_of_the_firmware_is_found_by_its_step(name: str, mutant: Callable[..., Any]) -> None:
    """A firmware without one of its rules fails the steps that show it and no other.

    After a step that shows that the board does not take a torque away none is applied.
    """
    file, old, new, expected = FIRMWARE_FAULTS[name]
    rig = load_rig(config_path(file))
    done = check(greeted(rig, board=mutant("core/rig.c", old, new, rig.firmware_figures)))
    found = failed(done)
    assert found.keys() == expected.keys()
    for step, text in expected.items():
        assert text in found[step]
    if not {ENABLE, LIMIT, WATCHDOG}.isdisjoint(expected):
        assert [one.verdict for one in done.results[-2:]] == ["incomplete"] * 2


def test_other_figures_than_the_rig_file_s_end_the_check(rig: Rig) -> None:
    """A firmware for another encoder fails the first step with both numbers; nothing is switched on after that."""
    client = greeted(rig)
    client.rig = replace(rig, counts_per_revolution=500)
    found = BringUp(client, Hands(client))
    assert found.run() == 1
    assert "counts_per_revolution is 500, the rig's firmware has 504" in failed(found)[LINE]
    assert found.document()["not_reached"] == list(STEPS)[1:]


@pytest.mark.parametrize("answer", ["s", None])
def test_nothing_is_switched_on_without_consent(answer: str | None, client: RigClient) -> None:
    """Where the person skips all, or nobody is there, the stage never comes on, and the check is incomplete."""

    class Unwilling(Hands):
        def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
            meanwhile()
            return answer if "[Enter, or s" in question or answer is None else ""

    client.port.emulated.board.switched_on()
    found = BringUp(client, Unwilling(client))
    assert found.run() == 1
    assert found.verdict == "incomplete"
    assert [one.verdict for one in found.results] == ["passed", *["incomplete"] * 8]
    assert not client.port.emulated.board.switched_on()


def test_a_torque_stands_no_longer_than_said(client: RigClient) -> None:
    """A person who measures for longer than LONGEST_HOLD measures no torque at the end, and did before."""
    seen: list[tuple[float, int]] = []

    class Slow(Hands):
        def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
            if question.startswith("current at code 57"):
                start = self.emulated.time
                while self.emulated.time < start + LONGEST_HOLD + 0.2:
                    meanwhile()
                    seen.append((self.emulated.time - start, self.emulated.board.dac))
            return super().answer(question, meanwhile)

    BringUp(client, Slow(client)).run()
    assert {dac for time, dac in seen if time < LONGEST_HOLD - 2.0} == {57}
    assert {dac for time, dac in seen if time > LONGEST_HOLD + 0.1} == {0}


@pytest.fixture
def at_port(client: RigClient, monkeypatch: pytest.MonkeyPatch) -> Callable[[type[Hands]], Hands]:
    """Return what puts the emulated rig at each port, and a person at standard input."""

    def put(person: type[Hands]) -> Hands:
        hands = person(client)
        monkeypatch.setattr(bring_up, "SerialPort", lambda *_: client.port)
        monkeypatch.setattr(bring_up, "Terminal", lambda: hands)
        return hands

    return put


def test_command_writes_what_was_found(
    at_port: Callable[[type[Hands]], Hands], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 0, the verdict at the end, and a file in which each quantity is as expected; a second run keeps it.

    The steps on the page are those that the check prints, but for the numbers.
    """

    class Heard(Hands):
        def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
            answer = super().answer(question, meanwhile)
            print(f"   {question}: {answer}")
            return answer

    def steps(text: str) -> list[str]:
        return [re.sub(r"[\d.]+", "#", "\n".join(map(str.rstrip, step.splitlines()))) for step in text.split("\n\n")]

    at_port(Heard)
    out = tmp_path / "check.yaml"
    words = ["check", "--port", "/dev/ttyUSB0", "--output", str(out)]
    assert run("friction_bench", words) == 0
    printed = capsys.readouterr().out
    assert printed.splitlines()[-10] == "passed"
    shown = steps(re.findall(r"```text\n(1/9 .*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[0].strip())
    assert len(shown) >= 4
    assert [step for step in shown if step not in steps(printed)] == []
    document = yaml.safe_load(out.read_text())
    assert (document["verdict"], document["not_reached"]) == ("passed", [])
    assert [step["step"] for step in document["steps"]] == list(STEPS)
    assert {one["as_expected"] for step in document["steps"] for one in step["quantities"]} == {True}
    assert run("friction_bench", words) == 2
    assert "exists; accepted: a new name" in capsys.readouterr().err


def test_ctrl_c_takes_the_torque_away(
    at_port: Callable[[type[Hands]], Hands], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Interrupted under torque the stage is off before the watchdog could act, and what was found is written."""

    class Frightened(Hands):
        def answer(self, question: str, meanwhile: Callable[[], object]) -> str | None:
            if question.startswith("current at code 114"):
                assert (self.emulated.board.stage_on, self.emulated.board.dac) == (True, 114)
                raise KeyboardInterrupt
            return super().answer(question, meanwhile)

    hands, out = at_port(Frightened), tmp_path / "check.yaml"
    assert run("friction_bench", ["check", "--port", "/dev/ttyUSB0", "--output", str(out)]) == 130
    assert "interrupted; the torque is off" in capsys.readouterr().err
    hands.emulated.advance(0.03)
    assert (hands.emulated.board.stage_on, hands.emulated.board.dac) == (False, 0)
    document = yaml.safe_load(out.read_text())
    assert document["verdict"] == "incomplete"
    assert document["steps"][-1]["left_out"] == ["interrupted"]


def test_no_firmware_is_found_by_the_first_step(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A line on which nobody answers: exit code 3, what to look at, and a file that says so."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    out = tmp_path / "check.yaml"
    try:
        assert run("friction_bench", ["check", "--port", os.ttyname(slave), "--output", str(out)]) == 3
    finally:
        os.close(master)
        os.close(slave)
    assert "failed; no rig answers within 3 s" in capsys.readouterr().out
    document = yaml.safe_load(out.read_text())
    assert (document["verdict"], document["firmware"]) == ("failed", "did not answer")
    assert document["not_reached"] == list(STEPS)[1:]


@pytest.mark.usefixtures("warm")
def test_terminal_keeps_the_rig_alive_while_it_waits(rig: Rig, tmp_path: Path) -> None:
    """As a process, with answers that come when they are asked for: under torque the rig waits for them."""
    pty_rig = PatientRig(EmulatedRig(rig, 1), tmp_path / "rig")
    pty_rig.patient = True
    words = ["check", "--port", str(tmp_path / "rig"), "--output", str(tmp_path / "check.yaml")]
    process = subprocess.Popen(
        command("friction_bench", *words), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        output = b""

        def until(text: bytes) -> None:
            nonlocal output
            while text not in output:
                data = os.read(process.stdout.fileno(), 4096)
                assert data, output.decode()
                output += data

        process.stdin.write(b"2,76 V\nalmost nothing\n0\n\n\n")  # idle, and the stage on
        process.stdin.flush()
        until(b"'almost nothing'; accepted: a number of V, or Enter")
        until(b"with the stage on: expected 0")
        time = pty_rig.emulated.time
        while pty_rig.emulated.time < time + 0.5:  # four times the watchdog's
            assert process.poll() is None
        assert pty_rig.emulated.board.stage_on
        out, _ = process.communicate(b"0\n2.8\ns\n", timeout=TIMEOUT)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
        pty_rig.close()
    assert process.returncode == 1, out
    document = yaml.safe_load((tmp_path / "check.yaml").read_text())
    verdicts = {step["step"]: step["verdict"] for step in document["steps"]}
    assert [verdicts[title] for title in (LINE, IDLE, ENABLE, SET_POINT)] == [
        "passed", "incomplete", "passed", "incomplete",
    ]  # fmt: skip
    found = [one["found"] for one in document["steps"][1]["quantities"]][2:]
    assert found == [2.76, 0.0, "not measured"]


def test_a_comparison_holds_up_to_its_tolerance() -> None:
    """The bound itself is good, what lies beyond is not, nor is what was not measured."""
    one = Comparison("VSET", "V", 1.0, 0.5)
    found = [replace(one, found=value).good for value in (0.5, 1.5, 0.49, 1.51, None)]
    assert found == [True, True, False, False, False]
