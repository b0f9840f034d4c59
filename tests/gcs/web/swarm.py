"""A ground station with its page on loopback, agents that send real frames, and clients of the page."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import ssl
import threading
from collections.abc import Iterator, Mapping
from typing import Any

from phm.core.clock import SystemClock
from phm.core.settings import MavlinkSettings
from phm.gcs.station import COMPONENT, GroundStation
from phm.gcs.web.options import ListenOptions
from phm.gcs.web.page import GroundPage
from phm.transport.dialect import mavlink
from phm.wire import status_word
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.until import until
from tests.gcs.bench import HEALTHY

LIMIT_S = 120.0
Json = dict[str, Any]


class Vehicle:
    """Sends what an agent sends; receives what the station sends."""

    def __init__(self, number: int, port: int, component: int = 193) -> None:
        self.number = number
        self._sender = Sender(number, component)
        self._autopilot = Sender(number, 1)
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.settimeout(0.05)
        self._to = ("127.0.0.1", port)
        self._decoder = mavlink.MAVLink(None)

    def heartbeat(self, levels: Mapping[Any, Any] | None = None, state: int = 4) -> None:
        message = heartbeat(status_word.encode({**HEALTHY, **(levels or {})}))
        message.system_status = state
        self.send(message)

    def send(self, message: Any) -> None:
        self._sock.sendto(self._sender.frame(message), self._to)

    def say(self, words: str, severity: int = 2) -> None:
        self.send(text(words, severity))

    def autopilot(self, *, armed: bool) -> None:
        frame = self._autopilot.frame(heartbeat(5, kind=2, autopilot=3, base_mode=128 if armed else 0))
        self._sock.sendto(frame, self._to)

    def receive(self) -> list[Any]:
        try:
            return self._decoder.parse_buffer(self._sock.recv(65535)) or []
        except TimeoutError:
            return []

    def close(self) -> None:
        self._sock.close()


class Client:
    """A program, or a browser, at the page: with a cookie and the CSRF header once `session` was called."""

    def __init__(self, address: tuple[str, int], tls: ssl.SSLContext | None = None) -> None:
        self.address, self._tls = address, tls
        self.cookie, self.csrf, self.token = "", "", ""

    def ask(
        self, method: str, path: str, body: object = None, headers: Mapping[str, str | None] | None = None
    ) -> tuple[int, Any, http.client.HTTPResponse]:
        """Status, body (parsed if it is JSON) and response. A header of None is left out."""
        sent: dict[str, str | None] = {"Host": f"127.0.0.1:{self.address[1]}"}
        if body is not None or method == "POST":
            sent["Content-Type"] = "application/json"
            sent["X-PHM-CSRF"] = self.csrf or None
        if self.cookie:
            sent["Cookie"] = self.cookie
        if self.token:
            sent["Authorization"] = f"Bearer {self.token}"
        sent.update(headers or {})
        data = body if isinstance(body, bytes) else json.dumps(body if body is not None else {}).encode()
        connection = self.connect()
        with contextlib.closing(connection):
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in sent.items():
                if value is not None:
                    connection.putheader(name, value)
            if method == "POST":
                connection.putheader("Content-Length", str(len(data)))
            connection.endheaders(data if method == "POST" else None)
            response = connection.getresponse()
            read = response.read()
        is_json = response.headers.get_content_type() == "application/json"
        return response.status, json.loads(read) if is_json and read else read, response

    def connect(self) -> http.client.HTTPConnection:
        if self._tls is not None:
            return http.client.HTTPSConnection("127.0.0.1", self.address[1], timeout=LIMIT_S, context=self._tls)
        return http.client.HTTPConnection(*self.address, timeout=LIMIT_S)

    def get(self, path: str, status: int = 200) -> Any:
        found, body, _ = self.ask("GET", path)
        assert found == status, body
        return body

    def post(self, path: str, body: object, status: int = 200) -> Any:
        found, answer, _ = self.ask("POST", path, body)
        assert found == status, answer
        return answer

    def session(self) -> Json:
        """Begin one, as the page does."""
        status, body, response = self.ask("GET", "/api/session")
        assert status == 200
        self.keep(body, response)
        return dict(body)

    def login(self, token: str) -> tuple[int, Any]:
        status, body, response = self.ask("POST", "/api/login", {"token": token})
        if status == 200:
            self.keep(body, response)
        return status, body

    def keep(self, body: Json, response: http.client.HTTPResponse) -> None:
        cookie = response.headers.get("Set-Cookie")
        if cookie:
            self.cookie = cookie.partition(";")[0]
        self.csrf = body["csrf"] or ""


class Live:
    """Reads server-sent events in a thread; `state` is what a page would show."""

    def __init__(self, client: Client, path: str = "/api/live") -> None:
        self._connection = client.connect()
        headers = {"Cookie": client.cookie} if client.cookie else {}
        headers |= {"Authorization": f"Bearer {client.token}"} if client.token else {}
        self._connection.request("GET", path, headers=headers)
        self.response = self._connection.getresponse()
        assert self.response.status == 200, self.response.read()
        self.messages: list[tuple[str, Json]] = []
        self.state: Json = {}
        self.ended = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        kind = ""
        with contextlib.suppress(OSError, ValueError, AttributeError, http.client.HTTPException):
            for line in self.response:
                name, _, value = line.decode("ascii").strip().partition(": ")
                if name == "event":
                    kind = value
                elif name == "data":
                    self._take(kind, json.loads(value))
        self.ended = True

    def _take(self, kind: str, body: Json) -> None:
        if kind == "full":
            self.state = body
        elif kind == "delta":
            self.state["ground"].update(body.get("ground", {}))
            for name, row in body.get("agents", {}).items():
                if row is None:
                    self.state["agents"].pop(name, None)
                else:
                    self.state["agents"].setdefault(name, {}).update(row)
        self.messages.append((kind, body))

    def of(self, kind: str) -> list[Json]:
        return [body for found, body in list(self.messages) if found == kind]

    def events(self) -> list[Json]:
        return [event for body in self.of("events") for event in body["events"]]

    def agent(self, name: str) -> Json:
        return dict(self.state.get("agents", {}).get(name, {}))

    def close(self) -> None:
        if self._connection.sock is not None:
            with contextlib.suppress(OSError):
                self._connection.sock.shutdown(socket.SHUT_RDWR)
        self._thread.join(LIMIT_S)
        self._connection.close()


class Ground:
    """A station with its page."""

    def __init__(self, options: ListenOptions | None = None, **page: Any) -> None:
        self.port = free_port(socket.SOCK_DGRAM)
        settings = MavlinkSettings.model_validate(
            {"endpoints": [{"url": f"udpin:127.0.0.1:{self.port}", "budget": 0}], "component_id": COMPONENT}
        )
        self.clock = SystemClock()
        self.station = GroundStation(settings, 254, self.clock)
        self.page = GroundPage(self.station, options or ListenOptions(port=0), self.clock, **page)
        self._vehicles: list[Vehicle] = []
        self._lives: list[Live] = []
        self.page.start()
        self.station.start()
        until(lambda: self.station.snapshot()[1].body["links"], "the link")
        until(self._serves, "the page")

    def _serves(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(self.page.address, LIMIT_S):
            return True
        return False

    def vehicle(self, number: int = 7, component: int = 193) -> Vehicle:
        self._vehicles.append(Vehicle(number, self.port, component))
        return self._vehicles[-1]

    def client(self) -> Client:
        return Client(self.page.address)

    def live(self, client: Client | None = None, path: str = "/api/live") -> Live:
        self._lives.append(Live(client or self.client(), path))
        return self._lives[-1]

    def close(self) -> None:
        for live in self._lives:
            live.close()
        for vehicle in self._vehicles:
            vehicle.close()
        self.station.close()
        self.page.close()


@contextlib.contextmanager
def ground(options: ListenOptions | None = None, **page: Any) -> Iterator[Ground]:
    made = Ground(options, **page)
    try:
        yield made
    finally:
        made.close()
