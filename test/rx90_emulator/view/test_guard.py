"""Who may speak with the page, and what it hears: strangers, foreign pages in a browser, senseless messages."""

from __future__ import annotations

import http.client
import json
import random
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import msgspec
import pytest
import viser
from browser import BrowserPage, served
from processes import wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from rx90_emulator.view import guard
from rx90_emulator.view.page import Page, on_change, put

Open = Callable[..., BrowserPage]
VISER = Subprotocol(f"viser-v{viser.__version__}")


class Fields:
    """A page with a field of each kind, and what users have given."""

    def __init__(self, page: Page) -> None:
        self.page = page
        place = urlsplit(page.address)
        self.port, self.path = place.port or 0, f"/?{place.query}"
        self.given: list[object] = []
        with page.tab("Fields"):
            self.slider = page.gui.add_slider("angle", -10.0, 10.0, 0.5, 0.0)
            self.option = page.gui.add_dropdown("slide", ["c0", "c1"])
            self.text = page.gui.add_text("speed", "0.1")
            self.tick = page.gui.add_checkbox("loop", False)
            self.button = page.gui.add_button("Send")
            self.shown = page.gui.add_html("")
        for field in (self.slider, self.option, self.text, self.tick):
            on_change(field, lambda field=field: self.given.append(field.value), page)  # type: ignore[misc]

    def connect(self, path: str | None = None, host: str = "127.0.0.1:{}", **options: Any) -> ClientConnection:
        """Open a web socket as viser's client does, by default with the token."""
        address = f"ws://{host.format(self.port)}{self.path if path is None else path}"
        plain = socket.create_connection(("127.0.0.1", self.port))
        return connect(address, sock=plain, subprotocols=[VISER], compression=None, max_size=None, **options)

    def get(self, path: str, host: str = "127.0.0.1:{}", **headers: str) -> http.client.HTTPResponse:
        """Ask for a path by HTTP."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60.0)
        connection.request("GET", path, headers={"Host": host.format(self.port), **headers})
        return connection.getresponse()


def change(field: Any, value: object) -> bytes:
    """Return the message of a client that has changed a field."""
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": field._impl.uuid, "updates": {"value": value}})


@pytest.fixture
def fields() -> Iterator[Fields]:
    """Serve a page on any free port."""
    with served(Page("test", port=0)) as page:
        yield Fields(page)


CAMERA = msgspec.msgpack.encode(
    {
        "type": "ViewerCameraMessage", "wxyz": [1, 0, 0, 0], "position": [0, 0, 1], "fov": 1, "near": 0.1, "far": 10,
        "image_height": 100, "image_width": 100, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
    }
)  # fmt: skip
"""With its first camera a client is there for viser, and its changes count."""


def check_alive(fields: Fields) -> None:
    """Fail unless a client with the token is heard, and the page's thread runs."""
    before = len(fields.given)
    with fields.connect() as client:
        client.send(CAMERA)
        client.send(change(fields.slider, 7.5 if fields.slider.value != 7.5 else 2.5))
        wait_until(lambda: len(fields.given) == before + 1, "the change of a client that may")


STRANGERS = [
    ("evil.example:{}", None),  # a name that its owner lets point here
    ("127.0.0.1.evil.example:{}", None),
    ("localhost.evil.example:{}", None),
    ("localhost@evil.example:{}", None),
    ("192.0.2.1:{}", None),
    ("127.0.0.1:{}", "http://evil.example"),
    ("127.0.0.1:{}", "http://evil.example:{}"),
    ("127.0.0.1:{}", "http://127.0.0.1:1"),  # another server of this machine
    ("127.0.0.1:{}", "http://127.0.0.1"),
    ("127.0.0.1:{}", "http://127.0.0.1:{}.evil.example"),
    ("127.0.0.1:{}", "null"),  # a frame in a sandbox, a file
    ("evil.example:{}", "http://evil.example:{}"),  # what is rebound has equal names
]


