"""Programs of V+: whole cases worked out by hand, and tables of lines with their text, faults and motions."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rx90_common.base.errors import ConfigError
from rx90_controller.lines.task import LineTask
from rx90_emulator.cabinet.arm import Joints
from rx90_emulator.cabinet.cell import Change, load_inputs
from rx90_emulator.cabinet.locations import six_numbers
from rx90_emulator.cabinet.record import ProgramRun
from rx90_emulator.cli.frame import run
from rx90_emulator.loop.line import run_line
from rx90_emulator.loop.parameters import with_parameters
from rx90_emulator.loop.setup import Setup
from rx90_emulator.vplus.program import load_programs, read
from rx90_emulator.vplus.run import Options, run_program
from rx90_emulator.vplus.tree import Memory, Readings
from rx90_emulator.vplus.values import LoadError

CASES = Path(__file__).parents[2] / "reference/vplus"
EXPECTED: dict[str, Any] = yaml.safe_load((CASES / "expected.yaml").read_text(encoding="utf-8"))
Array = NDArray[np.float64]


def flange(joints: Sequence[float]) -> tuple[Array, Array]:
    """Return rotation and place, mm, of the flange by the arm's geometry alone, at joint values of V+."""
    q = np.radians(np.array(joints) - [0, -90, 90, 0, 0, 0])
    turns = [Rotation.from_euler(axis, angle) for axis, angle in zip("zyyzyz", q, strict=True)]
    upper = turns[0] * turns[1]
    fore = upper * turns[2]
    hand = fore * turns[3] * turns[4]
    return (hand * turns[5]).as_matrix(), upper.apply([0, 0, 450]) + fore.apply([0, 0, 450]) + hand.apply([0, 0, 85])


def memory_of(text: str, **readings: Any) -> Memory:
    """Return the programs of a text, which has no faults; lines alone are a program."""
    memory = Memory(Readings(**readings))
    reader = read(text if ".PROGRAM" in text else f".PROGRAM p()\n{text}\n.END\n", memory)
    assert reader.faults == []
    return memory


def ran(setup: Setup, text: str, *inputs: Change, **options: Any) -> ProgramRun:
    chosen = Options(**{"idle": 5.0, "longest": 30.0, **options})
    return run_program(setup, memory_of(text), inputs=inputs, options=chosen)


def shown(run: ProgramRun) -> list[str]:
    assert run.error is None
    return [line for _, line in run.lines]


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_a_case_does_what_was_worked_out_by_hand(shipped: Setup, name: str) -> None:
    """Motions, joints, pose, times, text and signals of whole programs are those of the table."""
    expected = EXPECTED[name]
    inputs = [Change(time, signal, True) for signal, time in expected.get("inputs", {}).items()]
    done = run_program(shipped, load_programs(CASES / f"{name}.v2"), inputs=inputs)
    assert done.error is None
    assert len(done.motions) == expected["motions"]
    end = done.cell.arm.joints(done.cell.queue.destination)
    if "joints" in expected:
        assert end == pytest.approx(expected["joints"], abs=0.01)
        measured = done.cell.arm.joints(done.cell.drive.position())
        assert measured == pytest.approx(expected["joints"], abs=0.02)  # with friction
    least, most = expected.get("time", [expected.get("time_min", 0.0), 60.0])
    assert least <= done.cell.time <= most
    if "pose" in expected:
        tool = done.motions[-1].tool
        rotation, place = flange(end)
        *xyz, yaw, pitch, roll = expected["pose"]
        assert place + rotation @ tool.translation == pytest.approx(xyz, abs=0.01)
        wanted = Rotation.from_euler("ZYZ", [yaw, pitch, roll], degrees=True).as_matrix()
        assert rotation == pytest.approx(wanted, abs=2e-4)
    texts = [re.escape(line).replace(r"<4\.00\ to\ 4\.60>", r"4\.[0-6]\d") for line in expected.get("output", [])]
    lines = [line.replace("-0.000", " 0.000") for line in shown(done)]
    assert len(lines) == len(texts)
    for line, text in zip(lines, texts, strict=True):
        assert re.fullmatch(text, line), line
    for signal, times in expected.get("outputs", {}).items():
        changes = [change.time for change in done.cell.changes if change.signal == signal]
        assert changes == ([] if times == "never" else [pytest.approx(np.mean(times), abs=0.1)])


