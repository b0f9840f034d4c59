"""The last messages of an endpoint that is closed."""

from __future__ import annotations

import socket

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import MavlinkSettings
from phm.transport.dialect import mavlink
from phm.transport.mavlink import MavlinkHub
from tests.fakes.mavlink import heartbeat
from tests.fakes.until import until

WORD = 0x40025D55


@pytest.mark.parametrize(("state", "times"), [(mavlink.MAV_STATE_POWEROFF, 3), (mavlink.MAV_STATE_ACTIVE, 1)])
def test_an_announced_shutdown_is_repeated(monkeypatch: pytest.MonkeyPatch, state: int, times: int) -> None:
    """Each time as a frame with its own number, so that a lost one does not look like the loss of the agent."""
    # On a busy machine the usual time may pass before the last one.
    monkeypatch.setattr("phm.transport.mavlink_endpoint.FAREWELL_S", 60.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        url = f"udpout:127.0.0.1:{ground.getsockname()[1]}"
        hub = MavlinkHub(MavlinkSettings.model_validate({"endpoints": [{"url": url}]}), 7, SystemClock())
        hub.start()
        until(hub.links, "the endpoint opening")
        message = heartbeat(WORD)
        message.system_status = state
        hub.send(message)
        hub.close()
        until(lambda: hub._endpoints[0].join(0.0), "the end of its thread")
        ground.setblocking(False)
        frames = [ground.recv(300) for _ in range(times)]
        with pytest.raises(BlockingIOError):
            ground.recv(300)
    assert [(frame[4], frame[17]) for frame in frames] == [(number, state) for number in range(times)]