def test_who_does_not_come_from_the_page_is_refused(fields: Fields, capfd: pytest.CaptureFixture[str]) -> None:
    """By Host or Origin, also with the token; without it, also from the page. Nothing is served, by HTTP or socket."""
    for host, came_from in STRANGERS:
        origin = None if came_from is None else Origin(came_from.format(fields.port))
        assert fields.get(fields.path, host, **({"Origin": origin} if origin else {})).status == 403, (host, origin)
        if "@" not in host:
            with pytest.raises(InvalidStatus, match="403"):
                fields.connect(host=host, origin=origin)
    name = f"rx90_view_{fields.port}"
    for path, cookie in (
        ("/", ""), ("/?token=", ""), ("/?token=wrong", ""), (f"{fields.path}x", ""), ("/%00", ""), ("/?token=%ff", ""),
        ("/", f"{name}=wrong"), ("/", f"{name}="), ("/", f"other={fields.path[8:]}"),
        (f"{fields.path}&websocket=ws://evil.example", ""),  # viser's client would obey that server
    ):  # fmt: skip
        assert fields.get(path, Cookie=cookie).status == 403, (path, cookie)
        with pytest.raises(InvalidStatus, match="403"):
            fields.connect(path, additional_headers={"Cookie": cookie})
    check_alive(fields)
    said = capfd.readouterr().err
    assert "test: a request was refused: Host 'evil.example" in said
    assert said.count("\n") < 4  # not one for each


@pytest.mark.parametrize("host", ["127.0.0.1:{}", "localhost:{}", "LOCALHOST:{}", "[::1]:{}", "localhost:9000"])
def test_the_page_is_served_to_who_has_its_address(fields: Fields, host: str) -> None:
    """By each name of this machine, also through a tunnel from another port; then by the cookie alone."""
    answer = fields.get(fields.path, host)
    assert (answer.status, b"<title>Viser" in answer.read()) == (200, True)
    assert answer.headers["Content-Security-Policy"] == "frame-ancestors 'none'"
    cookie, *kept = answer.headers["Set-Cookie"].split("; ")
    assert kept == ["Path=/", "HttpOnly", "SameSite=Strict"]
    origin = Origin(f"http://{host.format(fields.port)}")
    others = f'odd={{"a": 1}}; {cookie}; last=2'
    assert fields.get("/", host, Cookie=others).status == 200
    with fields.connect("/", host, origin=origin, additional_headers={"Cookie": others}) as client:
        assert client.recv()


def test_a_page_for_others_is_served_by_address_and_own_name(capsys: pytest.CaptureFixture[str]) -> None:
    """Open to a network, a page has any address of it and the machine's name as Host, no other name, and says so."""
    with served(Page("test", host="0.0.0.0", port=0)) as page:
        fields = Fields(page)
        page.announce(browser=False)
        first, second, _ = capsys.readouterr().out.split("\n")
        assert first.startswith(
            "other machines can open the page, too: who has its address with the token can move the"
        )
        assert second.startswith(f"page: http://0.0.0.0:{fields.port}/?token=")
        own = socket.gethostname()
        hosts = ("192.0.2.1:{}", "[2001:db8::1]:{}", f"{own}:{{}}", f"{own}.local:{{}}", "evil.example:{}")
        assert [fields.get(fields.path, host).status for host in hosts] == [200, 200, 200, 200, 403]
        assert fields.get("/", "192.0.2.1:{}").status == 403


def test_each_page_has_a_token_of_its_own(fields: Fields) -> None:
    """Two pages have different tokens, of 128 bits or more."""
    with served(Page("test", port=0)) as page:
        tokens = {urlsplit(each.address).query.partition("=")[2] for each in (page, fields.page)}
    assert len(tokens) == 2
    assert min(map(len, tokens)) >= 22


def test_values_that_a_field_cannot_have_are_left_out(fields: Fields, capfd: pytest.CaptureFixture[str]) -> None:
    """No option of a list, no number of a slider, no text: it is said in a line, and the field is as it was."""
    wrong = [
        change(fields.option, "c7"), change(fields.option, {"c0": 1}), change(fields.option, None),
        change(fields.slider, 1e9), change(fields.slider, float("nan")), change(fields.slider, "0"),
        change(fields.slider, True), change(fields.slider, None), change(fields.slider, [1]),
        change(fields.text, "x" * 100_000), change(fields.text, 5), change(fields.tick, "yes"), change(fields.tick, 2),
        change(fields.button, []),
        msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": fields.slider._impl.uuid,
                                "updates": {"value": 1.0, "removed": True}}),
    ]  # fmt: skip
    with fields.connect() as client:
        client.send(CAMERA)
        for message in wrong:
            client.send(message)
        client.send(change(fields.tick, True))
        wait_until(lambda: bool(fields.given), "the change that can be")
    assert fields.given == [True]
    assert (fields.slider.value, fields.option.value, fields.text.value) == (0.0, "c0", "0.1")
    assert capfd.readouterr().err == "test: a message was left out: 'slide': 'c7'; accepted: c0, c1\n"


