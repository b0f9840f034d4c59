"""Commands that reach a real container use the containers of tests/docker."""

from __future__ import annotations

from tests.docker.conftest import real

__all__ = ["real"]
