"""The firmware's real binaries, each against the same conformance transcripts."""

import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rig_bench import greeted
from rig_conformance import TRANSCRIPTS, MismatchError, Player, armed

from friction_bench.experiment.job import run_ramp
from friction_bench.rig.messages import PROCESSORS, Command, Frame, encode
from friction_bench.rig.rig_file import Rig

SIMULATED = [pytest.param(target, marks=pytest.mark.firmware) for target in ("mcs51", "avr")]
ALL = ["native", *SIMULATED]

MUTANTS = {
    "half_crc_low": ("core/frame.c", "(uint8_t)crc != frame_rx[rx_count - 2u] ||", "0 ||"),
    "half_crc_high": ("core/frame.c", "|| (uint8_t)(crc >> 8) != frame_rx[rx_count - 1u]", ""),
    "slow_watchdog": ("core/rig_config.h", "WATCHDOG_TICKS 7u", "WATCHDOG_TICKS 12u"),
    "hasty_watchdog": ("core/rig_config.h", "WATCHDOG_TICKS 7u", "WATCHDOG_TICKS 4u"),
    "no_watchdog": ("core/rig.c", "trip(FAULT_WATCHDOG);", ";"),
    "high_torque": ("core/rig.c", "if (code > TORQUE_LIMIT_CODE)", "if (0)"),
    "high_ramp": ("core/rig.c", "end > TORQUE_LIMIT_CODE", "0"),
    "unlatched": ("core/rig.c", "    fault |= bit;\n", ""),
    "faulty_arming": ("core/rig.c", "    if (fault)\n        return RESULT_FAULT;\n", ""),
    "stage_left_on": ("core/rig.c", "    hal_stage(0);\n    drive(0);", "    drive(0);"),
    "torque_left_on": ("core/rig.c", "    hal_stage(0);\n    drive(0);", "    hal_stage(0);"),
    "no_greeting": ("core/rig.c", "    if (!hello_seen)\n        return RESULT_NO_HELLO;\n", ""),
    "any_version": ("core/rig.c", "version == PROTOCOL_VERSION", "1"),
    "no_travel": ("core/rig.c", "trip(FAULT_TRAVEL);", ";"),
    "old_travel": ("core/rig.c", "    travel_start = (uint16_t)(counts >> 8);\n", ""),
    "no_speed": ("core/rig.c", "trip(FAULT_SPEED);", ";"),
    "no_current": ("core/rig.c", "trip(FAULT_CURRENT);", ";"),
    "hasty_current": ("core/rig_config.h", "CURRENT_LIMIT_TICKS 3u", "CURRENT_LIMIT_TICKS 2u"),
    "sticky_current": ("core/rig.c", "(uint8_t)(over_current + 1u) : 0", "(uint8_t)(over_current + 1u) : over_current"),
    "twice": ("core/rig.c", "hello_seen && sequence == ack_sequence", "0 && sequence == ack_sequence"),
    "deaf_stop": ("core/rig.c", " && type != HELLO && type != STOP)", " && type != HELLO)"),
    "floor_ramp": ("core/rig.c", "level = 0x80u;", "level = 0u;"),
    "ramp_stays_on": (
        "core/rig.c",
        "        power_off(DISARMED);\n        return;\n    }\n    drive",
        "        return;\n    }\n    drive",
    ),
    "differences": ("core/rig.c", "    counts += moved;", "    counts = moved;"),
    "loose_limits": ("core/rig.c", "distance > MAX_TRAVEL", "0"),
    "loose_speed": ("core/rig.c", "speed > MAX_SPEED", "0"),
}


@pytest.mark.parametrize("target", ALL)
@pytest.mark.parametrize("transcript", TRANSCRIPTS, ids=lambda path: path.stem)
def test_every_target_follows_the_transcript(target: str, transcript: Path, make_board: Callable[..., Any]) -> None:
    """Native, 8051 and AVR firmware give the same answers, pins and timing in every scripted situation."""
    Player(make_board(target)).play(transcript)


@pytest.mark.parametrize("name", MUTANTS)
def test_transcripts_catch_the_mutant(name: str, make_mutant: Callable[..., Any]) -> None:
    """A firmware with one rule of safety taken out fails a transcript."""
    board = make_mutant("native", *MUTANTS[name])
    for transcript in TRANSCRIPTS:
        board.reset(1)
        try:
            Player(board).play(transcript)
        except MismatchError:
            return
    pytest.fail(f"no transcript notices the mutant {name}")


def time_at_full_scale(board: Any) -> float:
    """Return how long after power-up the DAC is not zero, s; the stage must be off meanwhile."""
    assert not board.stage_on
    for _ in range(5000):
        board.instructions(1)
        assert not board.stage_on
        if board.dac == 0:
            return float(board.time)
    return float("inf")


@pytest.mark.firmware
def test_8051_clears_the_dac_within_microseconds_of_power_up(
    make_board: Callable[..., Any], make_mutant: Callable[..., Any]
) -> None:
    """The ports' reset value, a full-scale DAC, lasts less than 20 µs, and the stage is off meanwhile."""
    assert time_at_full_scale(make_board("mcs51")) < 20e-6
    assert time_at_full_scale(make_mutant("mcs51", "mcs51/hal_mcs51.c", "    DAC_PORT = 0;\n", "")) > 20e-6


