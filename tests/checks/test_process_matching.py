"""Which process belongs to which node."""

from __future__ import annotations

import pytest

from phm.api import ProcessFact
from phm_checks._process_matching import Wanted, match

NODE = Wanted("/agent_1/node_1")


def ps(*commands: str, parents: dict[int, int] | None = None) -> list[ProcessFact]:
    """Processes 1, 2, ... with these command lines."""
    return [ProcessFact(pid, (parents or {}).get(pid, 0), "S", 0.0, words) for pid, words in enumerate(commands, 1)]


def found(node: Wanted, processes: list[ProcessFact]) -> int:
    """The pid of one node, 0 for none or several."""
    matches, _ = match([node], processes, {})
    return matches[node.name].process.pid if node.name in matches else 0


@pytest.mark.parametrize(
    "command",
    [
        "/ws/install/pkg/lib/pkg/driver --ros-args -r __node:=node_1 -r __ns:=/agent_1",
        "/ws/install/pkg/lib/pkg/driver --ros-args --remap __node:=node_1",
        "python -m sitl.application.node --name node_1 --namespace /agent_1 --publish topic_1:10",
        "python -m sitl.application.node --name=node_1",
        "/ws/install/pkg/lib/pkg/node_1 --ros-args -r __ns:=/agent_1",
        "/usr/bin/python3 /ws/install/pkg/lib/pkg/node_1",
        "python3 /ws/node_1.py",
        "node_1",
    ],
)
def test_a_node_is_recognized_by_its_command_line(command: str) -> None:
    """By a remapped name, an option, or the name of the program."""
    assert found(NODE, ps("/bin/init", command, "sleep 1")) == 2


@pytest.mark.parametrize(
    "command",
    [
        "",
        "/ws/lib/pkg/node_10",
        "/ws/lib/pkg/my_node_1",
        "/ws/lib/pkg/node_1-helper",
        "python3 /opt/ros/jazzy/bin/ros2 launch pkg node_1.launch.py",
        "/usr/bin/launcher node_1.launch.py",
        "/usr/bin/python3 /opt/ros/jazzy/bin/ros2 bag record /agent_1/node_1/out",
        "/ws/lib/pkg/driver --ros-args -r __node:=node_1 -r __ns:=/agent_2",
        "python -m sitl.application.node --name node_1 --namespace /agent_2",
        "/ws/lib/pkg/node_1 --ros-args -r __node:=another",
    ],
)
def test_other_processes_do_not_match(command: str) -> None:
    """Part of a word, a launch file, a ROS tool, another namespace, another name."""
    assert found(NODE, ps("/bin/init", command)) == 0


def test_a_node_in_the_root_namespace_matches_no_process_with_a_namespace() -> None:
    """The namespace belongs to another node."""
    assert found(Wanted("/node_1"), ps("x --name node_1 --namespace /agent_1")) == 0
    assert found(Wanted("/node_1"), ps("x --name node_1")) == 1


def test_two_equal_processes_match_no_node() -> None:
    """An ambiguous match is not returned; the count is."""
    processes = ps("x --name node_1", "x --name node_1")
    assert match([NODE], processes, {}) == ({}, {NODE.name: 2})


def forked(age_s: float | None, command: str = "python3 /ws/node_1.py") -> list[ProcessFact]:
    """A node, and a process that it forked so long ago."""
    node = ProcessFact(7, 1, "S", 0.0, "python3 /ws/node_1.py", 100.0)
    return [node, ProcessFact(8, 7, "S", 0.0, command, age_s)]


@pytest.mark.parametrize("age_s", [2.0, 99.0, None])
def test_a_worker_that_a_node_forked_is_not_the_node(age_s: float | None) -> None:
    """It has the node's command line, and its end is not the node's."""
    assert found(NODE, forked(age_s)) == 7


def test_a_process_between_fork_and_exec_leaves_the_match_open() -> None:
    """It is the node's if a launcher with the same words forked it, and not if the node did."""
    assert found(NODE, forked(0.0)) == 0
    assert match([NODE], forked(1.0), {})[1] == {NODE.name: 2}
    assert found(NODE, forked(0.0, "sleep 1")) == 7


def test_the_most_specific_match_wins() -> None:
    """A remapped name is more reliable than a word."""
    assert found(NODE, ps("cat /tmp/log/node_1", "x --ros-args -r __node:=node_1")) == 2