def test_the_seam_is_straight_and_as_accurate_as_the_same_line(shipped: Setup) -> None:
    """Set-points keep to the line; the laser burns until the arm has settled; the path error is that of `run_line`."""
    done = run_program(shipped, load_programs(CASES / "c04_weld_line.v2"))
    seam = done.motions[3]
    asked = done.tracks[3].asked
    assert np.abs(1e3 * asked[:, [0, 2]] - [600, 270]).max() < 0.01
    assert [change.time for change in done.cell.changes] == [seam.began, seam.settled]  # BREAK waits for it
    assert 0.0 < seam.settled - seam.ended < 0.3
    series = (done.result.slow.reference, done.result.slow.joint_states)
    ends = [flange(done.cell.arm.joints(rows[round(1e3 * seam.ended), 0])) for rows in series]
    tools = [place + 200 * rotation[:, 2] for rotation, place in ends]
    assert seam.nulled == pytest.approx(math.dist(*tools), rel=1e-3)
    line = LineTask((0.6, -0.2, 0.27), (0.6, 0.2, 0.27), speed=0.1, acceleration=1 / 3)
    assert seam.error == pytest.approx(1e3 * run_line(shipped, line).path_accuracy.worst, rel=0.3)


@pytest.mark.parametrize(
    ("lines", "text"),
    [
        ("TYPE 7 MOD 4, -7 MOD 4, 2+3*4, (2+3)*4, 10/4", " 3 -3 14 20 2.5"),
        ("TYPE TRUE, 3 > 2, NOT 0, COM 5, 6 BAND 3, 6 BOR 3, 6 BXOR 3", " -1 -1 -1 -6 2 7 5"),
        ("TYPE ^B101, ^O17, ^HFF, 'A, 1.5E2", " 5 15 255 65 150"),
        ("TYPE INT(-2.7), FRACT(-2.75), SIGN(0), ABS(-3), SQR(3), SQRT(16)", " -2 -0.75 1 3 9 4"),
        ("TYPE SIN(30), COS(60), ATAN2(1,1), MIN(3,1,2), MAX(3,1,2), OUTSIDE(1,5,3)", " 0.5 0.5 45 1 3 -1"),
        ('TYPE $MID("abcdef",2,3), LEN("abc"), POS("hello","l"), ASC("A"), VAL("12.5x")', "bcd 3 3 65 12.5"),
        ('TYPE /I4, 7, /F7.2, 3.14159, /H4, 255, /X2, "x"', "   7   3.14  FF  x"),
        ('IF "abc" == "ABC" THEN\nTYPE "same"\nEND', "same"),
        ("FOR i = 1 TO 5 STEP 2\nTYPE i, /S\nEND\nTYPE i", " 1 3 5 7"),
        ("FOR i = 3 TO 1\nTYPE i\nEND\nTYPE i", " 3"),
        ("i = 0\nWHILE i < 3 DO\ni = i+1\nIF i == 2 THEN\nNEXT\nEND\nTYPE i, /S\nEND\nTYPE", " 1 3"),
        ("i = 0\nDO\ni = i+1\nUNTIL i >= 4\nTYPE i", " 4"),
        ("FOR i = 1 TO 3\nFOR j = 1 TO 3\nIF j == 2 THEN\nEXIT 2\nEND\nEND\nEND\nTYPE i, j", " 1 2"),
        ("i = 3\nCASE i OF\nVALUE 1, 2:\nTYPE 1\nVALUE 3:\nTYPE 3\nANY\nTYPE 9\nEND", " 3"),
        ("i = 0\n10 i = i+1\nIF i < 5 GOTO 10\nTYPE i", " 5"),
        ("a[2,3] = 4\na[0,1] = 1\nTYPE a[2,3], LAST(b[])", " 4 -1"),
        ("SET p = TRANS(1,2,3):RZ(90):TRANS(1)\nTYPE DX(p), DY(p), DZ(p)", " 1 3 3"),
        ("SET p = TRANS(0,0,0,10,-20,30)\nDECOMPOSE d[0] = p\nTYPE /F6.1, d[3], d[4], d[5]", "-170.0  20.0-150.0"),
        ("TYPE INRANGE(TRANS(500,0,0,0,180)), INRANGE(#PPOINT(0,90)), CONFIG()", " 0 2 0"),
        ("BITS 1, 4 = 5\nLOCK 2\nDECOMPOSE j[0] = #PHERE\nTYPE BITS(1,4), /F4.0, j[1], /I0, 7", " 5 -907"),
        ("TYPE DEFINED(x)\nx = 1\nTYPE DEFINED(x)", " 0| -1"),
        ("u = 7\nATTACH (u)\nATTACH (v, 4)\nTYPE u, v", " 7 10"),
        ("ATTACH ()\nACCEL (1) 50\nDETACH (0)\nTYPE ACCEL(1), ACCEL(2)", " 50 100"),
        ('WAIT.EVENT 1,\nBITS 1, = 1\nREACT 5, p,\nSIGNAL 5\nTYPE POS("ab", "b",), BITS(1,)', " 2 1| 2 1"),
        ("ACCEL 0, 2000\nTYPE ACCEL(1), ACCEL(2)", " 1 1000"),
        ('.PROGRAM p()\nx = 1\nCALLS "q"(x)\nTYPE x\n.END\n.PROGRAM q(a)\na = 2\n.END', " 2"),
        ("JMOVE 5, -80\nBREAK\nJHERE a, b, c\nTYPE INT(a+0.5), INT(b-0.5), INT(c+0.5)", " 5 -80 90"),
        ("SIGNAL 1, -2, 3\nTYPE SIG(1,-2), SIG(2), BITS(1,3)", " -1 0 5"),
        ("very.long.name.one = 1\nvery.long.name.two = 2\nTYPE very.long.name.one", " 2"),
    ],
)
def test_lines_show_what_they_should(shipped: Setup, lines: str, text: str) -> None:
    """Operators, functions, control and locations, each line by its own text."""
    assert shown(ran(shipped, lines)) == text.split("|")


