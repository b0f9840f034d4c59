"""The functions of `phm.api` that make results take control arguments and measurements separately."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest

from phm import api

MAKERS = [api.ok, api.bypass, api.warn, api.error, api.stale]


@pytest.mark.parametrize("make", MAKERS)
def test_a_misspelt_argument_is_refused(make: Callable[..., api.Result]) -> None:
    """It does not become a measurement: without `**values`, mypy refuses it, too."""
    known = inspect.signature(make).parameters
    assert all(parameter.kind is not inspect.Parameter.VAR_KEYWORD for parameter in known.values())
    needed: dict[str, Any] = {name: "x" for name in ("brief", "condition") if name in known}
    with pytest.raises(TypeError, match="taget"):
        make("a summary", **needed, taget="ros_app")


def test_measurements_are_kept_as_they_were() -> None:
    """A check may change its own mapping afterwards."""
    values: dict[str, api.Value] = {"battery_v": 14.8}
    result = api.ok("battery at 14.8 V", values=values)
    values["battery_v"] = 0.0
    assert result.values == {"battery_v": 14.8}
    assert api.stale("unknown").values == {}
