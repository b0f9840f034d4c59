"""Faults to inject into a simulated agent: one file each, found by being here.

A fault's file defines a class `Injection` (see `sitl.faults.base.Fault`); files with a leading `_` are what several share. It is injected through the
same doors that real trouble uses (the Docker Engine, signals), and undone by `clear` where recovery does not.
"""

from __future__ import annotations

import importlib
import pkgutil

from sitl.faults.base import Fault


def all_faults() -> dict[str, Fault]:
    """Every fault in this folder by its name, in the order of their slots."""
    found: dict[str, Fault] = {}
    for module in pkgutil.iter_modules(__path__):
        if module.name != "base" and not module.name.startswith("_"):
            fault: Fault = importlib.import_module(f"{__name__}.{module.name}").Injection()
            found[fault.name] = fault
    return found
