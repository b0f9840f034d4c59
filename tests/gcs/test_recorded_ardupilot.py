"""Contract with a real ArduPilot: what `phm gcs` makes of the frames that its ground port sent in a recorded session."""

from __future__ import annotations

from collections import Counter

import pytest

from phm.gcs import frames as gcs_frames
from phm.simulation.mavlink_port import messages, parser
from tests.fakes.recorded_flight import frames
from tests.gcs.bench import Ground, events


def replayed() -> Ground:
    """The entire session: a hang from 66 to 78, a reboot from 116 to 123."""
    ground, decoder, at_s = Ground(), parser(), 0.0
    for next_s, raw in frames("hang_reboot_ground.tlog.gz"):
        ground.wait(max(0.0, next_s - at_s))
        at_s = max(at_s, next_s)
        for message in messages(decoder, raw):
            frame = gcs_frames.parse(message)
            if frame is not None:
                ground.receive(frame)
    return ground


def test_lines_that_arrive_in_a_burst_and_twice_count_once() -> None:
    """After the hang all lines of 12 s arrive within 20 ms; the fault again 0.3 s later, in the full state for the ground."""
    texts = [text for text in events(replayed().news, "text") if text["component"] == 193]
    failed = [text["repeat"] for text in texts if text["text"] == "A01 FAIL 10 autopilot: no heartbeat 4 s"]
    assert failed == [False, True]
    new = Counter(text["text"] for text in texts if not text["repeat"])
    assert new["A01 FAIL 10 autopilot: no heartbeat 4 s"] == 1
    assert new["A01 FAIL 1 GCS: no heartbeat 6 s"] == 1


def test_a_burst_of_heartbeats_is_not_a_period() -> None:
    """The agent is lost during the hang of 12 s, not during the reboot of 7 s, and its period stays that of its heartbeats."""
    ground = replayed()
    lost = [event["presence"] for event in events(ground.news, "presence")]
    assert lost == ["lost", "alive"]
    assert ground.agent(1)["period_s"] == pytest.approx(2.0, abs=0.1)
    assert ground.agent(1)["restarts"] == 0
