"""What an attacker tries against the page's server: other sites, other names, wrong tokens, too much of anything."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click import ClickException
from click.testing import CliRunner

from phm.cli import group
from phm.cli.web_options import listen_options
from phm.gcs.web import sessions as sessions_module
from phm.gcs.web.clients import MAX_CLIENTS
from phm.gcs.web.options import ListenOptions, OptionError, Tokens, is_loopback, read_tokens
from phm.gcs.web.sessions import AGAIN_S, FAILURES, FAILURES_ALL, Sessions, network
from tests.fakes.until import until
from tests.gcs.web.swarm import LIMIT_S, Client, Ground, ground

VIEW, OPERATE = "view-token-0123456789", "operate-token-0123456789"
CHECK = {"agent": "A07", "do": "check"}
SILENCE = {"do": "silence", "agent": None, "for_s": 5}


@pytest.fixture(scope="module")
def open_page() -> Iterator[Ground]:
    """On loopback, without tokens."""
    with ground() as made:
        yield made


@pytest.fixture
def locked(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ground]:
    """With both tokens; new for each test, because wrong tokens are remembered: for longer than a test may take."""
    monkeypatch.setattr(sessions_module, "AGAIN_S", 3600.0)
    with ground(ListenOptions(port=0, tokens=Tokens(VIEW, OPERATE))) as made:
        yield made


def operator(page: Ground) -> Client:
    client = page.client()
    client.session()
    return client


# ---------------------------------------------------------------- other sites


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "https://127.0.0.1:{port}"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
        {"Sec-Fetch-Site": "none"},
        {"X-PHM-CSRF": None},
        {"X-PHM-CSRF": ""},
        {"X-PHM-CSRF": "wrong"},
        {"Cookie": None},
        {"Cookie": "phm_session=x"},
        {"Content-Type": "text/plain"},
        {"Content-Type": "application/x-www-form-urlencoded"},
        {"Content-Type": None},
    ],
    ids=str,
)
def test_a_change_from_elsewhere_is_refused(open_page: Ground, headers: dict[str, str | None]) -> None:
    """Another origin, a form, a missing session or a missing CSRF header: each alone is enough."""
    client, port = operator(open_page), open_page.page.address[1]
    sent = {name: value and value.format(port=port) for name, value in headers.items()}
    status, body, _ = client.ask("POST", "/api/alarms", SILENCE, sent)
    assert status in (401, 403, 415), body
    assert body["error"]
    own = {"Origin": f"http://127.0.0.1:{port}", "Sec-Fetch-Site": "same-origin"}
    assert client.ask("POST", "/api/alarms", SILENCE, own)[0] == 200


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS"])
def test_other_methods_are_not_there(open_page: Ground, method: str) -> None:
    """And a preflight gets no permission."""
    status, _, response = operator(open_page).ask(method, "/api/alarms", None, {"Origin": "http://evil.example"})
    assert status in (403, 405)
    assert not [name for name in response.headers if name.lower().startswith("access-control")]


@pytest.mark.parametrize("path", ["/api/state", "/api/session", "/api/live", "/snapshot", "/api/history/events"])
def test_a_page_of_another_site_cannot_read(open_page: Ground, path: str) -> None:
    """By what its browser says; nothing has a CORS header."""
    status, _, response = open_page.client().ask("GET", path, None, {"Sec-Fetch-Site": "cross-site"})
    assert status == 403
    assert response.headers["Cross-Origin-Resource-Policy"] == "same-origin"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8080",
        "127.0.0.1.evil.example",
        "127.evil",
        "localhost.evil",
        "",
        "[::1",
        "0.0.0.0",
    ],
)
def test_a_name_that_points_here_is_refused(open_page: Ground, host: str) -> None:
    """DNS rebinding: the Host header has the attacker's name. Also for the files of the page."""
    for path in ("/", "/api/state", "/api/session"):
        status, _, response = open_page.client().ask("GET", path, None, {"Host": host})
        assert status in (400, 403)
        assert "Set-Cookie" not in response.headers


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1:1", "[::1]:8080", "127.1.2.3", "LOCALHOST:9"])
def test_names_of_this_machine_are_served(open_page: Ground, host: str) -> None:
    """With any port: a tunnel may have another one."""
    assert open_page.client().ask("GET", "/api/state", None, {"Host": host})[0] == 200