def test_a_match_with_namespace_is_preferred() -> None:
    """Of several matches, the one with the namespace of the node."""
    assert found(NODE, ps("x --name node_1", "x --name node_1 --namespace /agent_1")) == 2


def test_the_program_that_starts_a_node_is_not_the_node() -> None:
    """An init, a shell and `ros2 run` have the node's arguments, too: the innermost matches, the others are remembered."""
    words = "run pkg driver --ros-args -r __node:=node_1"
    processes = ps(
        f"/sbin/docker-init -- sh -c ros2 {words}",
        f"sh -c ros2 {words}",
        f"python3 /opt/bin/ros2 {words}",
        "/lib/pkg/driver --ros-args -r __node:=node_1",
        parents={2: 1, 3: 2, 4: 3},
    )
    matches, _ = match([NODE], processes, {})
    assert matches[NODE.name].process.pid == 4
    assert matches[NODE.name].wrappers == {1, 2, 3}


def test_the_parent_of_a_terminated_node_is_not_the_node() -> None:
    """A shell that restarts the node in a loop outlives it."""
    processes = ps("sh -c while true; do driver --name node_1; done")
    assert match([NODE], processes, {NODE.name: {1}})[0] == {}


def test_a_cycle_of_parents_is_harmless() -> None:
    """Process lists are external input."""
    assert found(NODE, ps("x --name node_1", "sh", parents={1: 2, 2: 1})) == 0
    assert found(NODE, ps("x --name node_1", "sh", parents={1: 2, 2: 2})) == 1


def test_one_process_for_two_nodes_matches_none_without_configuration() -> None:
    """Of two nodes with one short name one is dead; the process is the other's. Composed nodes share one."""
    nodes = [Wanted("/a/node_1"), Wanted("/b/node_1")]
    processes = ps("/lib/pkg/node_1")
    assert match(nodes, processes, {}) == ({}, {"/a/node_1": 1, "/b/node_1": 1})
    shared = [Wanted(name, process=("pkg",)) for name in ("/a/one", "/a/two")]
    assert {one.process.pid for one in match(shared, processes, {})[0].values()} == {1}


def test_all_configured_words_must_occur() -> None:
    """Substrings are enough, and nothing else is tried."""
    processes = ps("component_container --ros-args -r __node:=nav", "component_container -r __node:=vision", "node_1")
    assert found(Wanted("/agent_1/node_1", process=("component_", "__node:=nav")), processes) == 1
    assert found(Wanted("/agent_1/node_1", process=("component_",)), processes) == 0
    assert found(Wanted("/agent_1/node_1", process=("no such",)), processes) == 0


GRAPH = 'python -m sitl.application.app --graph [{"name": "node_1"}, {"name": "node_2"}]'


def test_a_launcher_with_names_of_its_nodes_is_not_a_node() -> None:
    """One node was never started; the process that started the other has both names in its arguments."""
    nodes = [NODE, Wanted("/agent_1/node_2")]
    processes = ps(f"/sbin/docker-init -- {GRAPH}", GRAPH, "x --name node_2", parents={2: 1, 3: 2})
    matches, counts = match(nodes, processes, {})
    assert {name: one.process.pid for name, one in matches.items()} == {"/agent_1/node_2": 3}
    assert counts == {NODE.name: 0}


def test_a_node_that_starts_another_is_a_node() -> None:
    """It does not name the other: its own name identifies it, as usual."""
    nodes = [NODE, Wanted("/agent_1/camera")]
    matches, _ = match(nodes, ps("python3 node_1.py", "python3 camera.py", parents={2: 1}), {})
    assert {name: one.process.pid for name, one in matches.items()} == {NODE.name: 1, "/agent_1/camera": 2}


def test_a_launcher_is_remembered_with_a_weaker_match() -> None:
    """The node matched by an option, its launcher only by a word; both are remembered together."""
    matches, _ = match([NODE], ps(GRAPH, "x --name node_1", parents={2: 1}), {})
    assert (matches[NODE.name].process.pid, matches[NODE.name].wrappers, matches[NODE.name].way) == (2, {1}, 1)
    assert match([NODE], ps(GRAPH), {NODE.name: {1}}) == ({}, {NODE.name: 0})


def test_a_weaker_match_than_before_is_not_the_node() -> None:
    """After a container restart all pids differ, but the node is known to have an option."""
    assert found(NODE, ps(GRAPH)) == 1
    assert match([NODE], ps(GRAPH), {}, {NODE.name: 1}) == ({}, {NODE.name: 0})
