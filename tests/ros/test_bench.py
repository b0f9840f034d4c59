"""The tests' own bench: runs of the tests at the same time must not hear each other."""

from __future__ import annotations

import itertools

import pytest

from tests.fakes import ros_bench


def test_a_domain_in_use_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another run that counts from the same number finds the next one that is free."""
    locks = []
    domains = []
    for _ in range(3):
        monkeypatch.setattr(ros_bench, "_turns", itertools.count(7))
        domain, lock = ros_bench.claim_domain()
        domains.append(domain)
        locks.append(lock)
    try:
        assert len(set(domains)) == 3
        assert all(ros_bench.FIRST_DOMAIN <= domain < 102 for domain in domains)
    finally:
        for lock in locks:
            lock.close()
