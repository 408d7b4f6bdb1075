"""Access control in front of viser's server: who may connect, and which messages are accepted.

Viser (1.1) serves whoever connects: it looks neither at the Host and Origin of a request nor at the values in a
message, keeps clients that do not read, and has no limit to their number. Any web page that is open in the same browser
can connect to a port of this machine, and a name that its owner lets point to 127.0.0.1 makes it the same origin (DNS
rebinding). So nothing is served without

- a Host header that names this machine, as an address or by its own name: no name that somebody else has a say in;
- an Origin that is that Host, where there is one; browsers send it with every web socket and foreign request;
- the token of the address that is printed, in the address or in the cookie that the first request gets.

Of messages only those are taken that the fields of this page send, with values that these fields can have.

Viser has no place for any of that: its server is made by `websockets.asyncio.server.serve`, for which `PageGuard`
stands in while a page is made. Where viser no longer asks for it there is no page, rather than one without a guard.
"""

from __future__ import annotations

import asyncio
import http
import ipaddress
import math
import os
import re
import secrets
import socket
import sys
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, TypeGuard
from urllib.parse import parse_qs

import msgspec
import viser
import websockets.asyncio.server
from viser import _messages
from websockets.asyncio.server import ServerConnection, serve
from websockets.http11 import Request, Response

from rx90_common.base.errors import ConfigError
from rx90_common.base.quoting import listed, quoted
from rx90_common.exchange.pacing import ThrottledLog

MOST_CLIENTS = 16
"""Pages that are open at the same time."""
PATIENCE = 15.0
"""A client that has not read anything for so long, s, is dropped; it may take twice as long until that is seen."""

