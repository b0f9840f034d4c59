"""The page of an agent: every metric with its value, and nothing from outside that breaks it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from prometheus_client.openmetrics.parser import text_string_to_metric_families as parse_openmetrics
from prometheus_client.parser import text_string_to_metric_families as parse_plain

from phm.core.model import NOT_OBSERVED, FaultClosed, Layer, Level, Outcome, Slot
from phm.reporters import metrics_catalog
from phm.reporters.metrics_counts import EventCounts
from phm.reporters.metrics_page import build_page
from phm.wire.metrics_page import LEFT_OUT, MAX_LABEL, MAX_SERIES, HistogramCounts, clean_label
from phm.wire.openmetrics import MetricsText, wants_openmetrics
from tests.metrics.agent import AT, FAULT, context, counts, state, text_of
from tests.metrics.prometheus import promtool

OPENMETRICS = "application/openmetrics-text;version=1.0.0,text/plain;version=0.0.4;q=0.5"
PLAIN = "text/plain"


def samples(accept: str = PLAIN, units: object = None) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """By name and labels."""
    text, _kind = text_of(context(units)).render(accept)  # type: ignore[arg-type]
    parse = parse_openmetrics if accept == OPENMETRICS else parse_plain
    found: dict[tuple[str, tuple[tuple[str, str], ...]], float] = {}
    for family in parse(text.decode()):
        for sample in family.samples:
            key = (sample.name, tuple(sorted(sample.labels.items())))
            assert key not in found, f"{key} is there twice"
            found[key] = sample.value
    return found


EXPECTED = [
    ("phm_slot_level", {"slot": "container"}, 2.0),
    ("phm_unit_level", {"slot": "host", "unit": "host/disk"}, 0.0),
    ("phm_faults_open", {"slot": "container"}, 1.0),
    ("phm_faults_open", {"slot": "host"}, 0.0),
    ("phm_alarms_total", {"slot": "container"}, 1.0),
    ("phm_faults_total", {"slot": "container", "outcome": "resolved"}, 1.0),
    ("phm_actions_total", {"slot": "container", "action": "restart", "outcome": "verified"}, 1.0),
    ("phm_recovery_duration_seconds_sum", {"slot": "container"}, 7.0),
    ("phm_recovery_duration_seconds_bucket", {"slot": "container", "le": "5.0"}, 0.0),
    ("phm_recovery_duration_seconds_bucket", {"slot": "container", "le": "10.0"}, 1.0),
    ("phm_detection_duration_seconds_bucket", {"slot": "container", "le": "0.5"}, 1.0),
    ("phm_heartbeat_age_seconds", {"source": "ground", "link": ""}, 1.5),
    ("phm_heartbeat_age_seconds", {"source": "autopilot", "link": "radio"}, 0.4),
    ("phm_radio_signal", {"link": "radio", "side": "remote"}, 170.0),
    ("phm_topic_rate_hertz", {"topic": "/agent_1/chatter"}, 9.8),
    ("phm_topic_expected_rate_hertz", {"topic": "/agent_1/chatter"}, 10.0),
    ("phm_host_disk_usage_ratio", {"path": "/"}, 0.96),
    ("phm_host_temperature_celsius", {}, 61.5),
    ("phm_container_waiting_ratio", {"container": "ros_app", "resource": "cpu"}, 0.2),
    ("phm_custom_value", {"unit": "custom/winch", "name": "load"}, 3.5),
    ("phm_link_sent_bytes_total", {"link": "radio"}, 1000.0),
    ("phm_event_queue_length", {"subscriber": "log"}, 2.0),
    ("phm_events_dropped_total", {"subscriber": "log"}, 1.0),
    ("phm_report_age_seconds", {}, 0.0),
]


@pytest.mark.parametrize("accept", [PLAIN, OPENMETRICS])
def test_values_are_those_of_the_daemon(accept: str) -> None:
    """In both formats, in base units."""
    found = samples(accept)
    for name, labels, value in EXPECTED:
        assert found[name, tuple(sorted(labels.items()))] == pytest.approx(value), name


def test_every_metric_of_the_catalogue_has_a_value_here() -> None:
    """So that these tests see all of them; `process_*` comes from the library."""
    names = {name for name, _labels in samples(OPENMETRICS)}
    for metric in (*metrics_catalog.ALL, LEFT_OUT):
        suffix = "_bucket" if metric.kind == "histogram" else ""
        assert f"{metric.name}{suffix}" in names, metric.name
    assert "process_cpu_seconds_total" in names


def test_the_content_type_is_the_format() -> None:
    """OpenMetrics only for a client that asks for it; versions and escapings that a client invents are not repeated to it."""
    text = text_of(context())
    assert text.render(OPENMETRICS)[1].startswith("application/openmetrics-text; version=1.0.0")
    assert text.render(OPENMETRICS)[0].endswith(b"# EOF\n")
    for accept in ("", "*/*", PLAIN, "text/plain;version=evil", ";;;,,=", "\xff" * 5000):
        assert text.render(accept)[1].startswith("text/plain; version=0.0.4")
    assert "evil" not in text.render("application/openmetrics-text; version=evil; escaping=evil")[1]


@pytest.mark.parametrize("accept", [PLAIN, OPENMETRICS])
def test_names_from_outside_do_not_break_the_page(accept: str) -> None:
    """Quotes, ends of lines, escapes, lone surrogates and names of any length stay one label."""
    names = [
        'a"} 1\nphm_alive 0',
        "back\\slash\\",
        "\x1b[31m",
        "\u202eabc",
        "\ud800",
        "x" * 5000,
        "ä" * 300,
        "x" * 5000 + "y",
    ]
    units = tuple(state(f"pressure/{name}", "pressure", Slot.CONTAINER, Layer.DOCKER, pids=1) for name in names)
    found = samples(accept, units)
    labels = [dict(pairs)["container"] for name, pairs in found if name == "phm_container_pids"]
    assert len(labels) == len(names), "also those that begin alike"
    assert all(label.isprintable() and len(label) <= MAX_LABEL for label in labels)
    assert found["phm_alive", ()] == 1.0


def test_there_is_a_limit_of_series_and_what_is_left_out_is_counted() -> None:
    """Whatever number of names comes from outside."""
    units = tuple(
        state(f"pressure/c{number}", "pressure", Slot.CONTAINER, Layer.DOCKER, pids=1)
        for number in range(MAX_SERIES + 5)
    )
    found = samples(PLAIN, units)
    assert sum(name == "phm_container_pids" for name, _ in found) == MAX_SERIES
    assert found["phm_metrics_left_out", ()] == 10.0, "5 levels and 5 containers"


def test_a_unit_that_has_nothing_to_evaluate_has_no_level() -> None:
    """It would look like OK."""
    unit = state("devices/a", "devices", Slot.DEVICES, Layer.DOCKER, Level.OK)
    names = {name for name, _ in samples(PLAIN, (replace(unit, result=replace(unit.result, bypass=True)),))}
    assert not names & {"phm_unit_level", "phm_slot_level"}


def test_a_duration_counts_in_each_limit_that_it_does_not_exceed() -> None:
    """As Prometheus defines buckets: a limit is included."""
    counts = HistogramCounts((1.0, 2.0))
    for value in (1.0, 1.5, 9.0):
        counts.observe(value)
    assert counts.buckets() == [("1.0", 1.0), ("2.0", 2.0), ("+Inf", 3.0)]
    assert counts.total == 11.5


def test_a_cut_label_shows_that_it_is_cut() -> None:
    """And stays within the limit when escapes make it longer."""
    assert "..." in clean_label("a" * (MAX_LABEL + 1))
    assert clean_label("a" * 101 + "b") != clean_label("a" * 101 + "c"), "two names stay two"
    assert clean_label("a" * 101 + "b") == clean_label("a" * 101 + "b")
    assert len(clean_label("\x00" * 5000)) == MAX_LABEL


def test_a_number_that_no_measurement_has_does_not_take_the_page_down() -> None:
    """A plug-in may print an integer of any length."""
    found = samples(
        PLAIN, (state("custom/x", "custom", Slot.USER_1, Layer.CUSTOM, huge=10**400, load=2, low=-(10**400)),)
    )
    assert found["phm_custom_value", (("name", "load"), ("unit", "custom/x"))] == 2.0
    assert sum(name == "phm_custom_value" for name, _ in found) == 1


def test_counters_of_events_that_never_happened_are_0() -> None:
    """`increase()` is blind for a series that begins at 1: the first alarm of a slot would be missed."""
    about = context()
    nothing = EventCounts(lambda unit: None)
    text, _ = MetricsText(lambda: build_page(about, nothing)).render(PLAIN)
    lines = text.decode().splitlines()
    assert 'phm_alarms_total{slot="host"} 0.0' in lines
    for outcome in ("resolved", "escalated", "reattributed"):
        assert f'phm_faults_total{{outcome="{outcome}",slot="host"}} 0.0' in lines


@pytest.mark.parametrize("by", sorted(NOT_OBSERVED))
def test_a_fault_whose_end_no_one_observed_has_no_recovery_duration(by: str) -> None:
    """It is a fault that was closed, as before."""
    about = context()
    happened = counts(about)
    closed = replace(FAULT, outcome=Outcome.RESOLVED, by=by, closed=replace(AT, mono=AT.mono + 3600.0))
    happened.take(FaultClosed(AT, closed))
    lines = MetricsText(lambda: build_page(about, happened)).render(PLAIN)[0].decode().splitlines()
    assert 'phm_recovery_duration_seconds_sum{slot="container"} 7.0' in lines
    assert 'phm_faults_total{outcome="resolved",slot="container"} 2.0' in lines


@pytest.mark.parametrize("received", [True, False])
def test_a_silent_autopilot_is_neither_armed_nor_disarmed(received: bool) -> None:
    """Its last word may be hours old."""
    about = replace(context(), autopilot=lambda: received)
    text, _ = text_of(about).render(PLAIN)
    assert (b"phm_autopilot_armed 1.0" in text) is received
    assert b'phm_heartbeat_age_seconds{link="radio",source="autopilot"}' in text


@pytest.mark.parametrize(
    ("accept", "first"),
    [
        ("application/openmetrics-text", True),
        (OPENMETRICS, True),
        ("Application/OpenMetrics-Text; Version=1.0.0; Q=0.5, text/plain; q=0.3", True),
        ("text/plain, application/openmetrics-text;q=0.5", False),
        ("application/openmetrics-text;q=0, text/plain", False),
        ("application/openmetrics-text;q=0", False),
        ("application/openmetrics-text;q=x", False),
        ("application/openmetrics-text;q=nan,text/plain;q=0", False),
        ("text/html, */*", False),
        ("", False),
    ],
)
def test_a_client_gets_the_format_that_it_prefers(accept: str, first: bool) -> None:
    """By the weights of its header."""
    assert wants_openmetrics(accept) is first


def test_promtool_accepts_the_page() -> None:
    """Names, units and help by the conventions of Prometheus, without a remark about one of ours."""
    said = promtool("check", "metrics", stdin=text_of(context()).render(PLAIN)[0])
    assert "phm_" not in said, said
