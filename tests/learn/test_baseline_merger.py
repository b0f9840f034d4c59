"""Writing a baseline into a configuration: comments, order and variables of the file stay."""

from __future__ import annotations

import re
from typing import Any

from ruamel.yaml import YAML

from phm.config.loader import loads
from phm.learn.baseline import Baseline, Learned
from phm.learn.baseline_merger import merge, unified_diff
from tests.docs.story import ROOT

TOPIC = {"name": "/a/scan", "type": "std_msgs/msg/String", "rate": 10, "publishers": ["/a/lidar"]}
FILE = """\
# My agent.
agent: {name: "${PHM_AGENT:-a}", id: 3}   # the third

containers:
- name: ros_app   # ours
  # The network of the swarm.
  networks:
  - net
  # The rest is by hand.
  recover: true

# What runs.
ros:
  nodes:
  - name: /${PHM_AGENT:-a}/lidar
  # Topics with data.
  topics:
  - name: /a/scan
    rate: 10Hz  # by the data sheet
    publishers: [/a/lidar]
# The end.
"""
SHIPPED = (ROOT / "config" / "phm.yaml").read_text()


def baseline(**fields: Any) -> Baseline:
    """fields: of the only topic."""
    topic = Learned({**TOPIC, **fields})
    return Baseline(nodes=(Learned({"name": "/a/lidar"}),), topics=(topic,), seen=frozenset({"a/lidar", "a/scan"}))


def changes(old: str, new: str) -> list[str]:
    lines = list(unified_diff(old, new, "phm.yaml"))[2:]
    return [line for line in lines if line[:1] in "+-"]


def test_an_empty_file_becomes_a_valid_configuration() -> None:
    """It has what was learned, and defaults else."""
    settings = loads(merge("", baseline(), {}), environ={})
    assert (settings.ros.topics[0].rate, settings.ros.topics[0].publishers) == (10.0, ["/a/lidar"])


def test_nothing_new_changes_nothing_but_what_was_not_configured() -> None:
    """A type is added; all else stays, to the byte."""
    assert changes(FILE, merge(FILE, baseline(), {})) == ["+    type: std_msgs/msg/String"]


def test_a_second_time_changes_nothing() -> None:
    """Merging the same result again leaves the file unchanged."""
    one = Learned({"name": "/b/new", "rate": 7}, {"rate": "varied by 4 %"})
    more = Baseline(topics=(Learned(TOPIC), one), notes=("a note",), seen=frozenset({"a/scan", "b/new", "a/lidar"}))
    for text in (FILE, "", SHIPPED):
        once = merge(text, more, {})
        assert merge(once, more, {}) == once


def test_a_changed_rate_is_replaced_and_its_comment_stays() -> None:
    """In its line, at its place."""
    new = merge(FILE, baseline(rate=5, tolerance=20), {})
    assert re.search(r"\n    rate: 5 +# by the data sheet\n", new)
    assert loads(new, environ={}).ros.topics[0].tolerance == 20


def test_a_mapping_in_braces_gets_separate_lines_for_a_comment() -> None:
    """Without a comment it stays in braces, and so do others."""
    text = "agent: {name: a, id: 1}\nmavlink:\n  endpoints: [{url: udpin:0.0.0.0:1}]   # radio\n"
    new = merge(text, Baseline(agent=Learned({"id": 7}, {"id": "was 1"}), mavlink=Learned({"autopilot": True})), {})
    assert new == (
        "agent:\n  name: a\n  id: 7 # learned: was 1\nmavlink:\n  endpoints: [{url: udpin:0.0.0.0:1}]   # radio\n  autopilot: true\n"
    )


READY = Learned({"name": "/a/lidar", "ready": {"lifecycle": "active"}}, {"ready": "was active"})


def test_a_lifecycle_state_is_added_and_the_rest_of_its_key_stays() -> None:
    """In one line where there was none; comments stay where they are."""
    learned = Baseline(nodes=(READY,), seen=frozenset({"a/lidar", "a/scan"}))
    new = merge(FILE, learned, {})
    assert changes(FILE, new) == ["+    ready: {lifecycle: active} # learned: was active"]
    assert merge(new, learned, {}) == new
    assert loads(new, environ={}).ros.nodes[0].ready.lifecycle == "active"
    given = FILE.replace("lidar\n", "lidar\n    ready:  # ours\n      within: 20s\n", 1)
    nodes = loads(merge(given, learned, {}), environ={}).ros.nodes
    assert (nodes[0].ready.within, nodes[0].ready.lifecycle) == (20.0, "active")
    assert "# ours" in merge(given, learned, {})


def test_names_with_variables_are_recognised() -> None:
    """The node is known, so it is neither added nor replaced."""
    assert merge(FILE, baseline(), {"PHM_AGENT": "a"}).count("lidar") == FILE.count("lidar")


def test_an_entry_that_was_not_seen_is_kept_and_marked() -> None:
    """PHM does not remove what a user configured; new entries follow."""
    new = merge(FILE, Baseline(nodes=(Learned({"name": "/a/other"}),), seen=frozenset({"a/other"})), {})
    assert "  - name: /${PHM_AGENT:-a}/lidar # learned: not seen while watching\n  - name: /a/other\n" in new


def test_entries_are_marked_also_if_no_node_was_seen() -> None:
    """As after an update to another ROS_DOMAIN_ID. Without a watch of the graph, nothing is known about them."""
    ours = (Learned({"name": "ros_app"}),)
    new = merge(FILE, Baseline(containers=ours), {})
    assert "lidar # learned: not seen while watching\n" in new
    assert "  - name: /a/scan # learned: not seen while watching\n" in new
    assert merge(FILE, Baseline(containers=ours, ros_watched=False), {}) == FILE
    assert "nodes" not in merge("ros: {silence: 3s}\n", Baseline(containers=ours), {})


def test_comments_that_follow_stay_where_they_are() -> None:
    """An entry that is added comes before the comment about what follows."""
    ours = Learned({"name": "ros_app", "networks": ["net", "other"]})
    new = merge(FILE, Baseline(containers=(ours, Learned({"name": "second"}, {"name": "it was restarted"}))), {})
    assert "  - net\n  - other\n  # The rest is by hand.\n  recover: true\n" in new
    assert "- name: second # learned: it was restarted\n\n# What runs.\nros:\n" in new


def test_the_shipped_configuration_keeps_every_comment() -> None:
    """Also where entries are added in many sections."""
    more = Baseline(
        containers=(Learned({"name": "x", "healthcheck": "required", "networks": ["n"]}, key="ros_app"),),
        nodes=(Learned({"name": "/a/lidar"}),),
        topics=(Learned({"name": "/agent_1/topic_1", "rate": 20}), Learned(TOPIC)),
        mavlink=Learned({"autopilot": True}),
    )
    new = merge(SHIPPED, more, {})
    assert [line for line in changes(SHIPPED, new) if line.startswith("-") and "#" in line] == []
    assert loads(new, environ={}).containers[0].healthcheck == "required"


def test_hostile_names_stay_text() -> None:
    """The name of a network or a container cannot become additional YAML, a variable or another line."""
    name = 'a: {b}\n# ${HOME} "x"'
    new = merge("", Baseline(containers=(Learned({"name": "app", "networks": [name]}, {"name": f"was {name}"}),)), {})
    tree = YAML(typ="safe").load(new)
    assert tree == {"containers": [{"name": "app", "networks": [name.replace("${", "$${")]}]}
