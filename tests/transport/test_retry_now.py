"""The container at the other end of a link: its end is reported at its cause, and its start opens the link immediately."""

from __future__ import annotations

import socket

import pytest

from phm.testing import FakeClock, settings
from phm.transport.mavlink import MavlinkHub
from phm_checks.link import Link
from tests.fakes.mavlink import free_port
from tests.fakes.until import until


@pytest.mark.parametrize("container", ["router", "other"])
def test_a_link_is_tried_at_once_when_its_container_was_started(container: str) -> None:
    """Not when another one was. The clock does not move here, so the back-off alone would never be over."""
    port, clock = free_port(), FakeClock()
    made = settings(
        containers=[{"name": "router"}, {"name": "other"}],
        mavlink={"endpoints": [{"url": f"tcp:127.0.0.1:{port}", "name": "router", "container": "router"}]},
    )
    hub = MavlinkHub(made.mavlink, 7, clock)
    hub.start()
    try:
        until(lambda: bool(hub.links()), "the first attempt")
        clock.wait_for_sleepers(1)
        with socket.create_server(("127.0.0.1", port)) as door:
            hub.retry_now(container)
            door.settimeout(5.0 if container == "router" else 0.3)
            if container == "router":
                door.accept()[0].close()
            else:
                with pytest.raises(TimeoutError):
                    door.accept()
    finally:
        hub.close()


def test_a_link_needs_the_container_at_its_other_end() -> None:
    """What follows from its death is not reported a second time."""
    made = settings(
        containers=[{"name": "mavlink-router", "alias": "router"}],
        mavlink={
            "endpoints": [
                {"url": "tcp:router:5760", "name": "one", "container": "router"},
                {"url": "tcp:pilot:5760", "name": "two"},
            ]
        },
    )
    needs = [check.units[0].needs for check in Link.build(made)]
    assert needs == [("container/router",), ()]