def test_a_reading_changes_how_and_binds_and_is_warned_of(shipped: Setup) -> None:
    """A bare comparison beside AND means two things; the switch decides, and the line is named."""
    program = ".PROGRAM p()\nx = 1\nTYPE {}\n.END"
    for lines, warned in (("x == 1 AND 2 == 2", [3]), ("(x == 1) AND (2 == 2)", []), ("1 AND x", [])):
        assert [line for line, _ in read(program.format(lines), Memory()).warnings] == warned
    for logic_first, text in ((True, " 0"), (False, " -1")):
        memory = memory_of(program.format("x == 1 AND 2 == 2"), logic_before_relations=logic_first)
        assert shown(run_program(shipped, memory)) == [text]


@pytest.mark.parametrize(
    ("text", "faults"),
    [
        ("IF x THEN", ["2: IF without END"]),
        ("END\nNEXT\nGOTO 7", ["2: END without its block", "3: NEXT 1 within 0 loops", "4: there is no label 7"]),
        ("IF foo(1) THEN\nEND\nEND", ["2: 'IF foo(1) THEN'", "4: END without"]),
        ("10 x = 1\n10 x = 2", ["3: label 10; accepted: each once, 0 to 65535"]),
        (
            "x = SIN()\nMOVE\ny = foo(1)",
            ["SIN has 0 arguments; accepted: degrees", "MOVE has 0", "*Undefined program"],
        ),
        ("VPICTURE (1)\nALTER () 1\nx = GETC(5)", ["vision is not emulated", "ALTER needs", "GETC is not there"]),
        ("NONSENSE 3\nx = foo(1)", ["*Unknown instruction*", "*Undefined program or variable name* foo("]),
        ("x = 1\nAUTO y", ["stands behind an executable line"]),
        ("x = (1\nto = 3\nx = 1 +", ["2: 'x = (1': the line ends", "to is a reserved word", "'x = 1 +': the"]),
        ("TYPE " + "-" * 240 + "1", []),  # a fault or none, by the interpreter's depth, and no RecursionError
        ("TYPE " + "1+" * 5000 + "1", ["a line of 10006 characters; accepted: up to 255"]),
        (".END\nnonsense", [".END without a program", "'nonsense': outside of a program", ".END without a program"]),
        (".END\n.LOCATIONS\np 1 2 3\n.END\n.REALS\nx nan", ["3 numbers; accepted: 1, or 6", "'nan' is not"]),
        (".END\n.REALS\na[] 5\na[-1] 5\na[i] 5", ["5: 'a[-1] 5': '-1] 5' is not expected", "6: 'a[i] 5': 'i] 5'"]),
        (".END\n.REALS\npi 3\ntime 5", ["4: 'pi 3': pi is a reserved word", "5: 'time 5': time is a reserved word"]),
        (".END\n.PROGRAM q(1)", ["3: '.PROGRAM q(1)': '1)' is not expected"]),
    ],
)
def test_all_faults_of_a_file_are_found_with_their_lines(text: str, faults: list[str]) -> None:
    """Each fault has its line, and the ones behind it are found, too."""
    found = [f"{line}: {fault}" for line, fault in read(f".PROGRAM p()\n{text}\n.END\n", Memory()).faults]
    for fault in faults:
        assert any(fault in one for one in found), found


