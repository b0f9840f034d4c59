"""The section `notify`."""

from __future__ import annotations

import pytest

from phm.config import ConfigError, loads


def test_a_password_comes_from_the_environment() -> None:
    """As in the reference, so that none is in the file."""
    text = "notify:\n  urls:\n    - mqtt://user:${MQTT_PASSWORD}@broker/fleet\n  command: [page-me, --team, drones]\n"
    found = loads(text, "phm.yaml", environ={"MQTT_PASSWORD": "s3cret"}).notify
    assert found.urls == ["mqtt://user:s3cret@broker/fleet"]
    assert (found.command, found.per_minute) == (["page-me", "--team", "drones"], 10)


@pytest.mark.parametrize(
    ("line", "key"),
    [
        ("urls: [hooks.example.org]", "notify.urls[0]"),
        ("command: page-me --team drones", "notify.command"),
        ("events: [opened]", "notify.events[0]"),
        ("per_minute: 0", "notify.per_minute"),
    ],
)
def test_mistakes_are_named(line: str, key: str) -> None:
    """A command is a list of words, because no shell splits it."""
    with pytest.raises(ConfigError) as caught:
        loads(f"notify:\n  {line}\n", "phm.yaml", environ={})
    assert str(caught.value).startswith(f"phm.yaml:2: {key}: ")
