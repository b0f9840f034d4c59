"""The swarm without containers: options, node graph, PHM's configuration of each agent, an agent's health, lock,
commands.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from phm.config import loads
from sitl.application import graph
from sitl.swarm import config, cost, engine, startup, workspace
from sitl.swarm.cli import main
from sitl.swarm.health import MACHINE, Health
from sitl.swarm.options import Options
from sitl.swarm.swarm import Swarm
from tests.fakes.until import until


def settings(options: Options, number: int) -> Any:
    """PHM's own parsing of the generated configuration."""
    environ = {
        "PHM_AGENT": f"agent_{number}",
        "PHM_AGENT_ID": str(number),
        "PHM_APP": "app",
        "PHM_NETWORK": "net",
        "PHM_DEVICE": "/dev/null",
    }
    return loads(config.text(options, number), environ=environ)


# ---------------------------------------------------------------- configuration


def test_phm_accepts_the_configuration_of_each_agent() -> None:
    """Without a problem, with its own names, and with all others as its swarm."""
    for number in (1, 8):
        found = settings(Options(agents=8), number)
        assert found.agent.name == f"agent_{number}"
        assert found.agent.id == number
        assert list(found.swarm.agents) == list(range(1, 9))
        assert [node.name for node in found.ros.nodes] == [f"/agent_{number}/node_{node}" for node in (1, 2, 3)]


def test_the_ground_and_the_peers_have_separate_endpoints() -> None:
    """One endpoint to the router, behind which a radio and an autopilot are required; one to the other agents."""
    router, peers = settings(Options(agents=4), 3).mavlink.endpoints
    assert (router.leads_to, router.radio, router.container) == ("router", "required", "router")
    assert (peers.leads_to, peers.to_ground, peers.to_autopilot) == ("peers", False, False)
    assert router.url.endswith(":5603")
    assert peers.url.endswith(":14603")


def test_the_router_is_a_container_that_phm_may_start() -> None:
    """Beside the application, which stays the first; each agent has its own."""
    _, router = settings(Options(agents=4, name="flock"), 3).containers
    assert (router.name, router.key, router.recover, router.flight_critical) == (
        "flock-3-router-1",
        "router",
        True,
        False,
    )


def test_each_agent_has_its_own_ports() -> None:
    """Agents share neither router nor radio."""
    urls = [endpoint["url"] for number in range(1, 25) for endpoint in config.endpoints(Options(agents=24), number)]
    assert len(set(urls)) == len(urls)


def test_lines_of_the_shipped_configuration_can_be_changed() -> None:
    """For a fault that needs it, in addition to the common changes of the swarm."""
    options = Options(changes={"  patience: 10s": "  patience: 7s"})
    assert yaml.safe_load(config.text(options, 1))["recovery"]["patience"] == "7s"
    more = {"  backoff: 1s": "  backoff: 3s"}
    assert yaml.safe_load(config.text(options, 1, more))["recovery"]["backoff"] == "3s"
    with pytest.raises(ValueError, match="0 times"):
        config.text(options, 1, {"no such line": ""})


def test_a_fault_can_add_a_topic() -> None:
    """In addition to those of the swarm's graph."""
    line = '\n      subscribers: ["/${PHM_AGENT:-agent_1}/node_1"]'
    more = {line: f"{line}\n    - {{name: /agent_1/reading, container: ros_app}}"}
    names = [topic["name"] for topic in yaml.safe_load(config.text(Options(nodes=2), 1, more))["ros"]["topics"]]
    assert names == ["/agent_1/topic_1", "/agent_1/topic_2", "/agent_1/reading"]


def test_the_recovery_mode_applies_to_the_swarm() -> None:
    """`--mode off` lets a campaign prove that nothing changes without recovery."""
    assert settings(Options(mode="off"), 1).recovery.mode == "off"


# ---------------------------------------------------------------- node graph


def test_a_ring_is_closed() -> None:
    """Every topic has one publisher and one subscriber."""
    plans = graph.ring(4, 10)
    assert sorted(topic for plan in plans for topic in plan.publish) == sorted(
        topic for plan in plans for topic in plan.subscribe
    )


def test_phm_monitors_a_custom_graph(tmp_path: Path) -> None:
    """Nodes, topics, rates, publishers and subscribers; a topic may have no subscribers."""
    file = tmp_path / "graph.yaml"
    file.write_text(
        "nodes:\n- {name: camera, publish: {image: 5}}\n- {name: planner, publish: {path: 1}, subscribe: [image]}\n"
    )
    found = settings(Options(graph=str(file)), 2)
    assert [node.name for node in found.ros.nodes] == ["/agent_2/camera", "/agent_2/planner"]
    image, path = found.ros.topics
    assert (image.name, image.rate, image.subscribers) == ("/agent_2/image", 5.0, ["/agent_2/planner"])
    assert (path.publishers, path.subscribers) == (["/agent_2/planner"], [])