def test_a_variable_declared_without_a_blank_is_the_programs_own(shipped: Setup) -> None:
    """`AUTO$s` is `AUTO $s`: a program that is called does not see it."""
    text = '.PROGRAM p()\nAUTO{}$s\n$s = "a"\nCALL q\n.END\n.PROGRAM q()\nTYPE DEFINED($s)\n.END\n'
    assert [shown(run_program(shipped, memory_of(text.format(blank)))) for blank in ("", " ")] == 2 * [[" 0"]]


@pytest.mark.parametrize(
    ("lines", "error"),
    [
        ("x = 1/0", "*Division by zero*: / of 1.0, 0.0; Program task 0 stopped at p, step 1, line 2"),
        ("TYPE x", "*Undefined value* (-401, number from memory): x; Program"),
        ("CALL nobody", "*Undefined program or variable name* (-406, number from memory): nobody"),
        ("x = 1E38*1E38", "*Arithmetic overflow*: 1e+76"),
        ("a[-1] = 1", "*Illegal array index* (-404"),
        ("MOVE TRANS(2000,0,0)", "*Location out of range* (-610"),
        (
            "MOVE #PPOINT(0,90)",
            "*Position out of range* Jt 2 (-1023, number from memory): 90.000 deg; accepted: -227.5",
        ),
        ("DRIVE 7,1,1", "*Illegal value* (-402, number from memory): 7 joint; accepted: 1 to 6"),
        ("SPEED 0", "*Illegal value* (-402, number from memory): 0 percent; accepted: 0.001 to 1000"),
        ("x = TRANS(1)", "*Illegal assignment*: x = a location; accepted: SET x = ..."),
        ("SIGNAL 5000", "*Illegal digital signal*: 5000"),
        ("TYPE SQRT(-1)", "*Illegal value* (-402, number from memory): SQRT of -1.0"),
        ("WHILE TRUE DO\nEND", "*Time-out*: no motion for 5 s, waiting for the processor; stopped in p, line"),
        ("WAIT SIG(1001)", "*Time-out*: no motion for 5 s, waiting for WAIT; stopped in p, line 2"),
        ("CALL p", "*Not enough program stack space* (-413, number from memory): 1000 calls within each other"),
        ("MOVES TRANS(500,0,0,0,180)", "*Soft envelope error* Mtr"),  # from the straight arm: singular
        ("$s = 5", "*Illegal assignment*: $s is a string, and the value a real"),
    ],
)
def test_what_cannot_be_done_stops_the_program_with_a_line(shipped: Setup, lines: str, error: str) -> None:
    """V+'s text, program, step and line; endless waiting ends."""
    done = ran(shipped, lines)
    assert str(done.error or "").startswith(error)
    assert "\n" not in str(done.error)


CORNER = "MOVE #PPOINT(0,-90,180,0,90,0)\nBREAK\nSPEED 100 MMPS ALWAYS\n"
CORNER += "MOVES TRANS(450,100,365,0,180)\nMOVES TRANS(550,100,365,0,180)\n"


@pytest.mark.parametrize(
    ("lines", "gap"),
    [
        ("", math.sqrt(2) * 100 * 0.3 / 8),  # scaled accelerations: |u2 - u1| v T / 8
        ("DISABLE SCALE.ACCEL\nACCEL 30,30\n", math.sqrt(2) * 100**2 / (8 * 1500)),  # |u2 - u1| v^2 / 8a
        ("CPOFF ALWAYS\n", 0.0),
        ("SPEED 40 MONITOR\n", math.sqrt(2) * 100 * 0.3 / 8),  # the path stays as it is
    ],
)
def test_a_corner_is_rounded_as_speed_and_acceleration_say(shipped: Setup, lines: str, gap: float) -> None:
    """The ramps of two lines add up to a parabola, whatever the monitor speed; without a continuous path none is."""
    done = ran(shipped, lines + CORNER, period=1e-3 if "SCALE" in lines else 16e-3)
    places = np.concatenate([track.asked for track in done.tracks[1:]])
    nearest = np.linalg.norm(1e3 * places - [450, 100, 785], axis=1).min()
    assert nearest == pytest.approx(gap, abs=0.05 * gap + 0.01)
    alone = [motion.ended - motion.began for motion in done.motions[1:]]
    even = 1.0 + (0.1 / 1.5 if "SCALE" in lines else 0.3)  # s: way over speed, and a ramp
    slow = "MONITOR" in lines
    assert alone == pytest.approx([even / 0.4 if slow else even] * 2, abs=0.1 if slow else 0.02)