# ---------------------------------------------------------------- tokens and roles


def test_without_a_token_there_are_no_data(locked: Ground) -> None:
    """The files of the page and the question for the session are all."""
    client = locked.client()
    assert client.ask("GET", "/")[0] == 200
    assert {"role": None, "csrf": None, "login": True, "page": "gcs"}.items() <= client.session().items()
    for path in ("/api/state", "/api/live", "/stream", "/snapshot", "/api/history/events", "/api/requests"):
        assert client.ask("GET", path)[0] == 401, path


def test_the_view_role_changes_nothing(locked: Ground) -> None:
    """With its cookie and with its token."""
    client = locked.client()
    assert client.login(VIEW)[1]["role"] == "view"
    assert client.ask("GET", "/api/state")[0] == 200
    program = locked.client()
    program.token = VIEW
    for one in (client, program):
        for path, body in (("/api/alarms", SILENCE), ("/api/requests", CHECK), ("/api/replay", {"do": "pause"})):
            status, answer, _ = one.ask("POST", path, body)
            assert (status, answer["error"]) == (403, "this needs the role operate")


def test_the_operate_role_operates(locked: Ground) -> None:
    """With its cookie, which no script can read and no other site sends, and with its token."""
    client = locked.client()
    status, body, response = client.ask("POST", "/api/login", {"token": OPERATE})
    assert (status, body["role"]) == (200, "operate")
    cookie = response.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    client.keep(body, response)
    assert client.ask("POST", "/api/alarms", SILENCE)[0] == 200
    program = locked.client()
    program.token = OPERATE
    assert program.ask("POST", "/api/alarms", SILENCE)[0] == 200
    assert client.ask("POST", "/api/logout", {})[0] == 200
    assert client.ask("GET", "/api/state")[0] == 401


def test_a_stream_ends_with_its_session(locked: Ground) -> None:
    """After the log-out nothing more is received; the streams of another session, and of a program with a token, go on."""
    client, other, program = locked.client(), locked.client(), locked.client()
    assert client.login(VIEW)[0] == other.login(VIEW)[0] == 200
    program.token = VIEW
    streams = [locked.live(client), locked.live(client, "/stream"), locked.live(other), locked.live(program)]
    assert client.ask("POST", "/api/logout", {})[0] == 200
    until(lambda: streams[0].ended and streams[1].ended, "the end of the streams")
    before = [len(one.messages) for one in streams[2:]]
    locked.vehicle().heartbeat()
    until(lambda: all(len(one.messages) > n for one, n in zip(streams[2:], before, strict=True)), "the other streams")


def test_tokens_cannot_be_guessed_quickly(locked: Ground) -> None:
    """After a few wrong ones even the right one has to wait."""
    client = locked.client()
    for _ in range(FAILURES - 1):
        assert client.login("wrong" * 5)[0] == 403
    client.token = "also-wrong-0123456789"
    assert client.ask("GET", "/api/state")[0] == 403
    client.token = ""
    assert client.login(OPERATE)[0] == 429


def test_a_token_that_is_not_unicode_counts_as_wrong(locked: Ground, caplog: pytest.LogCaptureFixture) -> None:
    """JSON can hold half of a surrogate pair. Such requests fill no log with tracebacks."""
    client = locked.client()
    for _ in range(FAILURES):
        assert client.login("\ud800")[0] == 403
    assert client.login("\ud800")[0] == client.login(OPERATE)[0] == 429
    assert "Traceback" not in caplog.text


def test_a_wrong_token_counts_for_a_minute_and_not_longer() -> None:
    """After FAILURES an address has one try per AGAIN_S; one wrong token is forgotten after it."""
    sessions = Sessions(None)
    for _ in range(FAILURES):
        assert not sessions.blocked("10.0.0.7", 1000.0)
        sessions.failed("10.0.0.7", 1000.0)
    assert sessions.blocked("10.0.0.7", 1000.0 + 0.9 * AGAIN_S)
    assert not sessions.blocked("10.0.0.7", 1000.0 + AGAIN_S)
    sessions.failed("10.0.0.7", 1000.0 + AGAIN_S)
    assert sessions.blocked("10.0.0.7", 1000.0 + 1.9 * AGAIN_S)
    assert not sessions.blocked("10.0.0.8", 1000.0)


