"""The dependency graph."""

from __future__ import annotations

import pytest

from phm.core.dependency_graph import DependencyCycle, DependencyGraph


def test_upstream_lists_causes_before_consequences() -> None:
    """The first failed entry of upstream is the root cause, so the order is topological."""
    needs = DependencyGraph({"rates": ["topics"], "topics": ["nodes"], "nodes": ["container"], "container": []})
    assert needs.upstream("rates") == ("container", "nodes", "topics")


def test_downstream_is_transitive() -> None:
    """It contains every possible consequence, at any distance."""
    needs = DependencyGraph({"rates": ["topics"], "topics": ["nodes"], "nodes": [], "host": []})
    assert set(needs.downstream("nodes")) == {"topics", "rates"}
    assert needs.downstream("host") == ()


def test_a_dependency_that_is_not_configured_is_dropped() -> None:
    """A disabled check cannot be a cause."""
    assert DependencyGraph({"nodes": ["container/gone"]}).upstream("nodes") == ()


def test_a_cycle_is_an_error_that_names_it() -> None:
    """A cycle of dependencies has no root; the message shows the cycle."""
    with pytest.raises(DependencyCycle) as caught:
        DependencyGraph({"a": ["b"], "b": ["c"], "c": ["a"]})
    assert caught.value.loop[0] == caught.value.loop[-1]
    assert set(caught.value.loop) == {"a", "b", "c"}