def test_short_lines_in_a_row_are_run_evenly(shipped: Setup) -> None:
    """Each ramps up while the one before ramps down: the tool keeps sqrt(L a), a = 5 m/s^2 times 8 % of the speed."""
    chain = "SPEED 120 MMPS ALWAYS\nFOR i = 1 TO 20\nMOVES TRANS(500,7*i,0,0,180)\nEND"
    done = ran(shipped, f"MOVE TRANS(500,0,0,0,180)\nBREAK\n{chain}")
    for track in done.tracks[4:18]:
        speeds = np.linalg.norm(np.diff(1e6 * track.asked, axis=0), axis=1)  # mm/s, of 1 ms
        assert speeds == pytest.approx(math.sqrt(7 * 5000 * 0.08), rel=0.02)


def test_the_program_goes_on_while_the_arm_moves(shipped: Setup) -> None:
    """Behind a motion the program goes on when it begins; DURATION is the least time; one-shot settings hold once."""
    lines = "CPOFF ALWAYS\nSPEED 50\nDURATION 2\nDRIVE 1,10,100\nSIGNAL 1\nDRIVE 1,10,100\nSIGNAL 2\nDELAY 0.5\nBREAK"
    done = ran(shipped, lines)
    assert [motion.profile.duration for motion in done.motions[::2]] == pytest.approx([2.0, 0.5])
    assert [change.time for change in done.cell.changes] == [motion.began for motion in done.motions[:2]]
    assert done.motions[1].began >= done.motions[0].ended
    assert done.cell.arm.joints(done.cell.queue.destination)[0] == pytest.approx(20)


def test_straight_motions_keep_and_others_change_the_configuration(shipped: Setup) -> None:
    """FLIP and BELOW lead to the same place with other joints; a line keeps the configuration."""
    moves = "FLIP\nMOVE TRANS(500,0,100,0,150)\nBREAK\nTYPE CONFIG(), /S\nNOFLIP\nBELOW\nMOVE TRANS(700,0,100,0,90)\n"
    done = ran(shipped, f"{moves}MOVES TRANS(710,0,100,0,90)\nBREAK\nTYPE CONFIG()")
    assert shown(done) == [" 4 2"]
    for motion, place in zip(done.motions, ([500, 0, 100], [700, 0, 100], [710, 0, 100]), strict=True):
        assert flange(done.cell.arm.joints(motion.end))[1] == pytest.approx(place, abs=1e-6)
    assert done.motions[0].end[4] < 0.0 < done.motions[1].end[4]


def test_reactions_interrupt_and_may_stop_the_motion(shipped: Setup) -> None:
    """A signal calls a program; REACTI ends the motion early, and the next one begins where the arm then is."""
    text = '.PROGRAM p()\nREACTI 1001, stopped\nSPEED 20\nDRIVE 1,60,10\nBREAK\nTYPE "on"\n.END\n'
    done = ran(shipped, text + ".PROGRAM stopped()\nTYPE TIMER(1) > 0.5\n.END", Change(1.0, 1001, True))
    assert shown(done) == [" -1", "on"]
    assert 1.0 < done.cell.time < 2.5
    assert 10.0 < done.cell.arm.joints(done.cell.queue.destination)[0] < 40.0