def _login(page: Ground, address: str, token: str) -> int:
    """The status of a log-in from one of this machine's addresses."""
    connection = http.client.HTTPConnection(*page.page.address, timeout=LIMIT_S, source_address=(address, 0))
    try:
        connection.request("POST", "/api/login", json.dumps({"token": token}), {"Content-Type": "application/json"})
        return connection.getresponse().status
    finally:
        connection.close()


def test_wrong_tokens_of_others_keep_no_one_out(locked: Ground) -> None:
    """Fifty of many addresses limit these to one try each; an address without a wrong token, or with a session, logs in."""
    assert _login(locked, "127.0.0.2", OPERATE) == 200
    assert _login(locked, "127.0.0.2", "wrong" * 5) == 403
    for number in range(FAILURES_ALL):
        assert _login(locked, f"127.0.1.{number + 1}", "wrong" * 5) == 403
    assert _login(locked, "127.0.1.1", OPERATE) == 429, "it has failed before"
    assert _login(locked, "127.0.2.1", "wrong" * 5) == 403
    assert _login(locked, "127.0.2.1", OPERATE) == 429, "one try"
    assert _login(locked, "127.0.0.3", OPERATE) == 200, "it has never failed"
    assert _login(locked, "127.0.0.2", OPERATE) == 200, "it has a session"


@pytest.mark.parametrize(
    ("address", "counted"),
    [
        ("10.0.0.7", "10.0.0.7"),
        ("::ffff:10.0.0.7", "10.0.0.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("?", "?"),
    ],
)
def test_the_addresses_of_one_machine_are_one(address: str, counted: str) -> None:
    """With IPv6 each machine has as many as it likes."""
    assert network(address) == counted


@pytest.mark.parametrize("token", [None, 5, "", "x" * 2000, "ünïcode-token-0123456", "\ud800", VIEW[:-1], VIEW + "x"])
def test_a_wrong_token_opens_nothing(locked: Ground, token: Any) -> None:
    """Whatever its type."""
    status, body, response = locked.client().ask("POST", "/api/login", {"token": token})
    assert status in (400, 403), body
    assert "Set-Cookie" not in response.headers


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "contains no token"),
        ("view: short", "16 or more"),
        ("admin: 0123456789abcdef", "'view: TOKEN' or 'operate: TOKEN'"),
        (f"view: {VIEW}\nview: {VIEW}", ":2: write"),
        (f"view: {VIEW}\noperate: {VIEW}", "same token"),
    ],
)
def test_a_wrong_token_file_is_explained(tmp_path: Path, text: str, words: str) -> None:
    """With file, line and remedy."""
    path = tmp_path / "tokens"
    path.write_text(text)
    path.chmod(0o600)
    with pytest.raises(OptionError, match=words):
        read_tokens(str(path))


def test_a_token_file_that_others_can_read_is_refused(tmp_path: Path) -> None:
    """With the command that helps; as its owner's alone it is accepted."""
    path = tmp_path / "tokens"
    path.write_text(f"# comment\nview: {VIEW}\noperate: {OPERATE}\n")
    path.chmod(0o644)
    with pytest.raises(OptionError, match="chmod 600"):
        read_tokens(str(path))
    path.chmod(0o600)
    assert read_tokens(str(path)) == Tokens(VIEW, OPERATE)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--web", "0.0.0.0:0"), "add --token-file"),
        (("--web", "192.168.7.1:0"), "add --token-file"),
        (("--web", "example.org:0"), "add --token-file"),
        (("--web", "0.0.0.0:0", "--token-file", "{tokens}"), "--tls-cert"),
        (("--serve", "0.0.0.0:0", "--token-file", "{tokens}"), "--tls-cert"),
        (("--serve", "0.0.0.0:0", "--behind-proxy"), "add --token-file"),
        (("--web", "127.0.0.1:0", "--behind-proxy"), "--behind-proxy needs --token-file"),
        (("--web", "127.0.0.1:0", "--tls-cert", "{tokens}"), "must be given together"),
        (("--web", "127.0.0.1:0", "--tls-cert", "{tokens}", "--tls-key", "{tokens}"), "both in PEM format"),
        (("--web", "127.0.0.1:0", "--token-file", "/none"), "--token-file /none: No such file"),
        (("--token-file", "{tokens}"), "needs --web or --serve"),
        (("--history", "x"), "needs --web"),
        (("--web", "udpin:127.0.0.1:14551"), "write it before --web: phm gcs udpin:127.0.0.1:14551 --web 8080"),
        (("--web", "/dev/ttyUSB0"), "write it before --web: phm gcs /dev/ttyUSB0 --web 8080"),
        (("--serve", "tcp:10.0.0.5:5760"), "write it before --serve: phm gcs tcp:10.0.0.5:5760 --serve 8080"),
    ],
)
def test_unsafe_options_are_refused_before_the_start(tmp_path: Path, arguments: tuple[str, ...], words: str) -> None:
    """Before anything is opened, with what to add."""
    tokens = tmp_path / "tokens"
    tokens.write_text(f"operate: {OPERATE}\n")
    tokens.chmod(0o600)
    given = [one.format(tokens=tokens) for one in arguments]
    result = CliRunner().invoke(group, ["gcs", "udpin:127.0.0.1:14550", *given])
    assert result.exit_code in (1, 2)
    assert words.format(tokens=tokens) in result.output, result.output


