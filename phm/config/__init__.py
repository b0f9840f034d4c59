"""Reads `phm.yaml` into `phm.core.settings.Settings`, and reports all of its problems."""

from __future__ import annotations

from phm.config.loader import find, load, loads
from phm.config.problems import ConfigError, Problem

__all__ = ["ConfigError", "Problem", "find", "load", "loads"]
