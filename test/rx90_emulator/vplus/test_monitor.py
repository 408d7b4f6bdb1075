"""The monitor of V+ as programs talk to it: what comes back for each line, and a client on a TCP port."""

import math
import re
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rx90_common.base.errors import ExchangeError, SupervisionError
from rx90_common.process.lines import TcpLine
from rx90_emulator.cabinet.arm import ProgrammedArm
from rx90_emulator.cabinet.cell import PERIOD, Cell
from rx90_emulator.loop.setup import Setup
from rx90_emulator.loop.stepped import SteppedLoop
from rx90_emulator.vplus.monitor import Monitor, serve

Talk = Callable[..., str]


def cell_of(setup: Setup) -> Cell:
    arm = ProgrammedArm(setup)
    return Cell(arm, SteppedLoop(setup, arm.ready, PERIOD, keep=False))


@pytest.fixture
def talk(shipped: Setup, tmp_path: Path) -> Talk:
    """Return what types a line, lets beats pass until the monitor takes the next one, and returns what was shown."""
    monitor = Monitor(cell_of(shipped), tmp_path)

    def type_line(line: str, beats: int = 0, end: str = "\r\n") -> str:
        monitor.output.clear()
        monitor.receive(f"{line}{end}".encode())
        for _ in range(beats):
            monitor.beat()
        while monitor.is_busy:
            monitor.beat()
        return monitor.output.decode()

    return type_line


def until(talk: Talk, line: str, what: str) -> str:
    """Type a line until a pattern has been shown; return all that was shown."""
    shown = ""
    for _ in range(500):
        shown += talk(line, 1)
        if re.search(what, shown):
            return shown
    raise AssertionError(shown)


NUMBER = r"\s+-?\d+\.\d{3}"


@pytest.mark.parametrize(
    ("lines", "shown"),
    [
        (["where"], r"where\r\n +X .* Hand\r\n( +-?\d+\.\d{3}){7}\r\n +J1 .*\r\n( +-?\d+\.\d{3}){6}\r\n\."),
        (["speed 30.00"], r"speed 30.00\r\n\."),
        (["en po"], r"en po\r\n\r\n\."),
        (["do delay 0.001"], r"do delay 0.001\r\n\."),
        (["LISTL hand.tool"], r"LISTL hand.tool\r\n +X/J1 .*\r\n\."),
        (
            ["do set hand.tool = trans(1, 2, 3)", "listl hand.tool"],
            r".*\r\n.*\r\nhand.tool +1.000 +2.000 +3.000.*\r\n\.",
        ),
        (["do set #o = #PPOINT(0,-90,90)", "listl #o"], r".*\r\n.*\r\n#o +0.000 +-90.000 +90.000 .*\r\n\."),
        (["HERE o"], rf"HERE o\r\n.*\r\n({NUMBER}){{6}}\r\nChange\? "),
        (["HERE o", "1,,3", "", "listl o"], r".*\r\n.*\r\no +1.000 +-?0.000 +3.000 .*\r\n\."),
        (["do x = 4", 'do $s = "a"', "listr"], r"listr\r\nx = 4.0\r\n\."),
        (["do x = 4", "point x"], r"point x\r\n\*Illegal value\* a real; accepted: a location\r\n\."),
        (["HERE o[1]", " 1 2  3", "", "listl o"], r".*\r\n.*\r\no\[1\] +1.000 +2.000 +3.000 .*\r\n\."),
        (["do x = 1", "here o[x]", "listl o"], r"listl o\r\n +X/J1 .*r/J6\r\n\."),
        (["HERE o", "\x03listl o"], r"\r\n\.listl o\r\n.*\r\no +0.000 .*\r\n\."),
        (["point o", "1, nan"], r"1, nan\r\n\*Arithmetic overflow\* nan\r\n\."),
        (["speed 30, 50"], r"speed 30, 50\r\n\."),
        (["speed " + 240 * "-" + "5"], r".*\r\n\*Expression too complex\*\r\n\."),
        (["store away/"], r".*\r\n\*Illegal file name\* away/\r\n\."),
        (["point o[x]"], r"point o\[x\]\r\n\*'x\]' is not expected\*\r\n\."),
        (["edit 1"], r"edit 1\r\n\*'1' is not expected\*\r\n\."),
        (["do x = 4", 'do $s = "a"', "lists"], r'lists\r\n\$s = "a"\r\n\.'),
        (["nonsense"], r"nonsense\r\n\*Unknown command\*\r\n\."),
        (["do x = y"], r"do x = y\r\n\*Undefined value\* y\r\n\."),
        (["do move trans(5000)"], r".*\r\n\*Location out of range\* 5.000 m from the shoulder\r\n\."),
        (["do if x then"], r".*\r\n\*Illegal monitor command\*\r\n\."),
        (["exec nobody"], r".*\r\n\*Undefined program or variable name\* nobody\r\n\."),
        (["abort"], r"abort\r\n\."),
        (["status"], r"status\r\nTask 0  idle\r\n\."),
        (["load ../x"], r".*\r\n\*Illegal file name\*.*\r\n\."),
        (["", "tool null"], r"tool null\r\n\."),
    ],
)
def test_each_line_is_answered_as_on_the_cabinet(talk: Talk, lines: list[str], shown: str) -> None:
    """Echo, lines, the dot; errors begin with an asterisk; questions wait behind their mark."""
    for line in lines:
        answer = talk(line)
    assert re.fullmatch(shown, answer), answer