def test_beyond_loopback_with_a_token_behind_a_proxy_is_allowed(tmp_path: Path) -> None:
    """And `--serve`, which changes nothing, as before."""
    tokens = tmp_path / "tokens"
    tokens.write_text(f"operate: {OPERATE}\n")
    tokens.chmod(0o600)
    made = listen_options(("0.0.0.0", 0), str(tokens), None, None, behind_proxy=True)
    assert (made.loopback, made.tokens) == (False, Tokens("", OPERATE))
    assert listen_options(("0.0.0.0", 0), None, None, None, behind_proxy=False, stream=True).tokens is None
    with pytest.raises(ClickException):
        listen_options(("0.0.0.0", 0), None, None, None, behind_proxy=False)


def test_loopback_is_an_address_not_the_beginning_of_a_name() -> None:
    """Anyone can own a name that begins with 127."""
    assert [is_loopback(one) for one in ("127.0.0.1", "127.9.9.9", "::1", "localhost", "LocalHost")] == [True] * 5
    others = ("127.0.0.1.evil", "127.evil", "localhost.evil", "", "0.0.0.0", "::", "1.2.3.4", "127.1")
    assert [is_loopback(one) for one in others] == [False] * 8


# ---------------------------------------------------------------- headers and files


def test_every_answer_has_the_protecting_headers(open_page: Ground) -> None:
    """Pages, data, errors: no inline script, no frame, no guessed type, no referrer."""
    for path in ("/", "/api/state", "/api/none", "/static/none.js", "/api/history/series?since=x"):
        _, _, response = open_page.client().ask("GET", path)
        policy = response.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert "*" not in policy
        assert response.headers["X-Content-Type-Options"] == "nosniff"
        assert response.headers["Referrer-Policy"] == "no-referrer"
        assert response.headers["Server"] == "phm"


@pytest.mark.parametrize(
    "path",
    [
        "/static/../server.py",
        "/static/..%2fserver.py",
        "/static/%2e%2e/server.py",
        "/static/....//server.py",
        "/static//etc/passwd",
        "/static/%00index.html",
        "/static/index.html/../../server.py",
        "/static/..\\server.py",
        "/static/",
    ],
)
def test_only_the_files_of_the_page_are_served(open_page: Ground, path: str) -> None:
    """A path is looked up, never opened."""
    status, body, _ = open_page.client().ask("GET", path)
    assert status in (400, 403, 404)
    assert b"aiohttp" not in json.dumps(body).encode() if isinstance(body, dict) else b"aiohttp" not in body


# ---------------------------------------------------------------- too much


def test_a_large_body_is_refused(open_page: Ground) -> None:
    """By its length, announced or not; the server goes on."""
    client = operator(open_page)
    assert client.ask("POST", "/api/alarms", {"x": "x" * 70_000})[0] == 413
    assert client.ask("POST", "/api/alarms", b"[" * 60_000)[0] == 400
    connection = client.connect()
    with contextlib.closing(connection):
        headers = {"Cookie": client.cookie, "X-PHM-CSRF": client.csrf, "Content-Type": "application/json"}
        with contextlib.suppress(OSError):
            connection.request("POST", "/api/alarms", iter([b"x" * 10_000] * 300), headers, encode_chunked=True)
        with contextlib.suppress(OSError, http.client.HTTPException):
            assert connection.getresponse().status == 413
    assert client.ask("GET", "/api/state")[0] == 200


