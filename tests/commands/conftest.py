"""Commands that reach a real container use the containers of tests/probes/docker."""

from __future__ import annotations

from tests.probes.docker.conftest import real

__all__ = ["real"]