@pytest.mark.parametrize(("before", "end"), [("", "\r"), ("", "\n"), ("", "\r\n"), ("", "\n\r"), ("\r", "\n")])
def test_a_line_ends_once_however_a_client_ends_it(talk: Talk, before: str, end: str) -> None:
    """Public software sends each of these, whatever came before; an empty line more would end the question of POINT."""
    talk(before, end="")
    for line in ("point a", "1,2,3", "", "listl a"):
        answer = talk(line, end=end)
    assert re.search(r"\na +1.000 +2.000 +3.000 ", answer)


def test_a_program_is_edited_run_stored_and_loaded(talk: Talk) -> None:
    """EDIT asks line by line; a program runs behind the prompt, and is aborted; its text comes back from a file."""
    assert talk("EDIT p(x)").endswith("    1 ? ")
    assert talk("TYPE x").endswith("    2 ? ")
    talk("DRIVE 1, 10, 50")
    talk("ATTACH (1)")  # the pendant
    talk("E")
    assert talk("exec p(7), 2") == "exec p(7), 2\r\n."  # two cycles
    assert talk("exec p").endswith("*Program task already active*\r\n.")
    shown = until(talk, "status", r"\r\nProgram completed\r\n\.")
    assert shown.count(" 7\r\n") == 2
    assert re.fullmatch(r"Task 0  running  p.*", [line for line in shown.splitlines() if "Task" in line][-1])
    assert "idle" in talk("status")
    until(talk, "where", r"\r\n +20\.00\d ")
    assert talk("store a") == "store a\r\n."
    assert talk("delete p").endswith("(Y/N)? ")
    assert talk("Y").endswith(".")
    assert talk("listp") == "listp\r\n."
    assert ".PROGRAM p\r\n" in talk("load a")
    assert "DRIVE 1, 10, 50\r\n" in talk("listp p")
    talk("exec p(1)")
    until(talk, "status", " 1\r\n")
    assert talk("abort").endswith("(Y/N)? ")
    assert "stopped  p" in [talk("Y"), talk("status")][-1]
    assert "Unknown instruction* step 1" in [talk(line) for line in ("EDIT q", "NONSENSE", "E")][-1]


def test_an_empty_program_without_end_lets_the_monitor_answer(talk: Talk) -> None:
    """A cycle that takes no time is no endless loop."""
    for line in ("EDIT p", "E", "exec p, -1"):
        talk(line)
    assert "Task 0  running" in talk("status", 3)
    assert "idle" in [talk(line, 2) for line in ("kill", "status")][-1]


def test_a_program_asks_and_goes_on_where_it_stopped(talk: Talk) -> None:
    """PROMPT waits for a line; RETRY does the step that failed once more, PROCEED goes on behind it."""
    for line in ("EDIT p", 'PROMPT "name? ", $n', 'PROMPT "", y', "TYPE $n, x, y", "PAUSE", 'TYPE "end"', "E"):
        talk(line)
    for number in ("1E999", "^H" + 300 * "F"):
        talk("exec p", 3)
        talk("Ann", 3)
        assert "*Arithmetic overflow*" in talk(number, 3)
    assert talk("exec p", 3).endswith("name? ")
    talk("Ann", 3)
    assert "*Undefined value*" in talk("^B2", 3)  # no digit of base 2
    talk("do x = 5")
    assert "Ann 5 0\r\n\r\n*Program paused*" in talk("retry", 3)
    assert "end\r\n\r\nProgram completed" in talk("proceed", 3)


