"""A busy machine may stop either end of a request for longer than PHM's limits for it, which are not the subject of most tests."""

from __future__ import annotations

import pytest

from phm.commands import control_clients, delivery_server
from phm.gcs import delivery_client
from phm.wire import control

LIMIT_S = 60.0


def lengthen_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long limits at both ends of the control socket, and of the port for configurations."""
    monkeypatch.setattr(control_clients, "DEADLINE_S", LIMIT_S)
    monkeypatch.setattr(control, "DEADLINE_S", LIMIT_S)
    for name in ("REQUEST_S", "BODY_S", "ANSWER_S"):
        monkeypatch.setattr(delivery_server, name, LIMIT_S)
    monkeypatch.setattr(delivery_client, "CONNECT_S", LIMIT_S)
