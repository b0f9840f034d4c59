"""The logs that these tests write need no measurement of this machine for each of their thousands of reports."""

from __future__ import annotations

from tests.fakes.records import fixed_cost

__all__ = ["fixed_cost"]
