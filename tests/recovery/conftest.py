"""The fake engine, and the fixtures of the real one, which the tests of the Docker client share."""

from __future__ import annotations

from tests.docker.conftest import ask, engine, fake, real, until

__all__ = ["ask", "engine", "fake", "real", "until"]
