"""The folder of faults: complete, named like its files, each expected at a unit that the demonstration monitors."""

from __future__ import annotations

import inspect
import itertools
from pathlib import Path
from unittest import mock

import pytest

from phm.config import load
from phm.recovery.ladders import LADDERS
from phm_checks.container import WITHOUT_ENGINE_S
from sitl import faults
from sitl.acceptance import main, plan
from sitl.demo.main import STORY
from sitl.faults import engine_restarted
from sitl.faults.base import LAYERS, Agent, Fault
from sitl.harness.compose_stack import ROOT
from sitl.harness.config_overrides import overridden, write

FILES = sorted(path.stem for path in Path(faults.__file__).parent.glob("[!_]*.py") if path.stem != "base")


def test_every_file_is_one_fault() -> None:
    """Each file defines exactly one fault, with the name of the file."""
    assert sorted(faults.all_faults()) == FILES


@pytest.mark.parametrize("name", FILES)
def test_a_fault_is_fully_defined(name: str) -> None:
    """A fault has a title, a unit, an injection and its own clearing."""
    fault = faults.all_faults()[name]
    assert fault.name == name
    assert fault.title.strip() == fault.title != ""
    assert fault.places(agent())
    assert fault.layer in LAYERS
    assert len(fault.cause.split()) > 3
    assert fault.cause[-1] != "."
    assert fault.needs <= {"air", "peers", "configuration", "alone", "starvation"}
    assert fault.level in ("ERROR", "WARN")
    assert inspect.getdoc(type(fault))
    assert type(fault).clear is not Fault.clear


UNOBSERVED = {"clock_stepped"}
"""What has stepped is only what PHM reads, and that is seen by PHM alone."""


@pytest.mark.parametrize(
    "name",
    [
        name
        for name, fault in faults.all_faults().items()
        if fault.layer in ("container", "companion") and name not in UNOBSERVED
    ],
)
def test_a_fault_states_its_evidence_and_observes_the_world(name: str) -> None:
    """When it could be known at the earliest, by which event; and a way to see its end without PHM."""
    fault = faults.all_faults()[name]
    assert fault.evidence
    assert fault.evidence_s is not None
    assert fault.evidence_s >= 0
    assert type(fault).restored is not Fault.restored


def test_titles_of_faults_differ() -> None:
    """No two rows of a table have the same title."""
    titles = [fault.title for fault in faults.all_faults().values()]
    assert len(set(titles)) == len(titles)


def agent() -> Agent:
    """An agent without a Docker Engine."""
    return Agent("phm-test", "agent_1", docker=mock.Mock())


def test_the_demonstration_and_the_proof_use_existing_faults() -> None:
    """The proof injects once every fault that neither starves nor belongs to the campaign; the demonstration some of
    them.
    """
    assert sorted((*plan.ORDER, *plan.APART, *plan.CAMPAIGN, *plan.STARVING)) == FILES
    assert set(plan.STARVING) == {name for name, fault in faults.all_faults().items() if "starvation" in fault.needs}
    assert set(STORY) <= set(FILES)
    assert set(plan.LEFT_ALONE) <= set(FILES)


def test_only_faults_that_need_a_configuration_are_injected_separately() -> None:
    """A fault that needs a separate configuration is not detectable among the others, and states so."""
    needing = [name for name, fault in faults.all_faults().items() if fault.configuration(agent())]
    assert [name for name in needing if name not in plan.CAMPAIGN] == list(plan.APART)
    assert needing == [name for name, fault in faults.all_faults().items() if "configuration" in fault.needs]


LINKS = "played with real sockets by tests/transport/test_reopen.py: no container is touched"
ENDS = "played by the campaign, docs/development/sitl_faults.md has the figures"
NOT_COVERED = {
    "disk_full": ENDS,
    "publisher_lost": ENDS,
    "subscriber_lost": ENDS,
    "qos_mismatch": ENDS,
    "node_duplicate": ENDS,
    "transport_blocked": ENDS,
    "cpu_starved": "needs recovery.relieve; played with the real engine's calls by tests/recovery/containers/test_cpu_weights.py",
    "data_frozen": ENDS,
    "data_stamp": ENDS,
    "data_gaps": ENDS,
    "data_range": "advised, not acted on; played with real publishers by tests/ros/test_data.py",
    "not_ready": "played with real nodes by tests/ros/test_readiness.py",
    "quorum_dead": "played with real beacons by tests/ros/test_beacon_consensus.py",
    "publisher_not_received": "played with real beacons by tests/ros/test_beacon_consensus.py",
    "custom_failed": "a check that the user writes; played by tests/recovery/test_custom_recovery_real.py",
    "link_silent": LINKS,
    "radio_silent": LINKS,
    "autopilot_silent": LINKS,
}


