"""The states of the controller: what each does in a tick, what it answers to an event, and which one follows.

    Unstarted   no states of the motors have come yet; a request waits
    Releasing   the torque was switched off since the last tick; perhaps it is on again, and a request waits
    Off         no torque
    Holding     the arm holds its set-point
    Following   a trajectory of the topic, or a goal
    Streaming   set-points that come one after another
    Stopping    what was followed has ended; the rest of its motion leads to rest

docs/reference/controller_states.md has each event in each state. States are values: the answer to an event, or the end
of a tick, is the next one. A request that is accepted replaces what is followed; a refused one has no effect on it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from rx90_common.base.errors import TrajectoryError
from rx90_common.base.quoting import counted
from rx90_controller.law.cs7b import DriveFault
from rx90_controller.servo.events import (
    Begin,
    Cancel,
    Event,
    Fault,
    GiveUp,
    LawChange,
    Offer,
    Streamed,
    TorqueSwitch,
)
from rx90_controller.servo.servo import MotorStates, Servo
from rx90_controller.trajectory.request import State, TrajectoryRequest
from rx90_controller.trajectory.stream import LONGEST_PAUSE, SetPoints, Stream


@dataclass(frozen=True)
class Switch:
    """Whether the torque is switched on; then the node is active, and there is no fault.

    Attributes:
        on: whether it is.
        active: whether the node is in its state active.
        fault: why the supervision has cut the power.
    """

    on: bool = True
    active: bool = True
    fault: DriveFault | None = None

    @property
    def refusal(self) -> str:
        """Return why nothing can be followed, and what is accepted; empty if something can."""
        if self.on:
            return ""
        if not self.active:
            return "the controller is inactive; accepted: in state active"
        cause = "the controller is disabled" if self.fault is None else f"{self.fault}; torque off"
        return f"{cause}; accepted: after a call of ~/enable with true"

    def turned(self, event: TorqueSwitch) -> Switch:
        """Return it switched on, unless that is up to the node, or off."""
        if event.on:
            return Switch() if self.active or event.by_node else self
        return Switch(False, self.active and not event.by_node, self.fault)


class ServoState:
    """A state.

    Attributes:
        name: in words.
        started: whether states of the motors have come.
        torque: whether the motors get torque in a tick that begins and ends in such states.
        switch: of the torque.
        request: that is followed, or waits.
        stream: that is followed.
    """

    name: ClassVar[str]
    started: ClassVar[bool] = True
    torque: ClassVar[bool] = False
    switch: Switch = Switch()
    request: TrajectoryRequest | None = None
    stream: Stream | None = None

    def settle(self, _: Servo) -> ServoState:
        """Return what follows where a motion has come to its end; before each tick of the position loop."""
        return self

    def tick(self, servo: Servo, states: MotorStates) -> ServoState:
        """Run the loops that are due in a tick."""
        raise NotImplementedError

    def watch(self, _: Servo) -> ServoState:
        """Hold what is followed to its tolerances; after each tick of the position loop."""
        return self

    def answer(self, servo: Servo, event: Event) -> ServoState:
        """Answer an event between two ticks."""
        if isinstance(event, LawChange):
            servo.law_changes.append(event)
        return self

    @property
    def has_goal(self) -> bool:
        """Return whether a goal is followed, or waits."""
        return self.request is not None and self.request.is_goal


# Without torque.


@dataclass(frozen=True, eq=False)
class Off(ServoState):
    """The brakes hold the arm; the set-points follow the motors, and nothing can be followed."""

    name: ClassVar = "off"
    switch: Switch

    def tick(self, servo: Servo, states: MotorStates) -> Off:
        """Let go of the arm."""
        servo.release(states.position)
        return self

    def answer(self, servo: Servo, event: Event) -> ServoState:
        """Refuse requests."""
        match event:
            case Offer(request):
                servo.refuse(request, TrajectoryError(self.switch.refusal))
            case Streamed(_, source):
                servo.refuse_set_points(source, TrajectoryError(self.switch.refusal))
            case TorqueSwitch():
                switch = self.switch.turned(event)
                if switch.on:
                    return Holding()
                return self if event.on else Releasing(switch)
            case Begin():
                servo.hold(event)
        return super().answer(servo, event)


@dataclass(frozen=True, eq=False)
class Releasing(ServoState):
    """The torque was switched off since the last tick: the next one lets go of the arm, and holds it if it is on."""

    name: ClassVar = "releasing"
    awaited: ClassVar = "next tick, with which the torque comes back"
    missing: ClassVar = "the torque comes back with the next tick"
    switch: Switch = Switch()
    request: TrajectoryRequest | None = None

    def tick(self, servo: Servo, states: MotorStates) -> ServoState:
        """Let go of the arm; what waits begins."""
        servo.release(states.position)
        return self.held(servo)

    def held(self, servo: Servo) -> ServoState:
        """Return what follows once the arm is held: what waits is followed, or refused."""
        state = Holding() if self.switch.on else Off(self.switch)
        return state if self.request is None else state.answer(servo, Offer(self.request))

    def answer(self, servo: Servo, event: Event) -> ServoState:
        """Let the newest request wait, if the torque is on."""
        match event:
            case Offer(request):
                return self.wait(servo, request)
            case Streamed(_, source):
                reason = self.switch.refusal or f"{self.missing}; accepted: from then on"
                servo.refuse_set_points(source, TrajectoryError(reason))
            case Cancel(request) if request is self.request:
                servo.cancel(request, "cancelled before it began")
                return replace(self, request=None)
            case GiveUp(reason) if self.has_goal:
                return self.dropped(servo, reason)
            case TorqueSwitch(on):
                state = self if on else self.dropped(servo, event.reason)
                return replace(state, switch=self.switch.turned(event))
            case Begin():
                return self.begin(servo, event)
        return super().answer(servo, event)

    def wait(self, servo: Servo, request: TrajectoryRequest) -> Releasing:
        """Let a request wait in place of the one before."""
        before = self.request
        instead = ""
        if self.switch.refusal and (self.started or request.is_goal):
            servo.refuse(request, TrajectoryError(self.switch.refusal))
            return self
        if before is not None and before.is_goal:
            servo.abort(before, request.replaces, wanted=True)
        elif before is not None:
            instead = ", in place of the one that waited"
        request.state = State.WAITING
        servo.note(f"a {request.kind} waits for the {self.awaited}{instead}")
        return replace(self, request=request)

    def dropped(self, servo: Servo, reason: str) -> Releasing:
        """Let what waits come to nothing."""
        if self.request is None:
            return self
        if self.request.is_goal:
            servo.abort(self.request, reason)
        else:
            servo.note(f"the trajectory that waited is dropped: {reason}")
        return replace(self, request=None)

    def begin(self, servo: Servo, event: Begin) -> ServoState:
        """Hold the arm anew."""
        servo.note_dropped_motion(event.reason)
        state = self.dropped(servo, event.reason)
        servo.hold(event)
        return state.held(servo)


class Unstarted(Releasing):
    """No states have come yet: the first ones are held. A trajectory waits while the torque is off, too."""

    name: ClassVar = "unstarted"
    started: ClassVar = False
    awaited: ClassVar = "simulation's first tick"
    missing: ClassVar = "no states have come yet"

    def dropped(self, servo: Servo, reason: str) -> Releasing:
        """Let a goal come to nothing; a trajectory of the topic goes on waiting."""
        return super().dropped(servo, reason) if self.has_goal else self

    def begin(self, servo: Servo, event: Begin) -> ServoState:
        """Hold the arm."""
        servo.note(servo.outputs.ready)
        servo.hold(event)
        return self.held(servo)


# With torque.


class Powered(ServoState):
    """The motors get torque; what is offered replaces what is followed."""

    torque: ClassVar = True

    def tick(self, servo: Servo, states: MotorStates) -> Powered:
        """Run the loops that are due."""
        servo.cs7b.step(states.position, states.velocity, states.torque)
        return self

    def answer(self, servo: Servo, event: Event) -> ServoState:
        """Follow what is offered, unless it is refused; let go of the arm, or hold it anew."""
        match event:
            case Offer():
                return self.follow(servo, event)
            case Streamed(points, source):
                return self.follow_stream(servo, points, source)
            case TorqueSwitch(on) if not on:
                self.leave(servo, event.reason)
                return Releasing(self.switch.turned(event))
            case Begin():
                servo.note_dropped_motion(event.reason)
                self.leave(servo, event.reason)
                servo.hold(event)
                return Holding()
            case Fault(fault, position):
                text = f"{fault}; torque off, brakes closed"
                servo.complain(f"{text}, trajectory dropped, until ~/enable is called with true")
                self.leave(servo, text)
                servo.cs7b.release(position, servo.cs7b.tick)
                return Off(Switch(on=False, fault=fault))
        return super().answer(servo, event)

    def leave(self, servo: Servo, reason: str, *, wanted: bool = False) -> None:
        """Tell who sent what is followed that it ends; `wanted`: that is no failure."""

    def follow(self, servo: Servo, offer: Offer) -> ServoState:
        """Follow a request, or stay: also where one does not fit the motion to which it was joined."""
        request = offer.request
        if offer.joined is not None and not offer.joined.fits(servo.tick):
            return self
        schedule = servo.enter(request, offer.joined)
        if schedule is None:
            return self
        self.leave(servo, request.replaces, wanted=True)
        request.state = State.WAITING if request.is_goal else State.FOLLOWED
        servo.announce(request, schedule)
        return Following(request)

    def follow_stream(self, servo: Servo, points: SetPoints, source: str) -> ServoState:
        """Follow set-points, of the stream that is followed or of a new one, or stay."""
        stream = self.stream
        if (
            stream is None
            or stream.interface != points.interface
            or (stream.named != points.named).any()
        ):
            stream = Stream(
                points.interface,
                points.named,
                servo.trajectory.limits,
                servo.period,
                servo.streaming,
            )
            stream.pause = self.pause(servo.time)
        told = len(stream.notes)
        try:
            servo.trajectory.follow_stream(stream, points, servo.tick)
        except TrajectoryError as error:
            servo.refuse_set_points(source, error)
            return self
        if stream is not self.stream:
            self.leave(servo, "replaced by streamed set-points", wanted=True)
            servo.note(
                f"stream begins at {servo.time:.3f} s: {points.interface} set-points from {source}"
            )
        for text in list(stream.notes.values())[told:]:
            servo.complain(f"stream: {text}")
        return Streaming(stream)

    def pause(self, _: float) -> float:
        """Return for how long the sender of a stream that begins at a time, s, has been silent, if it was there, s."""
        return 0.0


@dataclass(frozen=True, eq=False)
class Holding(Powered):
    """The arm holds its set-point; `silent_since`: when, s, the last set-point of a stream came that fell silent."""

    name: ClassVar = "holding"
    silent_since: float = -math.inf

    def pause(self, now: float) -> float:
        """Return the time since then, if it is short."""
        pause = now - self.silent_since
        return pause if pause <= LONGEST_PAUSE else 0.0


@dataclass(frozen=True, eq=False)
class Following(Powered):
    """A request is followed: the newest one, also while the motion before it still runs.

    Goals, and trajectories with tolerances that can end them, are compared with these until that decides how they end;
    other trajectories end with their motion.
    """

    name: ClassVar = "following"
    request: TrajectoryRequest

    def settle(self, servo: Servo) -> ServoState:
        """Hold the arm at the end of a trajectory that nobody watches."""
        return self if self.request.watched or servo.moving else Holding()

    def watch(self, servo: Servo) -> ServoState:
        """End the request where its tolerances decide that."""
        request = self.request
        if not request.watched:
            return self
        (tick, desired, actual) = servo.measure()
        request.step(tick, desired, actual, servo.trajectory)
        if not request.reason:
            servo.feed_back(request, tick)
            return self
        if request.state is State.ABORTED:
            servo.trajectory.halt(tick + 1)
        servo.deliver(request)
        return Stopping()

    def leave(self, servo: Servo, reason: str, *, wanted: bool = False) -> None:
        """End a goal."""
        if self.has_goal:
            servo.abort(self.request, f"{reason}, at {servo.time:.6g} s", wanted=wanted)

    def answer(self, servo: Servo, event: Event) -> ServoState:
        """Let the arm stop along the path where the goal is taken back or given up."""
        match event:
            case Cancel(request) if request is self.request:
                (begin, end, _) = servo.trajectory.halt(servo.tick)
                times = (
                    f"from {begin * servo.period:.6g} s on, at rest at {end * servo.period:.6g} s"
                )
                servo.cancel(request, f"cancelled; stopping {times}")
                return Stopping()
            case GiveUp(reason, halt) if self.has_goal:
                self.leave(servo, reason)
                if halt:
                    servo.trajectory.halt(servo.tick)
                return Stopping()
        return super().answer(servo, event)


@dataclass(frozen=True, eq=False)
class Streaming(Powered):
    """Streamed set-points are followed, until none has come for a while and the arm rests."""

    name: ClassVar = "streaming"
    stream: Stream

    def settle(self, servo: Servo) -> ServoState:
        """Hold the arm once the stream is over."""
        if servo.time <= self.stream.expires or servo.moving:
            return self
        self.leave(servo, "holding")
        return Holding(self.stream.expires - servo.streaming.timeout)

    def leave(self, servo: Servo, reason: str, *, wanted: bool = False) -> None:  # noqa: ARG002
        """Note the end of the stream."""
        late = f", {self.stream.late} of them late" if self.stream.late else ""
        count = counted(self.stream.count, "set-point")
        servo.note(f"stream ended at {servo.time:.3f} s after {count}{late}; {reason}")


class Stopping(Powered):
    """What was followed has ended; what is left of its motion, mostly a stop along the path, leads to rest."""

    name: ClassVar = "stopping"

    def settle(self, servo: Servo) -> ServoState:
        """Hold the arm once it rests."""
        return self if servo.moving else Holding()
