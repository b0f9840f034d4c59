"""The metrics of the ground: a real page server with 100 agents that send real frames, and a real Prometheus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics

from phm.core.model import Level, Slot
from phm.gcs import metrics_catalog
from phm.gcs.events import GcsEvent
from phm.gcs.frames import POWEROFF
from phm.gcs.metrics import MAX_GAPS, GroundMetrics
from phm.gcs.web.routes import metrics as routes
from phm.testing import FakeClock
from phm.wire.metrics_page import MetricsPage
from phm.wire.openmetrics import MetricsText
from phm.wire.tunnel import SwarmDigest
from tests.fakes.until import until
from tests.gcs.bench import HEALTHY, Ground as Fleet, autopilot, phm_heartbeat, tunnel_frame
from tests.gcs.web.swarm import Ground, ground
from tests.metrics.ground import Station, ground_text
from tests.metrics.prometheus import Prometheus, promtool


@pytest.fixture
def here() -> Iterator[Ground]:
    with ground() as made:
        yield made


def test_every_metric_of_the_ground() -> None:
    """Of a lost agent there is its age, and no level; of one that was never received for how long it is missing."""
    families = {family.name: family for family in parse_openmetrics(ground_text().decode())}  # type: ignore[no-untyped-call]
    for metric in metrics_catalog.ALL:
        assert metric.name.removesuffix("_total") in families, metric.name
    values = {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in families.values()
        for sample in family.samples
    }
    assert values["phm_gcs_agent_present", (("agent", "A05"),)] == 0
    assert values["phm_gcs_agent_age_seconds", (("agent", "A05"),)] == 60
    assert values["phm_gcs_agent_gaps_total", (("agent", "A05"), ("presence", "lost"))] == 1
    assert values["phm_gcs_agent_level", (("agent", "A06"),)] == 0
    assert values["phm_gcs_slot_level", (("agent", "A06"), ("slot", "container"))] == 0
    assert ("phm_gcs_slot_level", (("agent", "A05"), ("slot", "container"))) not in values
    assert values["phm_gcs_agent_present", (("agent", "A09"),)] == 0
    assert values["phm_gcs_agent_age_seconds", (("agent", "A09"),)] == 60
    assert values["phm_gcs_texts_total", (("severity", "critical"),)] == 1
    assert values["phm_gcs_answers_total", (("result", "denied"),)] == 1
    assert values["phm_gcs_commands_sent_total", ()] == 3


def test_counters_of_events_that_never_happened_are_0() -> None:
    """`increase()` is blind for a series that begins at 1; and a silent autopilot is neither armed nor disarmed."""
    fleet = Fleet()
    metrics = GroundMetrics(Station(fleet), FakeClock())
    fleet.receive(phm_heartbeat(5), autopilot(5, armed=True))

    def lines() -> list[str]:
        return MetricsText(metrics.page).render("text/plain")[0].decode().splitlines()

    found = lines()
    assert 'phm_gcs_agent_gaps_total{agent="A05",presence="lost"} 0.0' in found
    assert 'phm_gcs_agent_gaps_total{agent="A05",presence="late"} 0.0' in found
    assert 'phm_gcs_texts_total{severity="critical"} 0.0' in found
    assert 'phm_gcs_answers_total{result="denied"} 0.0' in found
    assert 'phm_gcs_autopilot_armed{agent="A05"} 1.0' in found
    fleet.wait(60.0)
    found = lines()
    assert not [line for line in found if line.startswith("phm_gcs_autopilot_armed{")]
    assert [line for line in found if line.startswith('phm_gcs_autopilot_age_seconds{agent="A05"}')]


def test_an_agent_that_left_has_no_age() -> None:
    """`PhmAgentLost` needs the age: an agent that was stopped on purpose is not lost. After a heartbeat it can be lost again."""
    fleet = Fleet()
    metrics = GroundMetrics(Station(fleet), FakeClock())

    def lines(*, age: bool) -> list[str]:
        names = "phm_gcs_agent_age_seconds{", "phm_gcs_agent_present{"
        found = MetricsText(metrics.page).render("text/plain")[0].decode().splitlines()
        return [line for line in found if line.startswith(names[not age])]

    fleet.receive(phm_heartbeat(5))
    assert lines(age=True) == ['phm_gcs_agent_age_seconds{agent="A05"} 0.0']
    fleet.receive(phm_heartbeat(5, state=POWEROFF))
    fleet.wait(60.0)
    assert not lines(age=True)
    assert lines(age=False) == ['phm_gcs_agent_present{agent="A05"} 0.0']
    fleet.receive(phm_heartbeat(5))
    assert lines(age=True) == ['phm_gcs_agent_age_seconds{agent="A05"} 0.0']


def test_an_expected_agent_that_never_comes_has_an_age() -> None:
    """So `PhmAgentLost` finds it, also after a restart of the ground; one that only the digest names is waited for since then."""
    fleet = Fleet(expected=(5,))
    metrics = GroundMetrics(Station(fleet), FakeClock())

    def ages() -> list[str]:
        found = MetricsText(metrics.page).render("text/plain")[0].decode().splitlines()
        return [line.split("seconds")[1] for line in found if line.startswith("phm_gcs_agent_age_seconds{")]

    fleet.wait(60.0)
    assert ages() == ['{agent="A05"} 60.0']
    fleet.receive(phm_heartbeat(6), tunnel_frame(6, SwarmDigest(3, 2, {6: Level.OK, 7: Level.WARN})))
    assert ages() == ['{agent="A05"} 60.0', '{agent="A06"} 0.0']
    fleet.wait(60.0)
    assert ages() == ['{agent="A05"} 120.0', '{agent="A06"} 60.0', '{agent="A07"} 60.0']
    fleet.receive(phm_heartbeat(5))
    assert ages()[0] == '{agent="A05"} 0.0'


def test_an_expected_agent_of_a_large_swarm_may_be_late_with_its_first_heartbeat() -> None:
    """With 128 agents each sends one in 40 s: an alert would be wrong for half of them."""
    fleet = Fleet(expected=range(1, 129))
    metrics = GroundMetrics(Station(fleet), FakeClock())
    fleet.wait(60.0)
    assert b"phm_gcs_agent_age_seconds{" not in MetricsText(metrics.page).render("text/plain")[0]
    fleet.wait(150.0)
    assert b'phm_gcs_agent_age_seconds{agent="A50"} 210.0' in MetricsText(metrics.page).render("text/plain")[0]


def test_pauses_of_the_heartbeats_are_counted() -> None:
    """A late agent is not an event: each of its pauses counts, also one that ends before the agent is lost."""
    fleet = Fleet()
    station = Station(fleet)
    metrics = GroundMetrics(station, FakeClock())
    for pause_s in (7.0, 7.0, 60.0):
        fleet.wait(20.0, phm_heartbeat(5), every=2.0)
        fleet.wait(pause_s)
    fleet.wait(20.0, phm_heartbeat(5), every=2.0)
    station.publish(*fleet.news)
    found = MetricsText(metrics.page).render("text/plain")[0].decode().splitlines()
    assert 'phm_gcs_agent_gaps_total{agent="A05",presence="late"} 3.0' in found
    assert 'phm_gcs_agent_gaps_total{agent="A05",presence="lost"} 1.0' in found


def test_invented_agents_cost_no_more_than_the_limit() -> None:
    """Any number of names may come and go; those that were lost last are counted, and there is room for the agents that are there."""
    fleet = Fleet()
    station = Station(fleet)
    metrics = GroundMetrics(station, FakeClock())
    fleet.receive(phm_heartbeat(5))
    lost = [
        GcsEvent(fleet.clock.stamp(), "presence", {"name": name, "presence": "lost"})
        for name in ("A07", *(f"A250/{number}" for number in range(MAX_GAPS - 1)), "A07", "A249", "A05")
    ]
    station.publish(*lost)
    text = MetricsText(metrics.page).render("text/plain")[0].decode()
    found = [line for line in text.splitlines() if line.startswith("phm_gcs_agent_gaps_total{")]
    assert len(found) == MAX_GAPS + 1
    for line in (
        'agent="A07",presence="lost"} 2.0',
        'agent="A05",presence="lost"} 1.0',
        'agent="A05",presence="late"} 0.0',
    ):
        assert f"phm_gcs_agent_gaps_total{{{line}" in found
    assert 'phm_gcs_agent_gaps_total{agent="A250/0",presence="lost"} 1.0' not in found


def test_promtool_accepts_the_page() -> None:
    """By the conventions of Prometheus, without a remark about one of ours."""
    fleet = Fleet(expected=(9,))
    text = MetricsText(GroundMetrics(Station(fleet), FakeClock()).page).render("text/plain")[0]
    said = promtool("check", "metrics", stdin=text)
    assert "phm_" not in said, said


def test_prometheus_scrapes_a_ground_with_100_agents(here: Ground, tmp_path: Path) -> None:
    """All of them, within the time of a scrape, and the errors that they report."""
    vehicles = [here.vehicle(number) for number in range(1, 101)]
    for vehicle in vehicles:
        vehicle.heartbeat({Slot.RATES: Level.ERROR} if vehicle.number == 42 else None)
    address = here.client().address
    server = Prometheus(tmp_path, {"ground": f"{address[0]}:{address[1]}"})

    def send() -> None:
        for vehicle in vehicles:
            vehicle.heartbeat({Slot.RATES: Level.ERROR} if vehicle.number == 42 else None)

    def seen() -> tuple[object, ...]:
        """Agents, errors and levels: they are there together after each scrape that is in time, while the agents are received."""
        errors = [(one["metric"]["agent"], one["metric"]["slot"]) for one in server.query("phm_gcs_slot_level == 2")]
        return server.value("count(phm_gcs_agent_present == 1)"), errors, server.value("count(phm_gcs_slot_level)")

    try:
        until(lambda: seen() == (100, [("A42", "rates")], 100 * len(HEALTHY)), "100 agents, one error", seen, step=send)
        until(lambda: not server.errors(), "a scrape without an error", server.errors)
    finally:
        server.close()


def test_a_failing_page_is_not_made_for_each_request(
    here: Ground, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its reason is in the log once, and not in the answer; then it is made again."""

    def broken(metrics: GroundMetrics) -> MetricsPage:
        raise ValueError("secret")

    client = here.client()
    with monkeypatch.context() as patched:
        patched.setattr(GroundMetrics, "page", broken)
        patched.setattr(routes, "AGAIN_S", 3600.0)
        for _ in range(5):
            status, body, _ = client.ask("GET", "/metrics")
            assert status == 500 and "secret" not in str(body)
        assert caplog.text.count("Traceback") == 1
    until(lambda: client.ask("GET", "/metrics")[0] == 200, "the page")


def test_the_page_needs_the_role_view(here: Ground) -> None:
    """As all that shows the swarm: a page of another origin does not get it."""
    client = here.client()
    assert client.ask("GET", "/metrics")[0] == 200
    assert client.ask("GET", "/metrics", headers={"Sec-Fetch-Site": "cross-site"})[0] == 403
    assert client.ask("GET", "/metrics", headers={"Host": "evil.example"})[0] == 403
