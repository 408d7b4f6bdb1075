"""Services called without waiting: what becomes of a call is handed to who made it, at the latest after a time-out."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

from rclpy.client import Client
from rclpy.task import Future

from rx90_common.base.errors import ExchangeError
from rx90_common.exchange.client_node import ClientNode


class ServiceRequest(NamedTuple):
    """What is asked of a service.

    Attributes:
        kind: type of the service.
        service: its name.
        request: of that type.
        read: returns what an answer says; raises ExchangeError for one that is a refusal.
    """

    kind: Any
    service: str
    request: Any
    read: Callable[[Any], str]


Outcome = Callable[["str | ExchangeError"], None]
"""Takes what an answer says, or why there is none, or none that is a yes."""


class _Open(NamedTuple):
    asked: ServiceRequest
    caller: Client
    answer: Future
    deadline: float
    then: Outcome


class ServiceCalls:
    """Calls of services that go on while `ClientNode.spin` is called; `look` is to be called as often.

    Args:
        client: the node; its timeout is the longest wait for an answer.
    """

    def __init__(self, client: ClientNode) -> None:
        self._client = client
        self._callers: dict[str, Client] = {}
        self._open: list[_Open] = []

    def there(self, asked: ServiceRequest) -> bool:
        """Return whether somebody serves what is asked."""
        return bool(self._caller(asked).service_is_ready())

    def ask(self, asked: ServiceRequest, then: Outcome) -> None:
        """Call a service; `then` gets what it says."""
        caller = self._caller(asked)
        if not caller.service_is_ready():
            then(ExchangeError(f"there is no service {caller.srv_name}; accepted: while its node runs"))
            return
        deadline = time.monotonic() + self._client.timeout
        self._open.append(_Open(asked, caller, caller.call_async(asked.request), deadline, then))

    def look(self) -> None:
        """Hand over the answers that have come, and say of the calls that are too old that none has."""
        now = time.monotonic()
        ended = [call for call in self._open if call.answer.done() or now >= call.deadline]
        self._open = [call for call in self._open if call not in ended]
        for call in ended:
            call.then(self._outcome(call))

    def _outcome(self, call: _Open) -> str | ExchangeError:
        if not call.answer.done():
            call.caller.remove_pending_request(call.answer)
            return ExchangeError(f"no answer of {call.caller.srv_name} within {self._client.timeout:g} s")
        try:
            return call.asked.read(call.answer.result())
        except ExchangeError as error:
            return error

    def _caller(self, asked: ServiceRequest) -> Client:
        if asked.service not in self._callers:
            self._callers[asked.service] = self._client.node.create_client(asked.kind, asked.service)
        return self._callers[asked.service]


def spoken(service: str) -> Callable[[Any], str]:
    """Return what reads an answer with `success` and `message`."""

    def read(answer: Any) -> str:
        if not answer.success:
            raise ExchangeError(f"{service}: {answer.message}")
        return str(answer.message)

    return read
