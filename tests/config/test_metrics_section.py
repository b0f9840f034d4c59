"""The section `metrics`."""

from __future__ import annotations

import pytest

from phm.config import ConfigError, loads
from phm.core.settings.metrics import is_loopback


@pytest.mark.parametrize(
    ("listen", "address", "local"),
    [
        ("127.0.0.1:9464", ("127.0.0.1", 9464), True),
        ("localhost:9464", ("localhost", 9464), True),
        ("'[::1]:9464'", ("::1", 9464), True),
        ("0.0.0.0:9464", ("0.0.0.0", 9464), False),
        ("drone-5.local:1", ("drone-5.local", 1), False),
    ],
)
def test_the_address_is_written_out(listen: str, address: tuple[str, int], local: bool) -> None:
    """Host and port, so that no other address than loopback is opened by an omission."""
    found = loads(f"metrics:\n  listen: {listen}\n", "phm.yaml", environ={}).metrics
    assert (found.address, is_loopback(found.address[0])) == (address, local)


def test_metrics_are_off_by_default() -> None:
    """Nothing listens unless it is configured."""
    assert loads("{}\n", "phm.yaml", environ={}).metrics.listen is None


@pytest.mark.parametrize(
    "line", ["':9464'", "9464", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:65536", "http://127.0.0.1:1"]
)
def test_mistakes_are_named(line: str) -> None:
    """With the place and an example."""
    with pytest.raises(ConfigError) as caught:
        loads(f"metrics:\n  listen: {line}\n", "phm.yaml", environ={})
    assert str(caught.value).startswith("phm.yaml:2: metrics.listen: ")
