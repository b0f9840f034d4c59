"""One GET request over a connection that its deadline interrupts."""

from __future__ import annotations

import http.client
import socket
import ssl
from urllib.parse import urlsplit

from phm.facts import HttpFact
from phm.probes.connector import Connector, NotConnected, TimedCall, demand_not_ours

BODY_BYTES = 64 << 10
"""More of a body is not read."""
_HEADERS = {"User-Agent": "phm", "Accept": "*/*", "Connection": "close"}


def get(connector: Connector, url: str, *, timeout_s: float, verify_tls: bool) -> HttpFact:
    """See `phm.facts.SocketProbe.get`; the pattern is not searched here."""
    parts = urlsplit(url)
    host, secure = parts.hostname or "", parts.scheme == "https"
    port = parts.port or (443 if secure else 80)
    target = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    with connector.calling(timeout_s) as call:
        try:
            connection = connector.open(host, port, call)
            with _tls(connection, host, call, verify=verify_tls) if secure else connection as stream:
                return _request(stream, (host, port, target), call)
        except NotConnected as error:
            return HttpFact(str(error), call.took_s)
        except ssl.SSLCertVerificationError as error:
            return HttpFact(f"its certificate is not valid: {error.verify_message}", call.took_s)
        except (OSError, http.client.HTTPException, ValueError) as error:
            if isinstance(error, OSError):
                demand_not_ours(error, host)
            if call.pending.expired or isinstance(error, TimeoutError):
                return HttpFact(f"no answer within {timeout_s:g} s", call.took_s)
            return HttpFact(f"no valid answer: {str(error) or type(error).__name__}", call.took_s)


def _tls(connection: socket.socket, host: str, call: TimedCall, *, verify: bool) -> socket.socket:
    context = ssl.create_default_context()
    if not verify:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    stream = context.wrap_socket(connection, server_hostname=host, do_handshake_on_connect=False)
    call.pending.attach(stream)
    try:
        stream.settimeout(call.left_s)
        stream.do_handshake()
    except BaseException:
        stream.close()
        raise
    return stream


def _request(stream: socket.socket, place: tuple[str, int, str], call: TimedCall) -> HttpFact:
    host, port, target = place
    client = http.client.HTTPConnection(host, port)
    client.sock = stream
    stream.settimeout(call.left_s)
    client.request("GET", target, headers=_HEADERS)
    response = client.getresponse()
    try:
        body = response.read(BODY_BYTES)
    except http.client.IncompleteRead as error:
        body = error.partial
    if call.pending.expired:
        raise TimeoutError
    text = body.decode("utf-8", "replace")
    return HttpFact("", call.took_s, response.status, response.headers.get("Location") or "", text)
