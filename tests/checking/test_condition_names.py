"""Which conditions the installed checks can report."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.checking.condition_names import unnamed
from phm.checking.registry import checks
from phm.recovery.ladders import LADDERS

PLUGIN = """
from phm import api
class Battery(api.Check):
    name = "battery"
    def run(self, world):
        return api.error("low", brief="low", condition='battery_low')
"""


def test_conditions_of_the_built_in_checks_are_found() -> None:
    """Also those that the code makes of two parts."""
    names = [*LADDERS, "dead", "healthcheck_missing", "diagnostic_error", "publisher_missing"]
    assert unnamed(names, checks().values()) == []


def test_a_condition_that_no_check_names_is_returned() -> None:
    assert unnamed(["unhealty", "unhealthy"], checks().values()) == ["unhealty"]


def test_the_condition_of_a_plug_in_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is a module without a package; without its source its conditions are unknown."""
    (tmp_path / "my_battery.py").write_text(PLUGIN)
    monkeypatch.syspath_prepend(tmp_path)
    from my_battery import Battery  # type: ignore[import-not-found]

    assert unnamed(["battery_low", "battery_lo"], [Battery]) == ["battery_lo"]
    (tmp_path / "my_battery.py").unlink()
    assert unnamed(["battery_low"], [Battery]) == ["battery_low"]
