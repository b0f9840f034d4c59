"""Observation of the applications of all agents."""

from __future__ import annotations

import threading
import time
from pathlib import Path

from docker import DockerClient

from sitl.campaign.application_alarms import LASTS_S
from sitl.campaign.application_watcher import ApplicationWatcher
from sitl.campaign.trial import Broken, append, load
from sitl.faults.base import Agent
from tests.fakes.campaign_trials import trial
from tests.fakes.until import until


def test_observations_become_spans_of_each_agent() -> None:
    """From the first that it does not work to the next that it works; what is not over yet ends with the last observation."""
    watcher = ApplicationWatcher({})
    for mono, works in enumerate([True, False, False, True, True, False, False]):
        watcher.add(1, float(mono), works=works)
        watcher.add(2, float(mono), works=True)
    assert watcher.broken() == [Broken(1, 1.0, 3.0), Broken(1, 5.0, 6.0)]


def test_a_trial_begins_with_what_may_matter_for_it() -> None:
    """Spans that are over for long are dropped, one that goes on is not."""
    watcher, now = ApplicationWatcher({}), time.monotonic()
    for agent, over in ((1, now - LASTS_S - 1), (2, now)):
        watcher.add(agent, over - 100, works=False)
        watcher.add(agent, over, works=True)
    watcher.add(3, now - 100, works=False)
    watcher.begin()
    assert {each.agent for each in watcher.broken()} == {2, 3}


def test_an_application_that_cannot_be_observed_does_not_work() -> None:
    """Without an engine nothing is known of it. The thread goes on, and ends at `stop`."""

    def connect() -> DockerClient:
        return DockerClient("tcp://127.0.0.1:1", version="1.41")

    watcher = ApplicationWatcher({4: Agent("none", "agent_4", connect())}, connect)
    watcher.start()
    watcher.start()
    until(
        lambda: len({each.ended for each in watcher.broken()} - {each.began for each in watcher.broken()}) > 0,
        "two looks",
    )
    watcher.stop()
    watcher.stop()
    assert not any(thread.name == "applications" for thread in threading.enumerate())


def test_a_record_without_it_can_be_read(tmp_path: Path) -> None:
    """Published records are older."""
    file, made = tmp_path / "new.jsonl", trial(broken=[Broken(1, 1.0, 2.0)])
    append(file, made)
    assert load(file) == [made]
    old = tmp_path / "old.jsonl"
    old.write_text(
        file.read_text("ascii").replace('"broken": [{"agent": 1, "began": 1.0, "ended": 2.0}], ', ""), "ascii"
    )
    assert [each.broken for each in load(old)] == [[]]
