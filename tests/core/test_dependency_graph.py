"""The graph of needs."""

from __future__ import annotations

import pytest

from phm.core.dependency_graph import DependencyCycle, DependencyGraph


def test_upstream_lists_causes_before_consequences() -> None:
    """The first entry of upstream that fails is the root, so the order is topological."""
    needs = DependencyGraph({"rates": ["topics"], "topics": ["nodes"], "nodes": ["container"], "container": []})
    assert needs.upstream("rates") == ("container", "nodes", "topics")


def test_downstream_is_transitive() -> None:
    """Everything that can be a consequence is found, however far below."""
    needs = DependencyGraph({"rates": ["topics"], "topics": ["nodes"], "nodes": [], "host": []})
    assert set(needs.downstream("nodes")) == {"topics", "rates"}
    assert needs.downstream("host") == ()


def test_a_need_that_is_not_configured_is_dropped() -> None:
    """A disabled check cannot be a cause."""
    assert DependencyGraph({"nodes": ["container/gone"]}).upstream("nodes") == ()


def test_a_loop_is_refused_and_named() -> None:
    """Needs that run in a circle have no root; the message shows the circle."""
    with pytest.raises(DependencyCycle) as caught:
        DependencyGraph({"a": ["b"], "b": ["c"], "c": ["a"]})
    assert caught.value.loop[0] == caught.value.loop[-1]
    assert set(caught.value.loop) == {"a", "b", "c"}
