"""The section `notify`: alerts to other services."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import Section

NotifyUrl = Annotated[str, Field(min_length=4, max_length=1000, pattern=r"^[A-Za-z0-9]+://.+")]
NotifyEvent = Literal["open", "escalate", "close"]


class NotifySettings(Section):
    """Alerts by webhook, MQTT, other services, and a command."""

    urls: Annotated[list[NotifyUrl], Field(max_length=8)] = Field(default_factory=list)
    """Where alerts are sent, as URLs of Apprise: json://HOST/PATH (webhook), mqtt://HOST/TOPIC, and others. Needs the extra `notify`."""
    command: Annotated[list[Annotated[str, Field(min_length=1, max_length=4096)]], Field(max_length=64)] = Field(
        default_factory=list
    )
    """Program and arguments, started for each alert, which it gets as JSON on its standard input. No shell is used."""
    events: list[NotifyEvent] = Field(default=["open", "escalate", "close"])
    """Which are sent: a fault opens, PHM gives up on it, it ends."""
    per_minute: Annotated[int, Field(ge=1, le=600)] = 10
    """This many alerts immediately, then as many a minute; the next one says how many were left out."""
