"""Tests with a real container use the fixtures of tests/probes/docker."""

from __future__ import annotations

from tests.probes.docker.conftest import real

__all__ = ["real"]
