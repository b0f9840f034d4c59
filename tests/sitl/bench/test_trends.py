"""The back-test of the forecasts: failing series are reported, harmless ones are not."""

from __future__ import annotations

from sitl.bench.trends import FAMILIES, row


def test_constant_leaks_are_reported_before_they_reach_the_limit_and_noise_is_not() -> None:
    """The two kinds that leave no doubt; docs/reference/trends.md has all."""
    rows = {
        family.name: row(family, 5, seed=2, horizon_s=600.0)
        for family in FAMILIES
        if family.name in ("constant leak", "steady, with noise")
    }
    assert rows["constant leak"]["reported before"] == rows["constant leak"]["reached the limit"] == 5
    assert rows["steady, with noise"]["series reported wrongly"] == 0