def test_no_step_is_lost_or_done_twice_where_a_busy_program_is_stopped(talk: Talk) -> None:
    """ABORT falls between two steps; PROCEED and RETRY both go on with the second, in a called program, too."""
    for line in ("EDIT s", "c = c+1", "d = d+1", "e = e+1", "E", "EDIT p", "WHILE TRUE DO", "CALL s", "END", "E"):
        talk(line)
    talk("do c = 0")
    talk("do d = 0")
    talk("do e = 0")
    talk("exec p", 1)
    for word in ("retry", "proceed", "retry", "retry", "proceed", "retry", "retry", "retry"):
        talk("abort")
        talk("y")
        c, d, e = (int(float(value)) for value in re.findall(r"= (\S+)", talk("listr c, d, e")))
        assert c - 1 <= e <= d <= c
        talk(word, 1)
    assert e > 300


def test_a_program_with_units_has_what_is_typed(talk: Talk) -> None:
    """Between its READs, too, until all are given up; blanks separate numbers where no comma does. Ctrl-C drops it."""
    loop = ("FOR i = 1 TO 2", "READ (lun) a, b, c", "WRITE (lun) a, b, c", "WAIT.EVENT , 0.1", "END")
    units = ('ATTACH (lun, 4) "SERIAL:1"', "ATTACH (5)", *loop, "DETACH (lun)", *loop, "DETACH (5)", "WAIT FALSE")
    for line in ("EDIT p", *units, "E", "exec p"):
        talk(line, 1)
    assert " 1 -2.5 3\r\n" in talk(" 1 -2.5, 3", 3)
    for line in ("4 , 5", "- 5, 3, 20 mm", "6"):
        assert talk(line, 1) == ""
    assert re.search(r"(?s) 4 5 0\r.* 0 3 20\r.* 6 0 0\r\nstatus\r\nTask 0  running", talk("status", 60))
    talk("kill")
    talk("exec p", 1)
    for line in ("1", "3,4", "nonsense"):
        talk(line)
    assert talk("\x03") == 2 * "\r\n."  # behind it, and behind an empty line
    assert "\r\n." in talk('do prompt "? ", x\r\x03', 3, "")
    assert "X/J1" in talk("listl")
    assert talk("exec p", 3) == "exec p\r\n."


@pytest.mark.parametrize("word", ["panic", "dis po"])
def test_panic_and_speed_act_while_a_program_runs(talk: Talk, word: str) -> None:
    """SPEED slows it down at once, PANIC and no power end it and its motion; what is wrong is refused."""
    for line in ("EDIT p", "DRIVE 1,60,20", "BREAK", "E", "exec p"):
        talk(line, 2)
    assert talk("speed 50", 3) == "speed 50\r\n."
    assert "Illegal value" in talk("speed 0")
    assert talk(word, 30) == f"{word}\r\n."
    assert "Task 0  stopped" in talk("status")
    here = talk("where")
    assert talk("where", 20) == here