BOARD_MUTANTS = {
    "8051 stage upside down": ("greeting", "mcs51", "mcs51/hal_mcs51.c", "STAGE_OFF = !on", "STAGE_OFF = on"),
    "8051 patient watchdog": ("watchdog", "mcs51", "core/rig_config.h", "WATCHDOG_TICKS 7u", "WATCHDOG_TICKS 12u"),
    "8051 edges in seven bits": ("runaway", "mcs51", "mcs51/hal_mcs51.c", "(uint8_t)(now - last", "0x7f & (now - last"),
    "AVR stage upside down": ("greeting", "avr", "avr/hal_avr.c", "    if (on)\n", "    if (!on)\n"),
    "AVR patient watchdog": ("watchdog", "avr", "core/rig_config.h", "WATCHDOG_TICKS 7u", "WATCHDOG_TICKS 12u"),
    "AVR half a DAC": ("torque", "avr", "avr/hal_avr.c", "(PORTB & 0xf0) | (code >> 4)", "PORTB & 0xf0"),
}


@pytest.mark.firmware
@pytest.mark.parametrize("name", BOARD_MUTANTS)
def test_transcripts_catch_the_mutant_binary(name: str, make_mutant: Callable[..., Any]) -> None:
    """A real binary with a safety rule or a pin taken out fails its transcript."""
    transcript, *mutation = BOARD_MUTANTS[name]
    path = next(path for path in TRANSCRIPTS if path.stem == transcript)
    with pytest.raises(MismatchError):
        Player(make_mutant(*mutation)).play(path)


@pytest.mark.firmware
def test_8051_does_not_depend_on_what_ram_holds_at_power_up(make_board: Callable[..., Any]) -> None:
    """Random RAM contents of three different seeds give the same bytes on the line."""
    transcripts = []
    for seed in (1, 2, 3):
        player = armed(make_board("mcs51", seed))
        transcripts.append([(r.tick, r.dac, r.state, r.ack_sequence, r.result) for r in player.reports])
    assert transcripts[0] == transcripts[1] == transcripts[2]


@pytest.mark.firmware
def test_ticks_of_the_avr_are_20_ms_of_the_crystal(make_board: Callable[..., Any]) -> None:
    """Counts of an encoder at 1 kHz show the tick's length: 200 ticks hold 4000 edges, none lost."""
    player = Player(make_board("avr"))
    player.do_greet(None)
    player.do_edges(1)
    player.do_run(400)
    first = player.reports[-1]
    player.do_run(4000)
    last = player.reports[-1]
    per_tick = (last.counts - first.counts) / (last.tick - first.tick)
    assert per_tick == pytest.approx(20.0, rel=1e-3 + 1e-5)
    assert last.sequence == (first.sequence + last.tick - first.tick) % 256


@pytest.mark.firmware
def test_8051_ticks_are_exact_by_the_cycle(make_board: Callable[..., Any], firmware: Callable[[str], Path]) -> None:
    """15 ticks of the binary are 15 times 18,432 machine cycles, 20 ms, but for an interrupt's delay: no drift."""
    symbols = firmware("mcs51").with_suffix(".map").read_text()
    found = re.search(r"([0-9A-F]{8})\s+_hal_tick_number", symbols)
    address = int(found[1], 16)
    board = make_board("mcs51")
    clocks, ticks = 12 * 18432, 15
    first = board.clock_when(address, 3, not_before=int(2.9 * clocks))
    last = board.clock_when(address, 3 + ticks, not_before=first + ticks * clocks - 20_000)
    assert last - first == pytest.approx(ticks * clocks, abs=12 * 30)
    assert clocks / 11.0592e6 == pytest.approx(0.02, rel=1e-12)


@pytest.mark.parametrize("target", ALL)
def test_random_damage_never_moves_the_rig(target: str, make_board: Callable[..., Any]) -> None:
    """Torque commands with bytes flipped, lost or doubled at random never reach the DAC of an armed rig."""
    random_ = random.Random(7)
    player = armed(make_board(target))
    for number in range(400 if target == "native" else 25):
        sent = encode(Frame(Command.TORQUE, number % 100, bytes([99])))
        message = bytearray(sent)
        at = random_.randrange(len(message) - 1)
        how = random_.choice(("flip", "lose", "double"))
        if how == "flip":
            message[at] ^= 1 << random_.randrange(8)
        else:
            message[at : at + 1] = bytes([message[at]]) * (2 if how == "double" else 0)
        if message == sent:
            continue
        player.board.write(bytes(message) + b"\0")
        player.do_beat(20)
        assert player.board.dac == 0
    player.do_beat(55)
    player.do_expect({"state": "ARMED", "fault": 0})
    assert PROCESSORS[player.hello.processor] == target


@pytest.mark.firmware
@pytest.mark.parametrize("target", ["mcs51", "avr"])
def test_loop_with_the_real_binary_equals_the_native_one(target: str, make_board: Callable[..., Any], rig: Rig) -> None:
    """The emulated rig, run by the real binary, turns in a ramp as far as by the native core, but for 2 ms."""
    angles = []
    for board in ("native", target):
        client = greeted(rig, 3, board=make_board(board))
        record = run_ramp(client, 0.3, 0.08, False, board)
        assert client.lost_reports == 0
        angles.append(record.angle[-1])
        speed = (record.angle[-1] - record.angle[-2]) / record.tick
    assert angles[1] == pytest.approx(angles[0], abs=2e-3 * speed)
