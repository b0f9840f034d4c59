"""The moment of a fault is never later than the fault, and its signals reach no other process."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from sitl.faults import (
    container_killed,
    container_stopped,
    crash_loop,
    memory_leak,
    netns_owner_killed,
    network_recreated,
    overload_container_killed,
    phm_killed_in_restart,
    phm_state_noise,
    pids_exhausted,
    power_loss,
)
from sitl.faults._processes import held, kill
from sitl.faults.base import Agent


class Clock:
    """A clock that only goes on when it is read or waited for. `waits`: what happens during each wait."""

    def __init__(self, *waits: Any) -> None:
        self.now = 0.0
        self.waits = list(waits)

    def monotonic(self) -> float:
        self.now += 1.0
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += 1.0
        if self.waits:
            self.waits.pop(0)()


@pytest.fixture
def process() -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(["sleep", "60"]) as made:
        yield made
        end(made)


def end(process: subprocess.Popen[bytes]) -> None:
    with held([process.pid]) as found:
        for each in found:
            kill(each)


def test_a_recreated_network_was_gone_with_its_first_disconnection(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine takes seconds for the rest."""
    clock, gone = Clock(), []
    network = mock.Mock(attrs={**dict.fromkeys(("Driver", "Options", "Labels", "Internal")), "Name": "n"})
    network.attrs["Containers"] = {"abc": {}}
    network.disconnect.side_effect = lambda *_, **__: gone.append(clock.monotonic())
    monkeypatch.setattr(network_recreated, "time", clock)
    monkeypatch.setattr(network_recreated, "first_network", lambda agent: "n")
    client = mock.Mock()
    client.networks.get.return_value = network
    agent = mock.Mock(docker=client)
    assert network_recreated.Injection().inject(agent) < gone[0]
    agent.sidecar.unpause.assert_called_once_with()


def test_a_leaking_node_was_killed_after_it_was_last_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not when its end was found."""
    file, killed = tmp_path / "tmp/nodes/node_1.pid", []
    file.parent.mkdir(parents=True)
    file.write_text("17", "ascii")

    def end() -> None:
        killed.append(clock.now)
        file.unlink()

    clock = Clock(lambda: None, end)
    monkeypatch.setattr(memory_leak, "time", clock)
    monkeypatch.setattr(memory_leak, "root", lambda agent: tmp_path)
    moment = memory_leak._killed(mock.Mock())
    assert 1.0 < moment < killed[0], "after the first look, in which it ran"


def test_a_limit_of_processes_was_reached_after_the_last_look_below_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not when it was found to be reached."""
    file, full = tmp_path / "pids.current", []
    file.write_text("4", "ascii")

    def fill() -> None:
        full.append(clock.now)
        file.write_text(str(4 + pids_exhausted.ROOM), "ascii")

    clock = Clock(lambda: None, fill)
    monkeypatch.setattr(pids_exhausted, "time", clock)
    monkeypatch.setattr(pids_exhausted, "cgroup", lambda container, controller: tmp_path)
    for name in ("update", "start"):
        monkeypatch.setattr(pids_exhausted, name, mock.Mock())
    moment = pids_exhausted.Injection().inject(mock.MagicMock())
    assert 2.0 < moment < full[0]


def test_a_descriptor_reaches_its_process_alone(process: subprocess.Popen[bytes]) -> None:
    """A process that has ended has none, or is left alone: its id may belong to another one by then."""
    ended = subprocess.Popen(["true"])
    ended.wait()
    with held([ended.pid, process.pid]) as found:
        assert len(found) == 1
        kill(found[0])
        assert process.wait() == -9
        kill(found[0])
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(found[0])


@pytest.fixture
def no_ids(monkeypatch: pytest.MonkeyPatch) -> None:
    """A signal to a process id is an error."""
    monkeypatch.setattr(os, "kill", mock.Mock(side_effect=AssertionError("by its id")))


@pytest.mark.usefixtures("no_ids")
def test_a_loss_of_power_ends_the_processes_that_were_collected(process: subprocess.Popen[bytes]) -> None:
    """One that ends meanwhile is left alone."""
    ended = subprocess.Popen(["true"])
    ended.wait()
    container = mock.Mock(attrs={"State": {"Running": False}})
    container.top.return_value = {"Processes": [[str(process.pid)], [str(ended.pid)]]}
    agent = mock.Mock(spec=Agent, sidecar=container, app=container, router=container)
    power_loss.Injection().inject(agent)
    assert process.wait() == -9
    container.start.assert_called_once_with()


@pytest.mark.usefixtures("no_ids")
def test_phm_is_killed_when_the_application_has_ended(
    process: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """That may take PHM some time; until then the ids of both processes may have been given away."""
    monkeypatch.setattr(phm_killed_in_restart, "daemon", lambda agent: process.pid)
    with subprocess.Popen(["sleep", "60"]) as app:
        agent = mock.Mock(app=mock.Mock(attrs={"State": {"Pid": app.pid}}))
        agent.signal_node.side_effect = lambda *_: end(app)
        phm_killed_in_restart.Injection().inject(agent)
        assert process.wait() == -9


@pytest.mark.usefixtures("no_ids")
def test_phm_is_not_killed_when_it_does_not_restart_the_application(
    process: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then the injection fails, and PHM goes on."""
    monkeypatch.setattr(phm_killed_in_restart, "daemon", lambda agent: process.pid)
    monkeypatch.setattr(phm_killed_in_restart, "ASKED_LIMIT_S", 0.01)
    agent = mock.Mock(app=mock.Mock(attrs={"State": {"Pid": os.getpid()}}))
    with pytest.raises(TimeoutError, match="has not restarted"):
        phm_killed_in_restart.Injection().inject(agent)
    assert process.poll() is None


@pytest.mark.usefixtures("no_ids")
def test_phm_is_killed_after_its_state_was_filled_with_noise(
    process: subprocess.Popen[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where there was no state yet."""
    monkeypatch.setattr(phm_state_noise, "daemon", lambda agent: process.pid)
    monkeypatch.setattr(phm_state_noise, "behind", lambda container, folder: tmp_path)
    phm_state_noise.Injection().inject(mock.Mock())
    assert process.wait() == -9
    assert (tmp_path / phm_state_noise.NAME).stat().st_size == phm_state_noise.LEAST


@pytest.mark.parametrize(
    "fault",
    [container_killed, container_stopped, crash_loop, netns_owner_killed, overload_container_killed],
    ids=lambda module: module.__name__.rpartition(".")[2],
)
def test_a_container_is_killed_at_the_order(fault: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine stamps its end a moment after the processes are gone."""
    app = mock.Mock(attrs={"State": {"FinishedAt": "2026-11-27T10:00:00Z"}})
    ordered = []

    def end(*_: Any, **__: Any) -> None:
        ordered.append(time.monotonic())
        app.attrs = {"State": {"FinishedAt": "2999-01-01T00:00:00Z"}}

    app.kill.side_effect = app.exec_run.side_effect = end
    agent = mock.Mock(app=app)
    if fault is overload_container_killed:
        monkeypatch.setattr(fault, "overload", lambda _: None)
        monkeypatch.setattr(fault, "BEFORE_S", 0.0)
    assert fault.Injection().inject(agent) <= ordered[0]