def test_every_ladder_is_covered_by_the_proof() -> None:
    """Each condition with a ladder in PHM has a fault, or a reason why not (docs/reference/recovery.md states it, too)."""
    known = faults.all_faults()
    covered = {known[name].condition for name in (*plan.ORDER, *plan.APART)}
    assert set(LADDERS) - covered == set(NOT_COVERED)


def test_consecutive_faults_of_the_proof_affect_different_units() -> None:
    """The same unit twice in a row could be mistaken for one recurring fault."""
    known = faults.all_faults()
    units = [{known[name].unit, *known[name].also} for name in plan.ORDER]
    assert all(not one & two for one, two in itertools.pairwise(units))


def test_the_programme_can_be_restricted() -> None:
    """By fault and by mode; the rest keeps its order, and no other fault is injected."""
    all_plays = list(plan.plays())
    assert [play.mode for play in all_plays if not play.first] == ["act", "act", "off", "advise"]
    assert list(plan.plays(["container_stopped"], ["advise"])) == [plan.Play("advise", ("container_stopped",))]
    assert [play.faults for play in plan.plays(["node_killed"], ["act"])] == [("node_killed",), ("node_killed",)]
    assert [play.apart for play in plan.plays(["netns_owner_killed"])] == [True]


@pytest.mark.parametrize("mode", plan.MODES)
def test_the_proof_has_a_valid_configuration(mode: str) -> None:
    """The configuration derived from the shipped file is valid, in every mode and with relaunch."""
    for relaunch in (False, True):
        settings = load(write(plan.configuration(mode, relaunch=relaunch)))
        assert settings.recovery.mode == mode
        assert settings.recovery.budget > len(plan.ORDER)
        assert settings.containers[0].files[0].restore == "image"
        assert bool(settings.ros.nodes[0].relaunch) is relaunch


@pytest.mark.parametrize(
    "name", [name for name, fault in faults.all_faults().items() if "configuration" in fault.needs]
)
def test_a_faults_changes_to_the_configuration_are_valid(name: str) -> None:
    """With its changes the configuration is valid and differs from the one without."""
    more = faults.all_faults()[name].configuration(agent())
    assert load(write(plan.configuration(more=more))) != load(write(plan.configuration()))


def test_lasting_is_longer_than_the_shipped_verify() -> None:
    """The proof waits long enough even when the shipped value changes."""
    assert load(write(plan.configuration())).recovery.verify < main.LASTING_S


def test_a_change_of_a_missing_line_is_rejected() -> None:
    """A line that the shipped configuration no longer has is an error, not a change without effect."""
    with pytest.raises(ValueError, match="0 times, expected once"):
        overridden({"\n  budget: 6": "\n  budget: 7"})


def test_the_critical_file_is_the_one_of_the_image() -> None:
    """The content that the proof expects is the content that docker/Dockerfile writes."""
    from sitl.faults.file_deleted import CONTENT, CRITICAL

    written = CONTENT.decode().replace("\n", "\\n")
    dockerfile = (Path(faults.__file__).parents[2] / "docker" / "Dockerfile").read_text("utf-8")
    assert f"printf '{written}' >{CRITICAL}" in dockerfile


def test_the_document_has_every_fault_with_its_unit_and_condition() -> None:
    """docs/development/sitl_faults.md names each fault once, in the table of its layer, with its expected condition."""
    text = (ROOT / "docs" / "development" / "sitl_faults.md").read_text("utf-8")
    tables = {part.partition("\n")[0].lower(): part for part in text.split("\n## ")[1:5]}
    for name, fault in faults.all_faults().items():
        (row,) = [line for line in tables[fault.layer].splitlines() if line.startswith(f"| `{name}`")]
        if not fault.also:
            assert f"`{fault.condition}`" in row
            assert f"`{fault.unit.replace('{agent}', '...')}`" in row


def test_an_outage_of_the_engine_is_longer_than_what_phm_waits_without_it() -> None:
    """By more than PHM needs to report a container's end from its cgroup; as long as that, no outage would show this path."""
    assert engine_restarted.AWAY_S >= WITHOUT_ENGINE_S + 5.0