def test_a_motion_that_waits_survives_a_stop_of_the_one_before(shipped: Setup) -> None:
    """REACTI ends the motion under way; the one that waited, and its signal, come when the reaction is through."""
    text = ".PROGRAM p()\nREACTI 1001, q\nDRIVE 1,60,50\nOPEN\n{}\nSIGNAL 2\n{}\nBREAK\n.END\n"
    text += ".PROGRAM q()\nSIGNAL 1\n.END\n"
    for waiting, behind in (("MOVE #PPOINT(-10,-80,90)", ""), ("DELAY 0.2", "MOVE #PPOINT(-10,-80,90)")):
        done = ran(shipped, text.format(waiting, behind), Change(0.4, 1001, True))
        assert done.error is None
        assert [change.signal for change in done.cell.changes if change.signal < 3000] == [1, 2]
        assert 3001 in [change.signal for change in done.cell.changes]
        assert done.cell.arm.joints(done.cell.queue.destination)[:2] == pytest.approx([-10.0, -80.0])
        assert done.motions[0].ended < done.motions[0].over


def test_a_motion_behind_a_stop_begins_where_the_arm_stands(shipped: Setup) -> None:
    """BRAKE, and a reaction that stops: set-points do not jump, and only motions wait for the end of the stop."""
    behind = "SIGNAL 1\nDRIVE 1,-10,50\nBREAK"
    brake = f"DRIVE 1,60,50\nWAIT.EVENT , 0.4\nBRAKE\n{behind}"
    react = f".PROGRAM p()\nREACTI 1001, q\nDRIVE 1,60,50\nBREAK\n.END\n.PROGRAM q()\n{behind}\n.END\n"
    for text, inputs in ((brake, []), (react, [Change(0.4, 1001, True)])):
        done = ran(shipped, text, *inputs)
        assert done.error is None
        q = np.degrees(done.result.slow.reference[:, 0, 0])
        assert np.abs(np.diff(q)).max() < 0.125  # of 1 ms, at 118 deg/s
        assert q[-1] == pytest.approx(q[round(1e3 * done.motions[0].ended)] - 10.0, abs=0.01)
        assert done.cell.changes[0].time == pytest.approx(0.4, abs=0.02)


def test_the_command_writes_what_it_is_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Bag, page and picture are there; faults of files and of programs have their exit codes."""
    (tmp_path / "in.yaml").write_text("{1001: 1.0, 1002: [0.5, 2]}")
    assert load_inputs(tmp_path / "in.yaml") == [(0.5, 1002, True), (1.0, 1001, True), (2.0, 1002, False)]
    (tmp_path / "bad.yaml").write_text("{1001: 1.0, 2001: 2.0}")
    with pytest.raises(ConfigError, match=r"bad.yaml: 2001: 2.0; accepted: inputs from 1001"):
        load_inputs(tmp_path / "bad.yaml")
    words = ["--output", str(tmp_path / "bag"), "--report", str(tmp_path / "p.html"), "--plot", str(tmp_path / "p.png")]
    words += ["--inputs", str(tmp_path / "in.yaml")]
    assert run("rx90 program engine", [str(CASES / "c08_strings.v2"), "C08.STRINGS", *words]) == 0
    said = capsys.readouterr().out
    assert "head of 3: MOV code  77" in said
    assert "c08.strings:19" in said
    assert (tmp_path / "p.png").stat().st_size > 1000
    assert re.search("<th>line</th>.*<td>c08.strings", (tmp_path / "p.html").read_text("utf-8"), re.S)
    assert run("rx90 replay", [str(tmp_path / "bag")]) == 0  # the bag's trajectory runs again
    (tmp_path / "a.v2").write_text(".PROGRAM a(x, $y)\nTYPE x, $y\nx = y\n.END\n.PROGRAM b()\nFOO\nBAR\n.END\n")
    assert run("rx90 program engine", [str(tmp_path / "a.v2")]) == 2
    assert "a.v2:7" in capsys.readouterr().out
    (tmp_path / "a.v2").write_text(".PROGRAM a(x, $y)\nTYPE x, $y\nx = z\n.END\n")
    assert run("rx90 program engine", [str(tmp_path), "a", "3", "four"]) == 3
    said, complaint = capsys.readouterr()
    assert "3four" in said
    assert "*Undefined value* (-401, number from memory): z; Program task 0 stopped at a, step 2, line 3" in complaint


def test_mutated_programs_end_in_time_without_a_traceback(shipped: Setup) -> None:
    """Two thousand programs with lines and characters mixed up: each ends, or is refused by V+'s or our text."""
    rng = np.random.default_rng(7)
    sources = [file.read_text(encoding="latin-1") for file in sorted(CASES.glob("*.v2"))]
    pool = [line for source in sources for line in source.splitlines()]
    pool += ["ATTACH ()", "ACCEL (1) 50, 50", "DETACH (lun)", "a[,2] = b[]", "REACT 1001, c06.bump", "GOTO 10", "10 ;"]
    pool += ["NEXT", "EXIT", "x = NOT x AND 1", "TYPE $s, #p, a[1]", "UNTIL x", "DO", "ANY", "MOVE HERE:p:DEST"]
    signs = list("()[],;:=+-*/$#\"'^.0123456789ABCxyz \x00\x0c\x1a\xff")
    options = Options(idle=0.2, longest=0.3)
    ends = {"ran": 0, "stopped": 0, "refused": 0}
    for number in range(2000):
        lines = sources[number % len(sources)].splitlines()
        for _ in range(rng.integers(1, 5)):
            place = int(rng.integers(len(lines)))
            old = lines[place]
            new = pool[rng.integers(len(pool))]
            at = int(rng.integers(len(old) + 1))
            mixed = old[:at] + signs[rng.integers(len(signs))] + old[at + 1 :]
            lines[place : place + 1] = ([new], [], [new, old], [mixed])[rng.integers(4)]
            lines = lines or ["."]
        memory = Memory()
        if read("\n".join(lines), memory).faults:
            ends["refused"] += 1
            continue
        done = run_program(shipped, memory, options=options)
        assert done.cell.time < 0.8
        ends["stopped" if done.error else "ran"] += 1
    assert min(ends.values()) > 10, ends


