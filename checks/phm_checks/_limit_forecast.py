"""A limit that a measurement will reach at its present rate: reported while it is within the horizon, with hysteresis."""

from __future__ import annotations

from phm import api
from phm_checks._text import StableNumber, span

WINDOW_S = 900.0
LEAST_S = 60.0
STAY = 1.5
"""Hysteresis: a reported forecast ends only when the limit is further away than this many horizons."""
UNSURE = 2.0
"""A forecast is reported only if even its latest time is within this many horizons."""


class LimitForecast:
    """The forecast of one measurement. `POLLS` of them are made in the shortest time that a trend is observed for."""

    POLLS = 12

    def __init__(
        self,
        horizon_s: float,
        confidence_percent: float,
        *,
        window_s: float = WINDOW_S,
        least_s: float = LEAST_S,
        falls: bool = False,
    ) -> None:
        """horizon_s: how far ahead to look; 0: never. falls: the limit is one to fall below, else one to rise above."""
        self._falls = falls
        self._horizon_s, self._percent, self._every_s = horizon_s, confidence_percent, least_s / self.POLLS
        self._trend = api.Trend(window_s, least_s=least_s, confidence=confidence_percent / 100)
        self._polled_s = float("-inf")
        self._soon: api.Forecast | None = None
        self._shown = StableNumber(share=0.3)

    def soon(self, now_s: float, value: float | None, limit: float) -> api.Forecast | None:
        """Take a measurement; return the forecast while it is to be reported. value: None if it was not measured."""
        if not self._horizon_s or value is None:
            return None
        self._trend.add(now_s, value)
        if now_s - self._polled_s >= self._every_s:
            self._polled_s = now_s
            self._soon = self._reported(self._trend.reaches(limit))
            if self._soon is None:
                self._shown.forget("")
        return self._soon

    def forget(self) -> None:
        """Start again with another subject, e.g. after a restart of the container."""
        self._trend.forget()
        self._soon = None

    def words(self, forecast: api.Forecast) -> str:
        """`in 12 min at this rate (in 17 min at the latest, with 95 % confidence)`."""
        return (
            f"in {span(forecast.likely_s)} at this rate (in {span(forecast.latest_s)} at the latest, with "
            f"{self._percent:g} % confidence)"
        )

    def short(self, forecast: api.Forecast) -> str:
        """`in 12 min`, which rarely changes: the ground receives each change."""
        shown_s = self._shown.show("", forecast.likely_s)
        return f"in {shown_s / 60:.0f} min" if shown_s >= 90 else f"in {shown_s:.0f} s"

    def _reported(self, found: api.Forecast | None) -> api.Forecast | None:
        if found is None or (found.slope < 0.0) is not self._falls:
            return None  # also where a value returns through its limit
        share = STAY if self._soon is not None else 1.0
        near = found.likely_s <= share * self._horizon_s and found.latest_s <= share * UNSURE * self._horizon_s
        return found if near else None