def test_a_graph_is_passed_on_unchanged() -> None:
    """The application's container gets JSON of the same graph."""
    plans = graph.ring(3, 2.5)
    assert graph.read(json.loads(json.dumps([plan.as_words() for plan in plans]))) == plans


@pytest.mark.parametrize(
    ("found", "said"),
    [
        ({}, "a list of 1 to 64 nodes"),
        ([{"name": "a", "publish": {"t": 1}, "rate": 3}], "allowed are the keys"),
        ([{"name": "a b", "publish": {"t": 1}}], "'a b' is not a name"),
        ([{"name": "a/b", "publish": {"t": 1}}], "has a '/'"),
        ([{"name": "a"}], "publishes nothing"),
        ([{"name": "a", "publish": {"t": 0}}], "0.1 to 1000 Hz"),
        ([{"name": "a", "publish": ["t"]}], "a map of topics"),
        ([{"name": "a", "publish": {"t": 1}}] * 2, "found twice: a"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_invalid_graph_is_rejected(found: Any, said: str) -> None:
    """The message has the entry, the problem, and what is allowed."""
    with pytest.raises(ValueError, match=said):
        graph.read(found)


# ---------------------------------------------------------------- health of an agent


def events(*found: dict[str, Any]) -> list[dict[str, Any]]:
    return [{"utc_s": 100.0 + number, **event} for number, event in enumerate(found)]


REPORT = {"event": "report", "status_array": [1] * 8}


def unit(name: str, level: str, event: str = "transition") -> dict[str, Any]:
    return {"event": event, "unit": name, "level": level}


def test_an_agent_is_healthy_after_a_report_with_every_unit_ok() -> None:
    """A unit that was STALE in the report and became OK since counts as OK; an open fault does not."""
    standing = Health()
    standing.feed(events(unit("nodes/a", "STALE", "unit"), REPORT))
    assert not standing.healthy
    assert standing.why == "nodes/a STALE"
    standing.feed(events(unit("nodes/a", "OK")))
    assert standing.healthy
    standing.feed(events({"event": "fault_opened", "fault": "x-1", "unit": "files/a"}))
    assert standing.why == "open fault at files/a"
    standing.feed(events({"event": "fault_closed", "fault": "x-1", "unit": "files/a"}))
    assert standing.healthy


def test_a_restart_of_phm_resets_the_health() -> None:
    """Results of the previous run prove nothing; open faults stay open until PHM closes them."""
    standing = Health()
    standing.feed(events(unit("files/a", "OK", "unit"), REPORT, {"event": "start"}))
    assert standing.why == "no report of PHM yet"


def test_an_outdated_record_is_not_healthy() -> None:
    """A dead PHM leaves a record in which everything was OK."""
    standing = Health()
    standing.feed(events(REPORT))
    assert standing.why_not(110.0, 35.0) == ""
    assert standing.why_not(140.0, 35.0) == "PHM has written nothing for 40 s"


def test_host_units_can_be_excluded() -> None:
    """On request, units of the machine are ignored."""
    loaded = events(REPORT, unit("host/cpu", "ERROR"), {"event": "fault_opened", "fault": "x-1", "unit": "host/cpu"})
    everything, agent = Health(), Health(but=(MACHINE,))
    everything.feed(loaded)
    agent.feed(loaded)
    assert not everything.healthy
    assert agent.healthy


# ---------------------------------------------------------------- workspace, options, commands


@pytest.fixture(autouse=True)
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PHM_SITL_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("name", ["", "A", "a_b", "-a", "../x", "a" * 41, "x-air"])
def test_an_invalid_swarm_name_is_rejected(name: str) -> None:
    """One that Compose would not accept, that leaves the folder, or that another swarm's emulator uses."""
    with pytest.raises(ValueError, match="is not a name for a swarm"):
        workspace.folder(name)


def test_a_swarm_is_locked_for_one_command_at_a_time(base: Path) -> None:
    """A second command gets an error that names the first; swarms with other names are not locked."""
    with workspace.locked("one", 0.0):
        with pytest.raises(RuntimeError, match="another command works on this swarm"), workspace.locked("one", 0.0):
            pass
        with workspace.locked("two", 0.0):
            pass
    with workspace.locked("one", 0.0):
        pass


def test_a_child_keeps_the_lock_of_a_killed_parent(base: Path) -> None:
    """So `down` does not begin while a Compose process of a killed `up` is still creating containers."""
    code = (
        "import subprocess, sys, os, time\n"
        "from sitl.swarm import workspace\n"
        "with workspace.locked('one', 0.0) as lock:\n"
        "    child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'], pass_fds=[lock])\n"
        "    print(child.pid, flush=True)\n"
        "    time.sleep(600)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()

    def free() -> bool:
        try:
            with workspace.locked("one", 0.0):
                return True
        except RuntimeError:
            return False

    assert not free()
    subprocess.run(["kill", "-KILL", str(child)], check=True)
    until(free, "the lock to be free")


@pytest.mark.parametrize("agents", [0, 25])
def test_too_many_agents_are_rejected(agents: int) -> None:
    """Before anything is created."""
    with pytest.raises(ValueError, match="allowed are 1 to 24"):
        Swarm(Options(agents=agents))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (Options(agents=3, name="one"), "has 2 agents, not 3"),
        (Options(agents=2, name="one", profile="shipped"), "was not started for the profile shipped"),
        (Options(agents=2, name="one", changes={"a": "b"}), "was not started for the profile tuned"),
    ],
)
def test_a_running_swarm_is_used_only_for_what_it_was_started_for(base: Path, options: Options, said: str) -> None:
    """Of the same size, profile and configuration; else the error says how to take it down."""
    running = Swarm(Options(agents=2, name="one"), ground_url="tcp:127.0.0.1:1")
    running.folder.mkdir(parents=True)
    running.save()
    with pytest.raises(LookupError, match=f"{said}: take it down .`python -m sitl down --name one`"):
        startup.running_or_started(options, print)
    found, started = startup.running_or_started(Options(agents=2, name="one"), print)
    assert (found.ground_url, started) == (running.ground_url, False)


@pytest.mark.parametrize(("clean", "left"), [(True, False), (False, True)])
def test_a_start_that_fails_is_removed_if_it_was_made_for_a_command(
    base: Path, monkeypatch: pytest.MonkeyPatch, clean: bool, left: bool
) -> None:
    """Not after `sitl up`, where the user looks at it; never what another command has started."""
    swarm, removed = Swarm(Options(agents=1, name="one", build=False)), []
    monkeypatch.setattr(Swarm, "docker", None)
    monkeypatch.setattr(engine, "resources", lambda docker, name: [])
    monkeypatch.setattr(engine, "remove", lambda docker, name: removed.append(name))
    monkeypatch.setattr(startup, "_air", lambda swarm, lock: (_ for _ in ()).throw(RuntimeError("did not start")))
    with pytest.raises(RuntimeError, match="did not start"):
        startup.up(swarm, print, clean=clean)
    assert (removed == ["one"], (swarm.folder / "swarm.json").exists()) == (clean, left)
    monkeypatch.setattr(engine, "resources", lambda docker, name: ["one-1"])
    with pytest.raises(RuntimeError, match="already exists"):
        startup.up(swarm, print, clean=True)
    assert len(removed) == clean


@pytest.mark.parametrize(
    "words", [["status"], ["inject", "node_killed"], ["clear"], ["logs"]], ids=lambda words: words[0]
)
def test_a_missing_swarm_is_reported_with_the_next_step(
    words: Sequence[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1, and what to do."""
    assert main([*words, "--name", "unused"]) == 1
    assert "python -m sitl up --name unused" in capsys.readouterr().err


def test_faults_are_listed_without_a_swarm(capsys: pytest.CaptureFixture[str]) -> None:
    """By layer and name."""
    assert main(["inject"]) == 0
    assert "ros        node_killed" in capsys.readouterr().out


# ---------------------------------------------------------------- cost


@pytest.mark.parametrize("idle", ["total_inactive_file", "inactive_file"])
def test_cost_is_computed_from_two_samples_of_the_engine(idle: str) -> None:
    """CPU time divided by the time between the samples, and memory without what the kernel could reclaim."""

    def stats(used_s: float) -> dict[str, Any]:
        memory = {"usage": 90e6, "stats": {idle: 20e6}}
        return {"cpu_stats": {"cpu_usage": {"total_usage": used_s * 1e9}}, "memory_stats": memory}

    found = cost.between("a", "phm", (100.0, stats(7.0)), (110.0, stats(7.5)))
    assert (found.cpu_percent, found.cpu_s, found.memory_mb) == (pytest.approx(5.0), 7.5, 70.0)
