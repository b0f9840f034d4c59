"""The messages of real publishers, examined in the real child process."""

from __future__ import annotations

import subprocess

import pytest

from phm.facts import DataFact, RosFact
from phm.probes.ros.supervisor import RosSupervisor
from tests.fakes.ros_bench import Bench, seen

TOPIC = "/agent_1/odom"
DATA = {
    "max_age": 5.0,
    "order": True,
    "frozen": 1.0,
    "counter": "point.z",
    "ranges": {"point.y": [-1, 1]},
    "sample": 4,
}


def examined(fact: RosFact) -> DataFact:
    return fact.topics[TOPIC].data or DataFact()


def make(source: subprocess.Popen[bytes], behaviour: str) -> None:
    assert source.stdin is not None
    source.stdin.write(f"{behaviour}\n".encode())
    source.stdin.flush()


def reported(probe: RosSupervisor, *conditions: str) -> DataFact:
    """Wait until these conditions are all that there are."""
    fact = seen(
        probe,
        lambda fact: examined(fact).samples > 1 and set(examined(fact).conditions) == set(conditions) and fact,
        f"{conditions or 'no'} conditions",
    )
    return examined(fact)


def test_each_condition_of_a_real_publisher_is_reported_and_ends(bench: Bench) -> None:
    """Each alone, while rate and all others are as configured."""
    source = bench.script("ros_stamped.py", "source", "20")
    probe = bench.probe([{"name": TOPIC, "rate": 20, "data": DATA}])
    fact = reported(probe)
    assert fact.problem == ""
    seen(
        probe,
        lambda fact: (age_s := examined(fact).age_s) is not None and abs(age_s) < 5.0,
        "a message that came in time",
    )
    make(source, "ahead")
    fact = reported(probe, "data_stamp")
    assert fact.age_s is not None and abs(fact.age_s + 3600) < 60.0
    make(source, "ahead frozen")
    assert reported(probe, "data_stamp", "data_frozen").frozen_s >= 1.0
    make(source, "lossy outside")
    # The stamps went back by an hour when they became right again.
    fact = seen(
        probe, lambda fact: {"data_gaps", "data_range"} <= {*examined(fact).conditions} and examined(fact), "both"
    )
    assert [(outside.field, outside.value) for outside in fact.outside] == [("point.y", "nan")]
    make(source, "healthy")
    reported(probe)
    make(source, "back")
    reported(probe, "data_order")


@pytest.mark.one_distribution
def test_of_two_publishers_the_frozen_one_is_found(bench: Bench) -> None:
    """Their messages alternate, so that no two in a row are equal; their counters are independent."""
    sources = [bench.script("ros_stamped.py", name, "10") for name in ("left", "right")]
    probe = bench.probe([{"name": TOPIC, "rate": 20, "data": {**DATA, "max_age": None}}])
    assert reported(probe).problem == ""
    make(sources[0], "frozen")
    assert reported(probe, "data_frozen").problem == ""
