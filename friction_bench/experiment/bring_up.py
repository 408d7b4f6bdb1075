"""The bring-up check of a board that has just been soldered: each line, sign, scale and the watchdog, step by step.

On a stage for torque of both signs there is one more step, for its direction line, and sense and current are checked in
both directions.

Each step describes the preparation, asks for confirmation before it switches anything on, and compares the rig's
reports, and the person's measurements and observations, with the values expected from the board's drawing
(docs/howto/rig_build.md) and the rig file. The steps before the motor's supply is switched on verify that the board can
switch the torque off; only then a torque is applied.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from friction_bench.experiment.dialogue import (
    HIGH,
    INDENT,
    LONGEST_HOLD,
    Dialogue,
    SkippedError,
    StepResult,
    Terminal,
)
from friction_bench.experiment.session import armed, wait_for_rest
from friction_bench.rig.client import RigClient, Sample
from friction_bench.rig.messages import (
    BACKWARD,
    Command,
    CommandResult,
    Fault,
    RigError,
    RigLostError,
    RigRefusedError,
    State,
)
from friction_bench.rig.rig_file import CODES, Rig, load_rig
from friction_bench.rig.serial_port import SerialPort
from rx90_common.base.config import yaml_text
from rx90_common.base.errors import DONE, FAILED, VERDICT_NO
from rx90_common.base.quoting import one_line, plain, quoted
from rx90_common.base.share import resolve_config
from rx90_common.process.files import write_text
from rx90_common.process.interrupts import deferred_interrupts

ENABLE_VOLTS = 0.5
"""Tolerance of the enable's levels, V: outputs of 0.45 V when low, 0.2 V for the port's own pull-up when high."""
VOLTS = 0.02, 0.02
"""Tolerance of a set-point, share and V: resistors of 1 %; offset of 7 mV and half a step of 8 mV."""
AMPERES = 0.05, 0.03
"""Of a current: sense resistor and gain, 2.4 %, and a meter of 2 %; 30 mA for an untrimmed offset, or ripple."""
READING = 0.05, 2.0
"""Of the mean of ADC codes, share and codes: gain and reference, 2.4 %, and noise; quantisation and offset."""
HAND_TURN_TOLERANCE = 0.05
"""Of a turn by hand: 18 degrees."""
PARTS = 0.25, 0.5
"""Of the highest DAC code: those at which scales are compared."""
SIDES = 0.01, 1.0
"""Of the difference of the ADC codes forward and backward: one regulator and one resistor serve both; quantisation."""
LISTENED_TICKS = 50
SETTLING_TICKS, AVERAGED_TICKS = 15, 50
MIN_TURN_SHARE = 0.05
"""Of a turn: a shaft that has moved so far turns, and has not only given way."""
WRONG_SENSE = {
    "counts": "the torque counts down: the motor's leads are exchanged, or the encoder's lines",
    "turns the shaft": "the torque turns the shaft in the negative sense: exchange the motor's leads",
}
DWELL_TICKS = 5
"""For which a code is held when a torque is looked for that turns the shaft."""


class BringUp(Dialogue):
    """The check of one rig; arguments as of `Dialogue`.

    Attributes:
        steps: the steps, by title.
        lost: the rig no longer answers.
    """

    def __init__(self, client: RigClient, person: Terminal, board: str | None = None) -> None:
        super().__init__(client, person, board)
        self.steps = BIPOLAR_STEPS if self.rig.bipolar else STEPS
        self.lost = False

    @property
    def codes(self) -> list[int]:
        """Return the DAC codes at which scales are compared."""
        return [int(part * self._limit) for part in PARTS]

    @property
    def _ways(self) -> dict[str, int]:
        """Return the signs of the torque, by the sense in which it is to turn the motor."""
        return {"positive": 1, "negative": -1} if self.rig.bipolar else {"positive": 1}

    @property
    def _limit(self) -> int:
        return self.client.greeting.torque_limit_code

    def run(self) -> int:
        """Run all steps, and print the result of each.

        Returns:
            The exit code: 0 all values are as expected; 1 a value is not, or was not measured; 3 the rig does not
            answer.
        """
        for number, (title, do) in enumerate(self.steps.items(), 1):
            self.results.append(result := StepResult(title))
            print(f"\n{number}/{len(self.steps)} {title}", flush=True)
            try:
                self._greet()
                do(self)
            except SkippedError as skipped:
                result.left_out.append(str(skipped))
            except RigError as error:
                result.faults.append(str(error))
                self.lost = isinstance(error, RigLostError)
            except BaseException:
                result.left_out.append("interrupted")
                raise
            self._say("; ".join((result.verdict, *result.faults, *result.left_out)))
            if number == 1 and result.faults:
                self._say(
                    "Nothing else can be checked before this is right. No answer: TXD and RXD exchanged, U5, another "
                    "baud rate, a processor without program, crystal or supply, a reset that is held."
                )
            if self.lost or (number == 1 and result.faults):
                break
        return FAILED if self.lost else DONE if self.verdict == "passed" else VERDICT_NO

    @property
    def verdict(self) -> str:
        """Return the verdict of the steps; steps that were not reached leave it incomplete at best."""
        found = {result.verdict for result in self.results}
        if "failed" in found:
            return "failed"
        return "incomplete" if "incomplete" in found or len(self.results) < len(self.steps) else "passed"

    def document(self) -> dict[str, Any]:
        """Return the results as plain data."""
        hello, rig = self.client.hello, self.rig
        firmware = "did not answer" if hello is None else hello.text
        return {
            "verdict": self.verdict, "rig": str(rig.file), "board": self.board.name, "firmware": firmware,
            "steps": [result.document for result in self.results],
            "not_reached": list(self.steps)[len(self.results):],
        }  # fmt: skip

    # The steps.

    def _line(self) -> None:
        client, rig, hello, name = self.client, self.rig, self.client.greeting, plain(self.rig.file.name)
        self._say(f"{hello.text}: {self.board.name}")
        self._say(
            f"{hello.counts_per_revolution} counts a turn, tick {hello.tick_us / 1e3:g} ms, "
            f"{hello.dac_full_scale:g} Nm at DAC code {CODES}, {hello.adc_full_scale:g} Nm at ADC code {CODES}, all "
            f"as in {name}"
        )
        high, watchdog = rig.torque(hello.torque_limit_code), hello.watchdog_ticks * rig.tick
        both = ", forward and backward" if rig.bipolar else ""
        self._say(f"highest DAC code {hello.torque_limit_code}, {high:.3g} Nm{both}; watchdog {1e3 * watchdog:g} ms")
        try:
            client.request(Command.LIMITS, *rig.limit_codes())
        except RigRefusedError as error:
            raise RigRefusedError(f"{error}: limits of {name} are above MAX_TRAVEL or MAX_SPEED") from None
        for torque in (rig.ramps.end_torque, rig.ramps.end_torque_loaded):
            client.end_code(torque)  # refused here, not in the first measurement
        lost, bad, first = client.lost_reports, client.bad_frames, self._listen(1)[0].report.bad_frames
        last = self._listen(LISTENED_TICKS)[-1].report.bad_frames
        self._compare(f"reports lost of {LISTENED_TICKS}", "reports", 0, 0, client.lost_reports - lost)
        self._compare("damaged frames", "frames", 0, 0, client.bad_frames - bad + (last - first) % 256)

    def _idle(self) -> None:
        self._say(
            "Open S1 (the motor's supply is off), switch on all other supplies. Stage off, DAC code 0: no torque. "
            "Measure with a voltmeter against GND."
        )
        samples = self._listen(LISTENED_TICKS)
        report = samples[-1].report
        if report.state != State.DISARMED or report.dac:
            self._fault(f"state {report.state.name}, DAC code {report.dac}; expected: DISARMED and 0")
        self._compare("ADC code", "codes", 0, READING[1], _mean_reading(samples))
        moved = max(sample.counts for sample in samples) - min(sample.counts for sample in samples)
        self._compare("encoder counts of a shaft at rest", "counts", 0, 1, moved)
        self._measure(self.board.enable, "V", self.board.off, ENABLE_VOLTS)
        self._measure("VSET", "V", 0.0, VOLTS[1])
        self._measure(self.board.sense, "V", 0.0, VOLTS[1])

    def _enable(self) -> None:
        self._say("S1 stays open. The stage is switched on with DAC code 0, then off.")
        self._ready("Switch the stage on, without torque")
        with self._stage_on():
            self._measure(f"{self.board.enable} with the stage on", "V", self.board.on, ENABLE_VOLTS)
        self._measure(f"{self.board.enable} off again", "V", self.board.off, ENABLE_VOLTS)

    def _set_point(self) -> None:
        for code in self.codes:
            self._say(
                f"S1 stays open, so that no current flows. DAC code {code} would be {self.rig.torque(code):.4g} Nm."
            )
            self._ready(f"Put code {code} on the DAC")
            with self._stage_on(code):
                self._measure_set_point(code)

    def _measure_set_point(self, code: int) -> None:
        expected = self.board.set_point * abs(code) / CODES
        self._measure(f"VSET at code {code}", "V", expected, VOLTS[0] * expected + VOLTS[1])

    def _direction(self) -> None:
        levels: list[float | None] = []
        for sense, way in self._ways.items():
            code = way * self.codes[0]
            self._say(f"S1 stays open. Code {code}: a torque in the {sense} sense; VSET shows its size alone.")
            self._ready(f"Put code {code} on the DAC")
            with self._stage_on(code):
                for point, forward in self.board.directions.items():
                    expected = HIGH if (way > 0) is forward else 0.0
                    self._measure(f"{point} at code {code}", "V", expected, ENABLE_VOLTS)
                levels.append(self.results[-1].quantities[-len(self.board.directions)].found)
                self._measure_set_point(code)
        line = next(iter(self.board.directions))
        if None in levels:
            return
        high = [level > 0.5 * HIGH for level in levels if level is not None]
        if high[0] == high[1]:
            self._fault(f"{line} is {'high' if high[0] else 'low'} whatever the sign: the line is stuck or open")
        elif high == [False, True]:
            self._fault(f"{line} is low forward and high backward: FORWARD and BACKWARD are exchanged")

    def _torque_limit(self) -> None:
        limit, bipolar = self._limit, self.rig.bipolar
        self._say(f"S1 stays open. Codes above {limit} are sent, which the firmware must refuse.")
        self._ready(f"Send codes above {limit}")
        tried: list[tuple[Command, int, tuple[int, ...]]] = []
        for way in self._ways.values():
            tried += [
                (Command.TORQUE, way * code, self.client.torque_values(way * code)) for code in (limit + 1, CODES)
            ]
            turn = (BACKWARD if way < 0 else 0,) if bipolar else ()
            tried.append((Command.RAMP, way * (limit + 1), (1, limit + 1, *turn)))
        with self._stage_on():
            for command, code, values in tried:
                try:
                    self.client.request(command, *values)
                    answer = "obeyed"
                except RigRefusedError as error:
                    answer = str(error)
                last = self.client.last
                assert last is not None
                if last.report.result != CommandResult.RANGE or last.report.dac:
                    raise RigError(f"{command.name} code {code}: {answer}; expected: a refusal, and no torque")
        both = ", forward and backward" if bipolar else ""
        self._say(f"TORQUE {limit + 1} and {CODES} and a RAMP to {limit + 1} are refused{both}")

    def _watchdog(self) -> None:
        client, code, hello = self.client, self.codes[0], self.client.greeting
        expected = hello.watchdog_ticks * self.rig.tick
        self._say(
            f"S1 stays open. Code {code} is put on the DAC, then this computer is silent: after {1e3 * expected:g} ms "
            f"at most the firmware must switch the stage off. (An oscilloscope at {self.board.enable} shows it, too.)"
        )
        self._ready(f"Put code {code} on the DAC, and fall silent")
        with armed(client):
            self._put(code)
            elapsed = self._silence(3 * hello.watchdog_ticks)
            if elapsed is None:
                client.request(Command.STOP)
                raise RigError(f"the torque stayed on for {3 * expected:g} s without a host: the watchdog does not act")
            tolerance = 1e3 * self.rig.tick  # a report may be lost
            self._compare("from the last frame to torque off, at most", "ms", 1e3 * expected, tolerance, 1e3 * elapsed)
        client.clear()
        self._measure(f"{self.board.enable} after that", "V", self.board.off, ENABLE_VOLTS)

    def _silence(self, ticks: int) -> float | None:
        """Send a last frame; return the longest possible time until the torque is off, s; None if it stays on.

        The frame arrived within the tick before the first report that answers it.
        """
        client = self.client
        assert client.last is not None
        before, answered, end = client.last.report.ack_sequence, None, client.last.tick + ticks
        client.beating = False
        try:
            client.send_torque(client.last.report.dac)
            while client.last.tick < end:
                for sample in client.pump():
                    if answered is None and sample.report.ack_sequence != before:
                        answered = sample.tick
                    if Fault.WATCHDOG in sample.report.fault and sample.report.dac == 0:
                        if answered is None:
                            raise RigError("the last frame was lost on the line; check again")
                        return (sample.tick - answered + 1) * self.rig.tick
        finally:
            client.beating = True
        return None

    def _encoder(self) -> None:
        rig, counts = self.rig, self.rig.counts_per_revolution
        self._say(
            f"S1 stays open. Turn the motor's shaft by hand by one whole turn, 1/{rig.gear_ratio:g} turn of the load's "
            "shaft; positive is the sense in which the motor is to turn it."
        )
        found = {}
        for sense, sign in {"positive": 1, "negative": -1}.items() if rig.counts_down else (("positive", 1),):
            before = self._listen(1)[0].counts
            self._ready(f"Turn it once in the {sense} sense")
            found[sense] = moved = self._listen(SETTLING_TICKS)[-1].counts - before
            self._compare(f"one {sense} turn", "counts", sign * counts, HAND_TURN_TOLERANCE * counts, moved)
        wrong = [sense for sense, moved in found.items() if moved * (1 if sense == "positive" else -1) < 0]
        if not any(found.values()):
            self._fault("no counts: the encoder's supply or line A, or the decoder's pulse, is missing")
        elif len(wrong) == 2:
            self._fault("both signs are wrong: lines A and B are exchanged")
        elif wrong:
            self._fault(f"only the {wrong[0]} turn has the wrong sign: the direction's line is missing, or line B")
        if not rig.counts_down:
            self._say("This encoder counts up in both senses: it has no sign to check.")

    def _refuse_unsafe(self) -> None:
        """Leave a step with a torque out where one before showed that the board does not take a torque away."""
        unsafe = [one.title for one in self.results if one.title in GUARDS and one.verdict == "failed"]
        if unsafe:
            raise SkippedError(f"left out, no torque is applied: failed was {', '.join(unsafe)}")

    def _sense_of_torque(self) -> None:
        self._refuse_unsafe()
        most = self.codes[-1]
        self._say(
            "Close S1; keep a hand on it. The shaft must be free to turn. The torque rises code by code until the "
            f"shaft has turned by {MIN_TURN_SHARE:g} of a turn, at most to code {most}, "
            f"{self.rig.torque(most):.3g} Nm, and goes off. Watch the shaft."
        )
        counted, senses = [], []
        for sense, way in self._ways.items():
            self._ready(f"Apply the torque in the {sense} sense" if self.rig.bipolar else "Apply the torque")
            if self._turn_by_torque(way) * way < 0:
                counted.append(sense)
            question = f"Did it turn in the {sense} sense? [y, n, or Enter: not seen]"
            while (answer := self._ask(question).lower()) not in ("y", "n", ""):
                self._say(f"{quoted(answer)}; accepted: y, n, or Enter")
            if answer == "n":
                senses.append(sense)
            elif not answer:
                self.results[-1].left_out.append(f"nobody saw whether the shaft turned in the {sense} sense")
        for wrong, what in ((counted, "counts"), (senses, "turns the shaft")):
            if len(wrong) == 1 and self.rig.bipolar:
                other = "negative" if wrong[0] == "positive" else "positive"
                self._fault(
                    f"the torque {what} in the {other} sense whatever its sign: the stage ignores its direction"
                )
            elif wrong:
                self._fault(WRONG_SENSE[what] + (", or FORWARD and BACKWARD" if self.rig.bipolar else ""))

    def _turn_by_torque(self, way: int) -> int:
        """Let the torque of a sign rise until the shaft, which is at rest first, turns; return by how many counts."""
        rig, most, moved, code = self.rig, self.codes[-1], 0, 0
        wait_for_rest(self.client)
        start = self._listen(1)[0].counts
        enough = max(2.0, MIN_TURN_SHARE * rig.counts_per_revolution)
        with self._stage_on():
            while abs(moved) < enough and code < most:
                code += 1
                self._put(way * code)
                moved = self._listen(DWELL_TICKS)[-1].counts - start
        if abs(moved) < enough:
            reasons = "no torque (S1, F1, motor), a shaft that is held, or no encoder"
            raise RigError(f"{moved} counts up to code {way * most}: {reasons}")
        self._say(f"turned at code {way * code}, {rig.torque(way * code):.3g} Nm: {moved} counts")
        return moved

    def _current(self) -> None:
        self._refuse_unsafe()
        lead = ", its + lead at the board's + terminal for the motor" if self.rig.bipolar else ""
        self._say(
            f"Open S1. Clamp the shaft, put an ammeter (10 A) in series with the motor{lead}, close S1. Measure at "
            f"once: a torque stands until you answer, at most {LONGEST_HOLD:g} s. {self.rig.dac_full_scale:g} Nm and "
            f"{self.board.current(CODES):.4g} A at code {CODES} mean a torque constant of "
            f"{self.rig.dac_full_scale / self.board.current(CODES):.3g} Nm/A."
        )
        readings = {}
        for code in (way * code for way in self._ways.values() for code in self.codes):
            torque, current = self.rig.torque(code), self.board.current(code)
            self._ready(f"Apply code {code}: {torque:.4g} Nm, {current:.3g} A")
            with self._stage_on(code):
                self._listen(SETTLING_TICKS)
                readings[code] = reading = _mean_reading(self._listen(AVERAGED_TICKS))
                expected = abs(torque) / self.rig.adc_full_scale * CODES
                tolerance = READING[0] * expected + READING[1]
                self._compare(f"ADC code at code {code}", "codes", expected, tolerance, reading)
                self._measure(f"current at code {code}", "A", current, AMPERES[0] * abs(current) + AMPERES[1])
                volts = abs(current) * self.board.gain
                self._measure(f"{self.board.sense} at code {code}", "V", volts, AMPERES[0] * volts + VOLTS[1])
        if self.rig.bipolar:
            for code in self.codes:
                off = readings[-code] - readings[code]
                name = f"ADC code at code {-code} less that at code {code}"
                self._compare(name, "codes", 0.0, SIDES[0] * readings[code] + SIDES[1], off)


STEPS: dict[str, Callable[[BringUp], None]] = {
    "Serial line and greeting": BringUp._line,
    "Idle: no torque": BringUp._idle,
    "Enable": BringUp._enable,
    "Set-point": BringUp._set_point,
    "Torque limit": BringUp._torque_limit,
    "Watchdog": BringUp._watchdog,
    "Encoder": BringUp._encoder,
    "Sense of the torque": BringUp._sense_of_torque,
    "Current and its reading": BringUp._current,
}
"""By their titles; the motor's supply is on from the sense of the torque on."""
DIRECTION = "Direction line"
BIPOLAR_STEPS = dict([*list(STEPS.items())[:4], (DIRECTION, BringUp._direction), *list(STEPS.items())[4:]])
"""Those of a rig with torque of both signs."""
GUARDS = ("Idle: no torque", "Enable", "Torque limit", "Watchdog")
"""Steps that must not have failed before a torque is applied."""


def _mean_reading(samples: list[Sample]) -> float:
    return sum(sample.report.adc for sample in samples) / len(samples)


def run(options: argparse.Namespace) -> int:
    """Check the rig at a port; the results are written to `--output` however the check ends.

    Returns:
        The exit code of `BringUp.run`.

    Raises:
        Rx90Error: for bad options or files, or a port that cannot be opened.
    """
    rig: Rig = load_rig(resolve_config(options.rig))
    port = SerialPort(options.port, options.baud or rig.baud)
    check = BringUp(RigClient(port, rig), Terminal(), options.board)
    output: Path | None = options.output
    try:
        print("Nothing is switched on before you say so; Ctrl-C takes the torque away. S1 is the emergency stop.")
        code = check.run()
    finally:
        with deferred_interrupts():
            port.close()
            if output is not None:
                write_text(output, yaml_text(check.document()))
    print(f"\n{check.verdict}")
    for result in check.results:
        print(one_line("; ".join((f"{INDENT}{result.title}: {result.verdict}", *result.reasons))))
    return code
