"""A page of metrics as text: OpenMetrics, or the older text format of Prometheus. Needs prometheus-client (extra `metrics`)."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from phm.wire.metrics_page import HistogramCounts, Labels, Metric, MetricsPage

_OPENMETRICS = "application/openmetrics-text"
_PLAIN = "text/plain"
_WEIGHT = re.compile(r"0(\.[0-9]{0,3})?|1(\.0{0,3})?")
_ACCEPT = {True: f"{_OPENMETRICS}; version=1.0.0", False: f"{_PLAIN}; version=0.0.4"}

MakePage = Callable[[], MetricsPage]
Family = CounterMetricFamily | GaugeMetricFamily | HistogramMetricFamily


class MetricsText:
    """Renders the current state; nothing is registered globally. With the standard metrics `process_*` of this process."""

    def __init__(self, make_page: MakePage) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_Current(make_page))
        ProcessCollector(registry=self._registry)

    def render(self, accept: str) -> tuple[bytes, str]:
        """accept: the header of the request, from outside. The text and its content type; raises what `make_page` raises."""
        # Only two answers exist, whatever versions and escapings a client offers.
        encode, content_type = choose_encoder(_ACCEPT[wants_openmetrics(accept)])
        return encode(self._registry), content_type


def wants_openmetrics(accept: str) -> bool:
    """Whether a header Accept prefers OpenMetrics to the older format, or names it alone."""
    weights = {_OPENMETRICS: 0.0, _PLAIN: 0.0}
    for part in accept.lower().split(","):
        kind, *parameters = (word.strip() for word in part.split(";"))
        if kind in weights:
            weights[kind] = max(weights[kind], _weight(parameters))
    return weights[_OPENMETRICS] > 0 and weights[_OPENMETRICS] >= weights[_PLAIN]


def _weight(parameters: Iterable[str]) -> float:
    """From 0 to 1; 0 for one that is not a number."""
    for name, _, value in (parameter.partition("=") for parameter in parameters):
        if name.strip() == "q":
            return float(value) if _WEIGHT.fullmatch(value.strip()) else 0.0
    return 1.0


class _Current(Collector):
    """A collector without a fixed list of metrics."""

    def __init__(self, make_page: MakePage) -> None:
        self._make_page = make_page

    def describe(self) -> list[Family]:
        return []

    def collect(self) -> Iterator[Family]:
        for metric, values, histograms in self._make_page().samples():
            yield _family(metric, values, histograms)


def _family(metric: Metric, values: Mapping[Labels, float], histograms: Mapping[Labels, HistogramCounts]) -> Family:
    if metric.kind == "histogram":
        family = HistogramMetricFamily(metric.name, metric.help, labels=metric.labels)
        for labels, counts in histograms.items():
            family.add_metric(labels, counts.buckets(), counts.total)
        return family
    kind = CounterMetricFamily if metric.kind == "counter" else GaugeMetricFamily
    plain = kind(metric.name, metric.help, labels=metric.labels)
    for labels, value in values.items():
        plain.add_metric(labels, value)
    return plain
