"""The operator's end of `phm deliver`: sends a configuration to an agent and reads its answer (`phm.wire.delivery`)."""

from __future__ import annotations

import contextlib
import socket
import time

from phm.wire import delivery as wire
from phm.wire.delivery import DeliveryAnswer, NotADelivery, version_of

CONNECT_S = 10.0
ANSWER_S = 90.0
"""A reload may take 30 s, and one that failed is followed by another one."""


class DeliveryFailed(Exception):
    """Whether the configuration was applied is unknown, or it was not sent; the message says which, and why."""


def deliver(
    where: tuple[str, int], key: bytes, text: str, base: str, limit_s: float = ANSWER_S
) -> tuple[str, DeliveryAnswer]:
    """The agent's name, and its answer. base: version of the configuration that is replaced. Raises DeliveryFailed."""
    if not text.strip() or len(text.encode("utf-8", "surrogatepass")) > wire.MAX_SIZE:
        raise DeliveryFailed(f"not sent: a configuration has 1 to {wire.MAX_SIZE} bytes")
    return _send(where, key, text, base, limit_s)


def present(where: tuple[str, int], key: bytes) -> str:
    """Version of the agent's configuration. Raises DeliveryFailed, also when the agent refuses."""
    _, answer = _send(where, key, "", version_of(""), CONNECT_S)
    if not answer.ok or not answer.present:
        raise DeliveryFailed(f"{where[0]}:{where[1]}: {answer.text}")
    return answer.present


def _send(where: tuple[str, int], key: bytes, text: str, base: str, limit_s: float) -> tuple[str, DeliveryAnswer]:
    place, sent = f"{where[0]}:{where[1]}", False
    try:
        with socket.create_connection(where, CONNECT_S) as stream:
            said = wire.read_hello(_line(stream, wire.MAX_LINE, CONNECT_S))
            request, data = wire.request(said, base, text, key)
            stream.settimeout(CONNECT_S)
            sent = True
            with contextlib.suppress(
                ConnectionError
            ):  # refused before all of it was read: the reason can still be read
                stream.sendall(data)
            return said.agent, wire.read_answer(_line(stream, wire.MAX_ANSWER, limit_s), request, key)
    except NotADelivery as error:
        raise DeliveryFailed(f"{place}: {_unknown(str(error), sent)}") from None
    except (OSError, UnicodeError) as error:
        why = (
            "it does not answer in time"
            if isinstance(error, TimeoutError)
            else getattr(error, "strerror", "") or str(error)
        )
        raise DeliveryFailed(f"{place}: {_unknown(why, sent)}") from None


def _unknown(why: str, sent: bool) -> str:
    return f"{why}; it is not known whether the configuration was applied: see the agent's log" if sent else why


def _line(stream: socket.socket, most: int, limit_s: float) -> bytes:
    """Up to a newline, and all within `limit_s`. Raises NotADelivery and OSError."""
    end, data = time.monotonic() + limit_s, b""
    while b"\n" not in data:
        left = end - time.monotonic()
        if left <= 0:
            raise TimeoutError
        stream.settimeout(left)
        chunk = stream.recv(65_536)
        if not chunk:
            raise NotADelivery("the connection was closed")
        data += chunk
        if len(data) > most:
            raise NotADelivery("it is not PHM's port for configurations (`delivery.listen`)")
    return data.partition(b"\n")[0]