def test_senseless_frames_are_a_line(fields: Fields, capfd: pytest.CaptureFixture[str]) -> None:
    """Texts, noise, and messages that this page's client does not send are left out; the connection stays."""
    noise = random.Random(5)
    frames: list[str | bytes] = [noise.randbytes(noise.randrange(200)) for _ in range(250)]
    frames += ["text", b"", msgspec.msgpack.encode(1), msgspec.msgpack.encode({}), CAMERA[:-4]]
    frames += [msgspec.msgpack.encode(each) for each in (
        {"type": "ShareUrlRequest"}, {"type": ["ShareUrlRequest"]}, {"type": "Message"},
        {"type": "ViewerCameraMessage"}, {"type": "GuiUpdateMessage", "uuid": 1, "updates": {}},
        {**msgspec.msgpack.decode(CAMERA), "image_height": 0}, {**msgspec.msgpack.decode(CAMERA), "wxyz": [1.0]},
        {**msgspec.msgpack.decode(CAMERA), "more": 1}, {"type": "FileTransferStartUpload"},
    )]  # fmt: skip
    with fields.connect() as client:
        client.send(CAMERA)
        for frame in frames:
            client.send(frame)
        client.send(change(fields.slider, 1.0))
        wait_until(lambda: fields.given == [1.0], "the change after it")
    said = capfd.readouterr().err
    assert "test: a message was left out: " in said
    assert said.count("\n") < 4


def test_clients_that_do_not_read_are_dropped(
    fields: Fields, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Of clients one is sent away that would be one too many; those that take nothing go, and one that reads stays."""
    monkeypatch.setattr(guard, "PATIENCE", 0.3)
    monkeypatch.setattr(guard, "MOST_CLIENTS", 4)
    request = (
        f"GET {fields.path} HTTP/1.1\r\nHost: 127.0.0.1:{fields.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"Sec-WebSocket-Protocol: {VISER}\r\n\r\n"
    )
    clients = fields.page._guard._clients
    letters = "".join(map(chr, random.Random(3).choices(range(33, 0xD7FF), k=100_000)))
    with ExitStack() as opened:
        reader = opened.enter_context(fields.connect())
        threading.Thread(target=lambda: all(True for _ in reader), daemon=True).start()
        for _ in range(3):
            deaf = opened.enter_context(socket.create_connection(("127.0.0.1", fields.port)))
            deaf.sendall(request.encode())
        wait_until(lambda: len(clients) == 4, "all clients")
        with fields.connect() as extra, pytest.raises(ConnectionClosed, match="1013"):
            extra.recv(60.0)

        def fill() -> bool:
            fields.shown.content = letters[random.randrange(1000) :]
            return len(clients) == 1

        wait_until(fill, "the end of those that do not read")
        reader.send(CAMERA)
        reader.send(change(fields.slider, 3.0))
        wait_until(lambda: fields.given == [3.0], "the change of the one that reads")
    said = capfd.readouterr().err
    assert "test: a client was sent away: 4 are there; accepted: as many at most" in said
    assert "test: a client was dropped: it has read nothing for 0.3 s" in said
    assert said.count("\n") < 5


def test_clients_are_woken_on_the_thread_that_serves_them(fields: Fields) -> None:
    """Viser tells its clients of a change on its own thread alone, whoever makes it.

    Another one that does so finds the queue of those who wait changed in its hands, which ends it, one time in many.
    """
    woken: list[str] = []

    def done() -> bool:
        woken.append(threading.current_thread().name)
        return True

    spy, server = SimpleNamespace(done=done), fields.page.server._websock_server
    event, call = server._broadcast_buffer.message_event, server._broadcast_buffer.event_loop.call_soon_threadsafe
    with fields.connect():
        wait_until(lambda: not event.is_set(), "a client that waits")
        call(event._waiters.append, spy)
        fields.shown.content = "changed"
        wait_until(lambda: bool(woken), "its waking")
        call(event._waiters.remove, spy)
    assert server._server_thread is not None
    assert set(woken) == {server._server_thread.name}


def test_a_viser_that_serves_otherwise_gives_no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """The guard stands in the call by which viser 1.1 serves; a viser without that call is no page without a guard."""
    stopped: list[bool] = []

    class Other:
        def __init__(self, **_: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append(True)

    assert viser.__version__.startswith("1.1.")
    monkeypatch.setattr(viser, "ViserServer", Other)
    with pytest.raises(RuntimeError, match=r"viser 1\.1\.\d+ does not serve as 1\.1 does"):
        Page("test", port=0)
    assert stopped == [True]


ATTACK = """<!doctype html><title>attack</title><iframe id="frame"></iframe><script>
async function attack(target, protocol, bytes) {
    const got = {};
    for (const mode of ['cors', 'no-cors'])
        got[mode] = await fetch('http://' + target + '/', {mode, credentials: 'include'})
            .then(answer => answer.text()).then(text => text.includes('<title>Viser') ? 'page' : '', () => '');
    got.socket = await new Promise(done => {
        const socket = new WebSocket('ws://' + target, [protocol]);
        socket.onopen = () => { for (const one of bytes) socket.send(new Uint8Array(one)); };
        socket.onmessage = () => done('message');
        socket.onclose = socket.onerror = () => done('');
    });
    return got;
}</script>"""


IN_A_FRAME = """address => new Promise(done => {
    const frame = document.getElementById('frame');
    frame.onload = done;
    frame.src = address;
})"""


@pytest.fixture
def foreign_server() -> Iterator[int]:
    """Serve the page of somebody else on another port; give that."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(ATTACK.encode())

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1]
        server.shutdown()