def test_nodes_that_are_away_are_no_power_cut(shipped: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The monitor says what it does not hear, and goes on with its programs when they are back."""
    monitor = Monitor(cell_of(shipped), tmp_path)

    def silent(*_: object) -> None:
        raise ExchangeError("the arm's time stands still")

    with monkeypatch.context() as away:
        away.setattr(monitor.task.cell.drive, "send", silent)
        monitor.beat()
    assert "*the arm's time stands still*" in monitor.output.decode()
    assert "POWER" in monitor.task.cell.switches
    monitor.beat()


def test_a_place_where_nothing_can_be_written_is_refused(shipped: Setup, tmp_path: Path) -> None:
    """STORE says so in a line, and the monitor goes on."""
    monitor = Monitor(cell_of(shipped), tmp_path / "away")
    monitor.receive(b"store a\r")
    assert re.search(r"\r\n\*.*cannot be written.*\*\r\n\.$", monitor.output.decode())


def test_a_reaction_that_was_aborted_comes_again(talk: Talk) -> None:
    """Its priority does not stay behind."""
    for line in ("EDIT late", "TYPE 5", "WAIT FALSE", "E", "EDIT p", "SIGNAL -5", "REACT 5, late", "SIGNAL 5", "E"):
        talk(line)
    for _ in range(2):
        assert " 5\r\n" in talk("exec p", 3)
        talk("abort")
        talk("y")


def test_a_reaction_of_a_stopped_program_waits_until_it_goes_on(talk: Talk) -> None:
    """It answers no instruction of the monitor."""
    for line in ("EDIT late", "TYPE 5", "E", "EDIT p", "SIGNAL -5", "REACT 5, late", "PAUSE", "TYPE 6", "E"):
        talk(line)
    talk("exec p", 3)
    assert talk("do signal 5", 3) == "do signal 5\r\n."
    assert " 6\r\n 5\r\n" in talk("proceed", 3)


def test_the_arm_moves_again_behind_a_power_cut(shipped: Setup, tmp_path: Path) -> None:
    """The supervision is told of once, motions are refused until ENABLE POWER, and begin where the arm then stands."""
    cell = cell_of(shipped)
    monitor = Monitor(cell, tmp_path)
    cell.queue.position = cell.queue.position + 0.3
    lines = {"where": "Soft envelope error", "do drive 1, 10, 50": "*Robot power off*\r\n.", "en po": "en po\r\n\r\n."}
    for line, answer in lines.items():
        monitor.receive(f"{line}\r".encode())
        for _ in range(20):
            monitor.beat()
        assert monitor.output.decode().count(answer) == 1
    stood = cell.drive.position()
    monitor.receive(b"do drive 1, 10, 50\r")
    for _ in range(60):
        monitor.beat()
    assert cell.drive.position() - stood == pytest.approx([math.radians(10), 0, 0, 0, 0, 0], abs=2e-4)


def test_a_motion_that_waits_is_refused_behind_a_power_cut(
    shipped: Setup, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does not begin without power."""

    def cut(*_: object) -> None:
        raise SupervisionError("too fast")

    cell = cell_of(shipped)
    monitor = Monitor(cell, tmp_path)
    monitor.receive(b"do drive 1, 40, 20\rdo drive 1, -20, 5\r")
    for _ in range(20):
        monitor.beat()
    assert monitor.is_busy
    with monkeypatch.context() as away:
        away.setattr(cell.drive, "send", cut)
        monitor.beat()
    while monitor.is_busy:
        monitor.beat()
    assert re.search(r"(?s)Soft envelope error.*\*Robot power off\*\r\n\.$", monitor.output.decode())
    assert cell.queue.at_end


def test_a_program_waits_while_nobody_takes_what_it_shows(shipped: Setup, tmp_path: Path) -> None:
    """The output stays short; an interrupt empties it and ends the program."""
    monitor = Monitor(cell_of(shipped), tmp_path)
    monitor.receive(b'EDIT p\rDO\rTYPE "much"\rUNTIL FALSE\rE\rexec p\r')
    for _ in range(100):
        monitor.beat()
    assert 4096 < len(monitor.output) < 8192
    monitor.receive(b"\x03")
    monitor.beat()
    assert monitor.output == b"\r\n."


def test_a_client_talks_over_tcp(shipped: Setup, tmp_path: Path) -> None:
    """A relative motion along the tool is done while the client asks where the arm is."""
    cell = cell_of(shipped)
    served = TcpLine(0)
    words = {"waits": True}
    threading.Thread(target=serve, args=(cell, tmp_path, served, 2400), kwargs=words, daemon=True).start()
    port = int(served.name.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port), timeout=30) as line:
        stream = line.makefile("rwb", buffering=0)

        def command(text: str) -> list[str]:
            stream.write(text.encode() + b"\r")
            lines = [stream.readline().decode().strip()]
            while stream.read(1) != b".":
                lines.append(stream.readline().decode().strip())
            return lines

        assert stream.read(1) == b"."
        command("do move #ppoint(0,-90,180,0,90,0)")
        command("do break")
        command("do moves here:trans(0,0,-40)")
        command("do break")
        began = time.monotonic()
        lines = command("where")
        place = [float(number) for number in lines[2].split()]
        assert 1.0 < (time.monotonic() - began) / (10 * len("".join(lines)) / 2400) < 20.0  # bits of a byte
        assert place[:3] == pytest.approx([450, 0, 405], abs=0.1)
        stream.write(20 * b"where\r")
    with socket.create_connection(("127.0.0.1", port), timeout=30) as line:  # gets nothing of the other one's
        stream = line.makefile("rwb", buffering=0)
        assert stream.read(1) == b"."
        stream.write(b"status\r")
        assert stream.readline() == b"status\r\n"
