"""Whether an application was observed not to work when PHM raised an alarm about it. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.campaign.trial import Alarm, Broken

CHECKS = ("consensus", "nodes", "rates", "topics")
"""What they report, the observation of the application sees, too: its nodes run and receive their topics at their rates."""
LASTS_S = 5.0
"""The application must not have worked for so long before the alarm."""


def confirmed(alarm: Alarm, broken: Sequence[Broken]) -> bool:
    """Whether the application of the alarm's agent did not work for LASTS_S before the alarm, and still did not."""
    return alarm.unit.partition("/")[0] in CHECKS and any(
        each.agent == alarm.agent and each.began <= alarm.mono - LASTS_S and alarm.mono <= each.ended for each in broken
    )