def test_a_foreign_page_in_the_same_browser_moves_nothing(fields: Fields, open_page: Open, foreign_server: int) -> None:
    """Neither a page of another name, nor of this machine's with another port, nor one whose name is rebound to it.

    Each has what no stranger can know: the port and the field's id. Beside it the page itself works.
    """
    shown = open_page(fields.page.address)
    shown.wait_until(lambda: "Send" in shown.text(), "the page")
    context = shown.page.context
    field = [list(CAMERA), list(change(fields.slider, 9.0))]
    rebound = f"evil.example:{fields.port}"
    # The name has pointed to its owner's server until the attack was loaded.
    context.route(f"http://{rebound}/attack", lambda route: route.fulfill(body=ATTACK, content_type="text/html"))
    for address, target in (
        (f"http://evil.example:{foreign_server}/", f"127.0.0.1:{fields.port}"),
        (f"http://evil.example:{foreign_server}/", f"localhost:{fields.port}"),
        (f"http://127.0.0.1:{foreign_server}/", f"127.0.0.1:{fields.port}"),  # the cookie goes with that
        (f"http://{rebound}/attack", rebound),
    ):
        foreign = context.new_page()
        foreign.goto(address)
        words = f"attack({json.dumps(target)}, {json.dumps(VISER)}, {field})"
        got = foreign.evaluate(words)
        assert got == {"cors": "", "no-cors": "", "socket": ""}, (address, target)
        # In a frame it is not shown, even with the token: nobody clicks on it unseen.
        foreign.evaluate(IN_A_FRAME, fields.page.address)
        assert "<title>Viser" not in foreign.frames[1].content()
        foreign.close()
    stranger = context.new_page()
    assert stranger.goto(f"http://{rebound}{fields.path}").status == 403
    assert (fields.given, fields.slider.value) == ([], 0.0)
    number = shown.page.locator("input[type=text], input[inputmode]").first
    number.fill("4.5")
    shown.wait_until(lambda: fields.given[-1:] == [4.5], "the change on the page itself")
    shown.page.reload()
    shown.wait_until(lambda: "Send" in shown.text(), "the page, loaded again")
    put(fields.text, "0.7")
    values = "() => [...document.querySelectorAll('input')].map(each => each.value)"
    shown.wait_until(lambda: "0.7" in shown.page.evaluate(values), "what the page shows from now on")
    assert (shown.complaints, shown.foreign_requests) == ([], [])
