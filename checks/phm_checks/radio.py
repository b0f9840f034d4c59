"""Slot 11: the telemetry radio responds, and its signal is strong enough."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm import api
from phm.api import Layer, Slot
from phm_checks._command_path import link_id, link_of, named, radio_id, silent, starting, target_of, with_radio
from phm_checks._limit_forecast import LimitForecast
from phm_checks._text import StableNumber, brief, merged, span

PERIODS = 2.5
"""A radio is silent after this many of its own periods: SiK responds to PHM's heartbeats, which may be 10 s apart."""
FULL_PERCENT = 20
"""With less of the transmit buffer free, commands and status are delayed in the radio."""
EASE_MARGIN, EASE_ERRORS, EASE_PERCENT = 4.0, 0.5, 30
"""Hysteresis: a reported problem ends only when the value is better than its limit by so much."""
FADE_WINDOW_S, FADE_LEAST_S = 120.0, 20.0
"""A vehicle that flies away loses its margin within minutes."""
GRACE_S = 5.0
"""Time for the first RADIO_STATUS after PHM started or the link came back."""


class Radio(api.Check):
    """The radio behind one endpoint, by its RADIO_STATUS."""

    name, slot, layer = "radio", Slot.RADIO, Layer.LINK
    period_s = 1.0

    def __init__(self, entry: api.EndpointSettings, settings: api.Settings) -> None:
        self.entry, self._limits = entry, settings.mavlink
        self._label = named("radio", entry, with_radio(settings))
        self._age, self._margin = StableNumber(share=1.0), StableNumber(share=0.5)
        self._was: frozenset[str] = frozenset()
        trends = settings.trends
        self._fading = LimitForecast(
            trends.radio, trends.confidence, window_s=FADE_WINDOW_S, least_s=FADE_LEAST_S, falls=True
        )

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(entry, settings) for entry in with_radio(settings)]

    @property
    def subject(self) -> str:
        return api.topic_id(self.entry.key)

    @property
    def units(self) -> Sequence[api.Unit]:
        needs = (link_id(self.entry),)
        return (api.Unit(radio_id(self.entry), needs=needs, target=target_of(self.entry.key), grace_s=GRACE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link"})

    def run(self, world: api.World) -> api.Result:
        link = link_of(world, self.entry.key)
        fact = next((one for one in world.links.radios() if one.link == self.entry.key), None)
        if link is not None and not link.open:
            return api.stale(f"radio state unknown: its link {self.entry.key} is closed")
        if fact is None and self.entry.radio != "required":
            words = f"no RADIO_STATUS received on {self.entry.key}, and no radio is required"
            return api.bypass(words).with_evidence(api.Evidence(unobserved=True))
        if fact is None and starting(world):
            return api.stale(f"no RADIO_STATUS received on {self.entry.key} yet")
        limit_s = self._limits.radio_timeout if fact is None else max(self._limits.radio_timeout, PERIODS * fact.due_s)
        if fact is None or fact.silent_s > limit_s:
            return self._lost(link, fact, limit_s)
        self._age.forget("age")
        return self._judged(fact, world.clock.mono() - fact.age_s)

    def _lost(self, link: api.LinkFact | None, fact: api.RadioFact | None, limit_s: float) -> api.Result:
        age_s = None if fact is None else fact.age_s
        nothing = silent(link)
        when = "since PHM's start" if age_s is None else f"for {span(age_s)}"
        shown = "" if age_s is None else f" {self._age.show('age', age_s):.0f} s"
        more = (
            "nothing else is received on its link either" if nothing else "other frames are still received on its link"
        )
        return api.error(
            f"no RADIO_STATUS {when} on {self.entry.key}, expected one within {span(limit_s)}, and {more}: check the radio's "
            "power and cable, and that its MAVLink mode is on",
            brief=brief(f"{self._label}:", f"no RADIO_STATUS{shown}"),
            condition="radio_silent",
            target=target_of(self.entry.key) if nothing else "",
            values={"radio_age_s": None if age_s is None else round(age_s, 1)},
        )

    def _judged(self, fact: api.RadioFact, at_s: float) -> api.Result:
        findings = [*(self._weak(fact) or self._fades(fact, at_s)), *self._full(fact), *self._damaged(fact)]
        self._was = frozenset(finding.condition for finding in findings)
        values = _values(fact)
        if not findings:
            self._margin.forget("margin")
            alone = "; it receives nothing from the remote radio" if fact.alone else ""
            return api.ok(f"last RADIO_STATUS {span(fact.age_s)} ago{_margin_words(fact)}{alone}", values=values)
        return merged(findings, values).with_evidence(api.Evidence(recovered=True))  # it responds

    def _weak(self, fact: api.RadioFact) -> list[api.Result]:
        limit = self._limits.radio_margin + (EASE_MARGIN if "radio_weak" in self._was else 0.0)
        ends = [(fact.margin, "on board"), (fact.remmargin, "on the ground")]
        weak = [(margin, where) for margin, where in ends if margin is not None and margin < limit]
        if not weak:
            return []
        margin, where = min(weak)
        shown = self._margin.show("margin", margin)
        return [
            api.warn(
                f"the radio's signal {where} is {margin:.0f} above the noise, expected {self._limits.radio_margin:g} or more "
                "(in the radio's units; SiK: 1.9 to a dB): the link may be lost soon; reduce the distance, turn the antenna, or "
                "look for interference",
                brief=brief(f"{self._label}:", f"weak, margin {shown:.0f}"),
                condition="radio_weak",
            )
        ]

    def _fades(self, fact: api.RadioFact, at_s: float) -> list[api.Result]:
        margins = [margin for margin in (fact.margin, fact.remmargin) if margin is not None]
        soon = self._fading.soon(at_s, min(margins, default=None), self._limits.radio_margin)
        if soon is None:
            return []
        return [
            api.warn(
                f"the radio's signal is {min(margins):.0f} above the noise and falls below {self._limits.radio_margin:g} "
                f"{self._fading.words(soon)}: the link may be lost then; reduce the distance, or turn the antenna",
                brief=brief(f"{self._label}:", f"weak {self._fading.short(soon)}"),
                condition="radio_fading",
            )
        ]

    def _full(self, fact: api.RadioFact) -> list[api.Result]:
        limit = EASE_PERCENT if "radio_full" in self._was else FULL_PERCENT
        if fact.txbuf >= limit:
            return []
        return [
            api.warn(
                f"the radio's transmit buffer is {100 - fact.txbuf} % full, so messages are delayed: lower the stream rates of "
                "the autopilot, or raise the radio's air speed",
                brief=brief(f"{self._label}:", "buffer full"),
                condition="radio_full",
            )
        ]

    def _damaged(self, fact: api.RadioFact) -> list[api.Result]:
        limit = self._limits.radio_errors * (EASE_ERRORS if "radio_errors" in self._was else 1.0)
        if not limit or fact.rxerrors_s is None or fact.rxerrors_s <= limit:
            return []
        return [
            api.warn(
                f"the radio receives {fact.rxerrors_s:.1f} damaged packets a second, expected {self._limits.radio_errors:g} or "
                "fewer: look for interference on its frequency, or another swarm with the same network id",
                brief=brief(f"{self._label}:", "damaged packets"),
                condition="radio_errors",
            )
        ]


def _margin_words(fact: api.RadioFact) -> str:
    margins = [margin for margin in (fact.margin, fact.remmargin) if margin is not None]
    return f", signal {min(margins):.0f} above the noise" if margins else ""


def _values(fact: api.RadioFact) -> dict[str, api.Value]:
    rounded = {
        "margin": fact.margin,
        "remmargin": fact.remmargin,
        "rxerrors_s": fact.rxerrors_s,
        "fixed_s": fact.fixed_s,
    }
    return {
        "radio_age_s": round(fact.age_s, 1),
        "rssi": fact.rssi,
        "remrssi": fact.remrssi,
        "noise": fact.noise,
        "remnoise": fact.remnoise,
        "txbuf_percent": fact.txbuf,
        **{name: None if value is None else round(value, 1) for name, value in rounded.items()},
    }