_LONGEST_TEXT = 10_000  # characters in a field
_HOST = re.compile(r"(\[[0-9a-f:.]+\]|[a-z0-9._-]+)(?::([0-9]{1,5}))?")
_OWN_NAMES = ("localhost", "127.0.0.1", "[::1]")
_TAKEN: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (_messages.ViewerCameraMessage, _messages.GuiUpdateMessage, _messages.GetRenderResponseMessage)
}
_HEADERS = {
    "Referrer-Policy": "no-referrer",  # the address has the token in it
    "Content-Security-Policy": "frame-ancestors 'none'",  # nobody lays an invisible page over another one
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
_Handler = Callable[["_Connection"], Awaitable[None]]


def listen(host: str, port: int) -> socket.socket:
    """Return a socket that listens; viser itself would take the next port that is free, and not say so.

    Raises:
        ConfigError: if host and port cannot be bound to.
    """
    try:
        family, _, _, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ConfigError(f"--host {quoted(host)}: {reason}; accepted: an address of this machine") from error
    try:
        return socket.create_server(place, family=family)
    except OSError as error:
        raise ConfigError(
            f"{host} port {port}: {os.strerror(error.errno or 0)}; accepted: --port with a free one, or 0 for any, "
            "and an address of this machine"
        ) from error


class PageGuard:
    """Viser's server behind its access control.

    Args:
        title: of the page; what is refused is said on standard error after it.
        host: address or name that the page is bound to.
        listener: what listens there.

    Attributes:
        server: viser's.
        token: part of the page's address.
        open_to_others: whether other machines can reach the page.
        log: says what is refused.
    """

    def __init__(self, title: str, host: str, listener: socket.socket) -> None:
        self.token, self._listener = secrets.token_urlsafe(24), listener
        address, port, *_ = listener.getsockname()
        self.open_to_others = not ipaddress.ip_address(address.partition("%")[0]).is_loopback
        self._names = {*_OWN_NAMES, host.lower(), f"[{host.lower()}]"}
        if self.open_to_others:
            name = socket.gethostname().lower()
            self._names |= {name, f"{name}.local"}
        self.log = ThrottledLog(lambda line: print(f"{title}: {line}", file=sys.stderr, flush=True))
        self._clients: set[_Connection] = set()
        self._is_asked = self._is_ready = False
        websockets.asyncio.server.serve = self._serve  # type: ignore[misc,assignment]
        try:
            self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        finally:
            websockets.asyncio.server.serve = serve  # type: ignore[misc]
        if not self._is_asked:
            self.server.stop()
            raise RuntimeError(f"viser {viser.__version__} does not serve as 1.1 does, and cannot be guarded")
        _wake_on_the_loop(self.server)
        self._is_ready = True

    def _serve(self, handler: _Handler, _host: str, _port: int, **options: Any) -> Any:
        """Stand for `websockets.asyncio.server.serve`, as viser calls it."""
        self._is_asked = True
        options["process_request"] = partial(self._answer, options["process_request"])
        options["create_connection"] = partial(_Connection, self)
        return serve(partial(self._attend, handler), sock=self._listener, **options)

    def _answer(
        self, served: Callable[[ServerConnection, Request], Response | None], connection: _Connection, request: Request
    ) -> Response | None:
        """Refuse a request, or have viser answer it; None: it is a web socket."""
        reason = self._refusal(request)
        if reason:
            self.log.say("request", f"a request was refused: {reason}")
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")
        try:
            response = served(connection, request)
        except Exception as error:  # viser's own, for NUL in a path
            self.log.say("request", f"a request was refused: {quoted(request.path)} ({quoted(error)})")
            return connection.respond(http.HTTPStatus.BAD_REQUEST, "Refused.\n")
        if response is not None:
            for name, value in _HEADERS.items():
                response.headers[name] = value
            cookie = f"{_cookie_name(request)}={self.token}; Path=/; HttpOnly; SameSite=Strict"
            response.headers["Set-Cookie"] = cookie
        return response

    def _refusal(self, request: Request) -> str:
        """Return why nothing is served, if so."""
        if not self._is_ready:
            return "the page is not ready yet"
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        if len(hosts) != 1 or not self._is_own(hosts[0].lower()):
            return f"Host {listed(map(quoted, hosts))}; accepted: the address that was printed"
        if origins and origins[0].lower() not in {f"{way}://{hosts[0].lower()}" for way in ("http", "https")}:
            return f"Origin {listed(map(quoted, origins))}; accepted: the page itself"
        query = parse_qs(request.path.partition("?")[2], keep_blank_values=True)
        others = [name for name in query if name != "token"]
        if others:  # viser's client would connect to any server that the address names, and do what that says
            return f"{listed(map(quoted, others))} in the address; accepted: token"
        cookies = "; ".join(request.headers.get_all("Cookie")).split(";")
        given = {name.strip(): value for name, _, value in (cookie.partition("=") for cookie in cookies)}
        tokens = [*query.get("token", []), given.get(_cookie_name(request), "")]
        if any(secrets.compare_digest(each.encode("utf-8", "surrogatepass"), self.token.encode()) for each in tokens):
            return ""
        return "without the token, or with an old one; accepted: the address that was printed"

    def _is_own(self, host: str) -> bool:
        """Tell whether a Host header names this machine; any port, because a tunnel may have another one."""
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        if match[1] in self._names:
            return True
        try:
            ipaddress.ip_address(match[1].strip("[]"))
        except ValueError:
            return False
        return self.open_to_others  # no name, so nobody has let it point here

    async def _attend(self, handler: _Handler, connection: _Connection) -> None:
        """Let viser serve a client, unless there are too many, until either of them ends it or it stops reading."""
        if len(self._clients) >= MOST_CLIENTS:
            self.log.say("clients", f"a client was sent away: {MOST_CLIENTS} are there; accepted: as many at most")
            await connection.close(1013, f"{MOST_CLIENTS} clients are there")
            return
        self._clients.add(connection)
        watch = asyncio.ensure_future(connection.drop_when_deaf())
        try:
            await handler(connection)
        finally:
            watch.cancel()
            self._clients.discard(connection)

    def fault(self, raw: str | bytes) -> str:
        """Return why a message is none that the page's own client sends, if so."""
        if isinstance(raw, str):
            return f"the text {quoted(raw)}; accepted: bytes"
        try:
            fields = msgspec.msgpack.decode(raw)
            name = fields.pop("type")
            if name not in _TAKEN:
                return f"{quoted(name)}; accepted: {listed(_TAKEN)}"
            message = msgspec.convert(fields, _TAKEN[name])
            _messages.Message.deserialize(raw)
        except Exception as error:  # whatever viser meets in bytes that anybody may send
            return f"{quoted(raw)} ({quoted(str(error))}); accepted: {listed(_TAKEN)}"
        if isinstance(message, _messages.ViewerCameraMessage):
            sizes = message.image_width, message.image_height
            return "" if min(sizes) > 0 else f"a camera of {sizes[0]} x {sizes[1]} pixels; accepted: positive numbers"
        field = self.server.gui._gui_input_handle_from_uuid.get(getattr(message, "uuid", ""))
        if field is None:
            return ""  # it has gone meanwhile, and viser knows that
        given = message.updates
        accepted = _accepted(field, given["value"]) if set(given) == {"value"} else f"{listed(given)}; accepted: value"
        return accepted and f"{quoted(getattr(field, 'label', ''))}: {quoted(given.get('value'))}; {accepted}"


class _Connection(ServerConnection):
    """A client's connection; messages that the guard refuses are left out, a client that stops reading is dropped."""

    def __init__(self, guard: PageGuard, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._guard = guard
        self._waiting = self._sent = 0

    async def recv(self, decode: bool | None = None) -> Any:
        while reason := self._guard.fault(raw := await super().recv(decode)):
            self._guard.log.say("message", f"a message was left out: {reason}")
        return raw

    async def send(self, *arguments: Any, **options: Any) -> None:
        self._waiting += 1
        try:
            await super().send(*arguments, **options)
            self._sent += 1
        finally:
            self._waiting -= 1

    async def drop_when_deaf(self) -> None:
        """Cut the connection when the client reads nothing of what is sent; a ping would wait in the same queue."""
        sent, left = -1, math.inf
        while not self._waiting or self._sent != sent or self.transport.get_write_buffer_size() < left:
            sent, left = self._sent, self.transport.get_write_buffer_size()
            await asyncio.sleep(PATIENCE)
        self._guard.log.say("deaf", f"a client was dropped: it has read nothing for {PATIENCE:g} s")
        self.transport.abort()


class _LoopEvent(asyncio.Event):
    """An event that viser sets on any thread, and then once more on that of its loop; only that one may wake others."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._of = loop

    def set(self) -> None:
        if asyncio._get_running_loop() is self._of:
            super().set()


def _wake_on_the_loop(server: viser.ViserServer) -> None:
    """Keep viser's other threads from waking its clients, which ends in "deque mutated during iteration"."""

    def mend(client: Any) -> None:
        buffer = client.get_message_buffer()
        buffer.message_event = _LoopEvent(buffer.event_loop)

    mend(server._websock_server)
    server._websock_server.on_client_connect(mend)


def _accepted(field: Any, given: object) -> str:
    """Return what a field accepts, if that is not what it is given."""
    now, options = field.value, getattr(field, "options", None)
    if options is not None:
        return "" if given in options else f"accepted: {listed(options)}"
    if isinstance(now, bool):
        return "" if isinstance(given, bool) else "accepted: true or false"
    if isinstance(now, str):
        good = isinstance(given, str) and len(given) <= _LONGEST_TEXT
        return "" if good else f"accepted: a text of at most {_LONGEST_TEXT} characters"
    if isinstance(now, int | float):
        step = getattr(field, "step", None) or 0.0  # to which the client rounds
        low, high = (getattr(field, name, None) for name in ("min", "max"))
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        good = _is_number(given) and low - step <= given <= high + step
        return "" if good else f"accepted: a number from {low:g} to {high:g}"
    if isinstance(now, tuple):
        good = isinstance(given, list | tuple) and len(given) == len(now) and all(map(_is_number, given))
        return "" if good else f"accepted: {len(now)} numbers"
    return "accepted: nothing"


def _is_number(given: object) -> TypeGuard[float]:
    return isinstance(given, int | float) and not isinstance(given, bool) and math.isfinite(given)


def _cookie_name(request: Request) -> str:
    """Return a name of its own for each port, because a browser sends a cookie to all ports of a machine."""
    match = _HOST.fullmatch(request.headers["Host"].lower())
    return f"rx90_view_{match[2] if match and match[2] else 80}"
