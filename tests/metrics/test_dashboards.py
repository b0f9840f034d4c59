"""The dashboard, the alert rules, and the files for Foxglove and rqt_robot_monitor name what exists."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from phm.core.model import Layer, Slot
from phm.facts.ros import CONSENSUS, DIAGNOSTICS, DiagnosticFact
from phm.gcs import metrics_catalog as ground
from phm.reporters import metrics_catalog as agent
from phm.reporters.diagnostics import DiagnosticsReporter
from phm.wire.metrics_page import Metric
from tests.fakes.until import until
from tests.metrics.agent import context, state, states, text_of
from tests.metrics.ground import ground_text
from tests.metrics.prometheus import Prometheus, page, promtool

EXAMPLES = Path(__file__).parents[2] / "config" / "examples"
ALERTS = EXAMPLES / "prometheus" / "phm-alerts.yaml"
DASHBOARD = EXAMPLES / "grafana" / "phm-dashboard.json"
PROCESS = {"process_cpu_seconds_total", "process_resident_memory_bytes"}
LAYERS = {layer.value for layer in Layer}
PLOT_KEYS = {
    "paths",
    "xAxisVal",
    "minYValue",
    "maxYValue",
    "isSynced",
    "showXAxisLabels",
    "showYAxisLabels",
    "sidebarDimension",
    "showLegend",
    "legendDisplay",
    "showPlotValuesInLegend",
    "foxglovePanelTitle",
    "lichtblickPanelTitle",
}
"""Keys that the plot panel reads; each program has its own name for the title."""


def rules() -> list[dict[str, Any]]:
    return [rule for group in yaml.safe_load(ALERTS.read_text())["groups"] for rule in group["rules"]]


def panels() -> list[dict[str, Any]]:
    return [panel for panel in json.loads(DASHBOARD.read_text())["panels"] if panel["type"] != "row"]


def queries() -> list[str]:
    """Of the dashboard, with its variables replaced as Grafana does."""
    found = [target["expr"] for panel in panels() for target in panel["targets"]]
    return [text.replace("$instance", ".+").replace("$__rate_interval", "1m") for text in found]


def known() -> dict[str, Metric]:
    """Names as they appear in queries."""
    found: dict[str, Metric] = {}
    for metric in (*agent.ALL, *ground.ALL):
        suffixes = ("_bucket", "_sum", "_count") if metric.kind == "histogram" else ("",)
        found |= {f"{metric.name}{suffix}": metric for suffix in suffixes}
    return found


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Prometheus]:
    made = Prometheus(tmp_path_factory.mktemp("prometheus"), {}, (ALERTS,))
    yield made
    made.close()


@pytest.mark.parametrize("text", [*queries(), *(rule["expr"] for rule in rules())])
def test_a_query_is_accepted_and_names_only_metrics_that_exist(text: str, server: Prometheus) -> None:
    """With labels that its metric has: a query for another one would always show nothing."""
    server.query(text)
    names = set(re.findall(r"\b(?:phm|process)_\w+", re.sub(r'"[^"]*"', "", text)))
    metrics = known()
    assert names <= metrics.keys() | PROCESS, names - metrics.keys() - PROCESS
    allowed = {"instance", "job", "le"} | {label for name in names & metrics.keys() for label in metrics[name].labels}
    used = set(re.findall(r"[{,]\s*(\w+)\s*[=!]", text))
    for group in re.findall(r"\b(?:by|on)\s*\(([^)]*)\)", text):
        used |= {label.strip() for label in group.split(",")}
    assert used <= allowed, used - allowed


def test_each_query_of_the_dashboard_shows_phm_and_nothing_else(tmp_path: Path) -> None:
    """With all agents selected, beside a program that has `process_*` too, as Prometheus itself has."""
    openmetrics = "application/openmetrics-text; version=1.0.0; charset=utf-8"
    agents, kind = text_of(context()).render("text/plain")
    other = b"process_cpu_seconds_total 1\nprocess_resident_memory_bytes 1\n"
    with (
        page(agents, kind) as here,
        page(ground_text(), openmetrics) as ground_page,
        page(other, "text/plain") as else_,
    ):
        server = Prometheus(tmp_path, {"phm": here, "phm_gcs": ground_page, "prometheus": else_})
        try:
            until(
                lambda: [text for text in queries() if not server.query(text)] == [],
                "a series for each query",
                lambda: f"{[text for text in queries() if not server.query(text)]}\n{server.errors()}",
                poll_s=0.2,
            )
            until(lambda: bool(server.query('process_cpu_seconds_total{job="prometheus"}')), "the other program")
            jobs = {one["metric"].get("job", "phm") for text in queries() for one in server.query(text)}
            assert jobs == {"phm", "phm_gcs"}
        finally:
            server.close()


def test_each_panel_has_a_title_a_query_and_its_own_place() -> None:
    """And labels in the legend that its metrics have."""
    made = panels()
    assert len({panel["id"] for panel in made}) == len(made)
    taken: set[tuple[int, int]] = set()
    for panel in made:
        assert panel["title"] and panel["targets"]
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert place["x"] + place["w"] <= 24 and not cells & taken, panel["title"]
        taken |= cells
        for target in panel["targets"]:
            labels = set(re.findall(r"{{(\w+)}}", target["legendFormat"]))
            names = re.findall(r"\bphm_\w+", target["expr"])
            allowed = {"instance", "job"} | {
                label for name in names if name in known() for label in known()[name].labels
            }
            assert labels <= allowed, (panel["title"], labels - allowed)


def test_the_first_action_of_a_kind_is_counted(tmp_path: Path) -> None:
    """Its series begins with it at 1, which `increase()` alone does not see."""
    (expr,) = [text for text in queries() if "phm_actions_total" in text]
    series = 'phm_actions_total{instance="a",slot="nodes",action="restart",outcome="started"}'
    expected = {"labels": '{action="restart", outcome="started"}', "value": 1}
    expressions = [{"expr": expr, "eval_time": "70m", "exp_samples": [expected]}]
    inputs = [{"series": series, "values": "_x30 1x60"}]
    case = {"interval": "1m", "input_series": inputs, "promql_expr_test": expressions}
    (tmp_path / "first.yaml").write_text(json.dumps({"tests": [case]}))
    assert "SUCCESS" in promtool("test", "rules", "first.yaml", folder=tmp_path)


def test_promtool_accepts_the_rules_and_the_configuration() -> None:
    """Also with the rule file beside it."""
    promtool("check", "rules", str(ALERTS))
    promtool("check", "config", str(ALERTS.with_name("prometheus.yml")))


def test_each_alert_fires_for_what_it_describes_and_not_otherwise(tmp_path: Path) -> None:
    """Simulated by promtool: tests/metrics/phm-alerts.test.yaml names every alert."""
    cases = Path(__file__).with_name("phm-alerts.test.yaml")
    shutil.copy(ALERTS, tmp_path)
    shutil.copy(cases, tmp_path)
    said = promtool("test", "rules", cases.name, folder=tmp_path)
    assert "SUCCESS" in said
    for rule in rules():
        assert rule["alert"] in cases.read_text(), rule["alert"]


@pytest.mark.parametrize("rule", rules(), ids=lambda rule: str(rule["alert"]))
def test_an_alert_says_what_happened_and_what_to_do(rule: dict[str, Any]) -> None:
    """In sentences, with a severity."""
    texts = rule["annotations"]
    assert rule["labels"]["severity"] in ("warning", "critical")
    assert texts["remedy"].endswith(".") and len(texts["remedy"]) > 20
    assert "$labels" in texts["summary"]


class Port:
    """Takes what the reporter publishes."""

    def __init__(self) -> None:
        self.statuses: dict[str, DiagnosticFact] = {}

    def idle(self, topic: str = DIAGNOSTICS) -> bool:
        return False

    def publish(self, statuses: Any, topic: str = DIAGNOSTICS) -> int:
        self.statuses = dict(statuses)
        return 0


def published(name: str) -> dict[str, DiagnosticFact]:
    """What an agent publishes on /diagnostics, with a unit in each layer."""
    link = state("link/radio", "link", Slot.RADIO, Layer.LINK)
    port, about = Port(), context((*states(), link))
    agents = about.settings.agent.model_copy(update={"name": name})
    object.__setattr__(about, "settings", replace(about.settings, agent=agents))
    DiagnosticsReporter(about, port).tick()
    return port.statuses


def test_the_analyzers_put_each_status_into_one_group() -> None:
    """By agent and layer, as diagnostic_aggregator matches: a name that starts with the text. No layer is missing."""
    file = yaml.safe_load((EXAMPLES / "ros" / "phm-analyzers.yaml").read_text())
    parameters = file["analyzers"]["ros__parameters"]
    groups = {key: value for key, value in parameters.items() if isinstance(value, dict)}
    assert parameters["path"] == "PHM" and list(groups) == ["agent_1", "agent_2"]
    for name, group in groups.items():
        assert group["type"] == "diagnostic_aggregator/AnalyzerGroup"
        assert set(group["analyzers"]) == {"summary", *LAYERS}
        found: dict[str, list[str]] = {}
        for status in published(name):
            for key, one in group["analyzers"].items():
                assert (one.get("num_items") == 0) == (key in LAYERS), "a layer may be empty, the summary may not"
                assert one["type"] == "diagnostic_aggregator/GenericAnalyzer"
                assert not any(other.startswith(tuple(one["startswith"])) for other in published(f"{name}0"))
                if any(status.startswith(text) for text in one["startswith"]):
                    found.setdefault(status, []).append(key)
        assert sorted(found) == sorted(published(name))
        assert all(len(keys) == 1 for keys in found.values()), found
        assert {key for keys in found.values() for key in keys} == {"summary", *LAYERS}


def test_the_foxglove_layout_shows_what_is_published() -> None:
    """Topics, hardware id and name are the reporter's, and each panel of the layout has a configuration of its type's keys."""
    layout = json.loads((EXAMPLES / "foxglove" / "phm-layout.json").read_text())
    panels = layout["configById"]
    assert set(_leaves(layout["layout"])) == set(panels)
    summary, status = panels["DiagnosticSummary!phm1"], panels["DiagnosticStatusPanel!phm2"]
    assert set(summary) == {"topicToRender", "minLevel", "pinnedIds", "hardwareIdFilter", "sortByLevel"}
    assert set(status) == {"topicToRender", "selectedHardwareId", "selectedName", "splitFraction"}
    assert summary["topicToRender"] == status["topicToRender"] == DIAGNOSTICS
    fact = published("agent_1")[status["selectedName"]]
    assert fact.hardware_id == status["selectedHardwareId"]
    plot = panels["Plot!phm3"]
    assert set(plot) <= PLOT_KEYS, set(plot) - PLOT_KEYS
    assert plot["foxglovePanelTitle"] == plot["lichtblickPanelTitle"]
    path = plot["paths"][0]["value"]
    assert path == f'{DIAGNOSTICS}.status[:]{{name=="{status["selectedName"]}"}}.level'
    assert panels["RawMessages!phm4"]["topicPath"] == CONSENSUS


def _leaves(node: Any) -> list[str]:
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column")
    return [*_leaves(node["first"]), *_leaves(node["second"])]
