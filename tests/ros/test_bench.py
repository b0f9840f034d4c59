"""The test bench: concurrent test runs must not receive each other's messages."""

from __future__ import annotations

import itertools

import pytest

from tests.fakes import ros_domain


def test_a_domain_in_use_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Another run that counts from the same number finds the next free one."""
    locks = []
    domains = []
    for _ in range(3):
        monkeypatch.setattr(ros_domain, "_turns", itertools.count(7))
        domain, lock = ros_domain.claim_domain()
        domains.append(domain)
        locks.append(lock)
    try:
        assert len(set(domains)) == 3
        assert all(ros_domain.FIRST_DOMAIN <= domain < 102 for domain in domains)
    finally:
        for lock in locks:
            lock.close()