@pytest.mark.parametrize("path", ["/" + "x" * 5000, "/" + "x" * 20_000, "/api/state?" + "x" * 5000])
def test_a_long_url_is_refused(open_page: Ground, path: str) -> None:
    """With a status, not with memory."""
    assert open_page.client().ask("GET", path)[0] in (400, 414)


def received(sock: socket.socket, sent: bytes) -> bytes:
    """Empty when the connection was closed, also when that was before the words were sent."""
    with contextlib.suppress(ConnectionError):
        sock.sendall(sent)
        return sock.recv(100)
    return b""


def test_a_connection_that_asks_nothing_is_closed(open_page: Ground, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also one that sends its request byte by byte."""
    monkeypatch.setattr("phm.gcs.web.connections.GREET_S", 0.3)
    for sent in (b"", b"GET / HT"):
        with socket.create_connection(open_page.page.address, LIMIT_S) as sock:
            assert received(sock, sent) == b""


def test_a_thousand_clients_get_a_place_or_a_refusal(open_page: Ground) -> None:
    """The limit holds, and a page that is open stays live."""
    live, sockets = open_page.live(), list[socket.socket]()
    until(lambda: live.state, "the state")
    try:
        for _ in range(1000):
            with contextlib.suppress(OSError):
                sock = socket.create_connection(open_page.page.address, 5)
                sock.sendall(b"GET /api/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
                sockets.append(sock)
        open_page.vehicle(77).heartbeat()
        until(lambda: live.agent("A77"), "the agent at the first client")
        assert len(open_page.page.server.clients) <= MAX_CLIENTS
        answers = [head(sock) for sock in sockets]
        assert answers.count(b"200") < MAX_CLIENTS
        assert set(answers) <= {b"200", b"503", b""}
    finally:
        for sock in sockets:
            sock.close()
    until(lambda: len(open_page.page.server.clients) <= 1, "their ends")
    until(lambda: served(open_page), "a new client to be served")


def served(page: Ground) -> bool:
    with contextlib.suppress(OSError, http.client.HTTPException):
        return page.client().ask("GET", "/api/state")[0] == 200
    return False


def head(sock: socket.socket) -> bytes:
    """The status of the answer; empty: the connection was closed."""
    sock.settimeout(30)
    with contextlib.suppress(OSError):
        return (sock.recv(200).split() or [b"", b""])[1]
    return b""


def test_a_client_that_does_not_read_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others get everything, and the operator sees how many were dropped."""
    monkeypatch.setattr("phm.gcs.web.clients.MAX_BACKLOG", 200_000)
    with ground() as here:
        quick = here.live()
        slow = socket.socket()
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.connect(here.page.address)
        slow.sendall(b"GET /api/live HTTP/1.1\r\nHost: localhost\r\n\r\n")
        until(lambda: len(here.page.server.clients) == 2, "both clients")
        vehicle, number = here.vehicle(), 0

        def go_on() -> bool:
            nonlocal number
            number += 1
            here.page._view.publish("note", {"number": number, "text": "x" * 20_000})
            until(lambda: quick.of("note") and quick.of("note")[-1]["number"] == number, "the note")
            return here.page.server.clients.dropped > 0

        until(go_on, "the slow client to be dropped")
        vehicle.heartbeat()
        until(lambda: quick.agent("A07"), "the agent")
        until(lambda: quick.state["ground"]["dropped"] == 1, "the count")
        assert [note["number"] for note in quick.of("note")] == list(range(1, number + 1))
        slow.close()


@pytest.mark.parametrize("option", ["--web", "--serve"])
def test_without_the_extra_it_says_what_to_install(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is opened."""
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    result = CliRunner().invoke(group, ["gcs", "udpin:127.0.0.1:14550", option, "0"])
    assert result.exit_code == 1
    assert result.output.startswith(
        f"Error: {option} needs aiohttp: install the extra 'web' (in a clone of PHM: pip install '.[web]')"
    )