def test_random_bytes_and_a_line_of_ten_megabytes_are_refused(tmp_path: Path) -> None:
    """What is no program is refused by lines of bounded length."""
    file = tmp_path / "noise.v2"
    for content in (np.random.default_rng(1).bytes(100_000), b".PROGRAM a()\nx = " + b"1" * 10_000_000 + b"\n.END"):
        file.write_bytes(content)
        with pytest.raises(LoadError) as refusal:
            load_programs(file)
        assert len(str(refusal.value)) < 1000


def test_the_yaw_of_a_tool_that_looks_down_stays_along_a_motion(shipped: Setup) -> None:
    """It is 0, by set-points on a line and where the arm stands; a real arm's recording is a plain decomposition."""
    lines = "MOVE TRANS(500,-100,100,0,180,30)\nBREAK\nDECOMPOSE a[0] = HERE\nTYPE /F6.1, a[3], a[5], /E9.1, 0.002\n"
    done = ran(shipped, lines + "SPEED 100 MMPS\nMOVES TRANS(500,100,100,0,180,0)\nBREAK")
    assert shown(done) == ["   0.0  30.0  2.0E-03"]
    numbers = np.array([six_numbers(done.cell.arm.flange(q)) for q in done.result.slow.reference[-2500:-300:50, 0]])
    assert np.abs(numbers[:, 3]).max() == 0.0
    assert (np.diff(numbers[:, 5]) < 1e-6).all()  # from 30 to 0
    recorded = done.cell.arm.flange(done.cell.arm.angles(Joints([0.0, -90.001, 89.993, 0.0, 0.0, -0.005])))
    assert six_numbers(recorded)[3:] == pytest.approx([180.0, 0.008, 179.995], abs=1e-6)


@pytest.mark.parametrize("motion", ["DRIVE 1, 40, 20", "DELAY 1"])
def test_a_reaction_that_takes_the_power_ends_the_program(shipped: Setup, motion: str) -> None:
    """The motion that waits meanwhile is refused."""
    text = f"""
.PROGRAM p()
  REACT 1001, off
  DRIVE 1, 40, 20
  {motion}
  BREAK
.END
.PROGRAM off()
  DISABLE POWER
.END
"""
    done = ran(shipped, text, Change(0.5, 1001, True))
    assert "Robot power off" in str(done.error)
    assert len(done.motions) == 1
    assert done.cell.arm.joints(done.cell.queue.position)[0] < 30.0


def test_a_run_that_the_supervision_ends_has_a_trajectory_of_increasing_times(shipped: Setup) -> None:
    """Its bag can be replayed: the arm's rest takes the place of the set-point at which the power was cut."""
    strict = with_parameters(shipped, {"controller.following_error[*]": 3.5e-4})
    done = ran(strict, ".PROGRAM p()\nDRIVE 1, 40, 100\n.END\n")
    assert "Soft envelope error" in str(done.error)
    assert done.result is not None
    times = done.result.commands[0].points.times
    assert len(times) > 1
    assert (np.diff(times) > 0.0).all()
