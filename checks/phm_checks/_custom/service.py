"""Type `service`: a ROS service has a server and, if it may be called, answers."""

from __future__ import annotations

from phm import api
from phm_checks._custom.base import Finding, bad, good
from phm_checks._custom.ros import RosCheck
from phm_checks._readiness import NOT_LISTED
from phm_checks._ros_facts import full_name, snapshot
from phm_checks._text import clean, last, span

POLL_S = 1.0
"""The ROS child process looks for answers four times a second: a shorter limit would be exceeded by good ones."""


class Service(RosCheck):
    """The ROS child process counts its servers and calls it."""

    def observe(self, world: api.World) -> Finding:
        fact, name = snapshot(world), full_name(self.entry.service)
        called = fact.calls.get(name, api.AnswerFact())
        if self.entry.call is not None and called.problem:
            raise api.CannotTell(f"service {name} cannot be called: {clean(called.problem)}")
        count = called.served if self.entry.call is not None else fact.services.get(name, 0)
        if count is None:
            raise api.CannotTell(f"the servers of {name} are unknown: {NOT_LISTED}")
        if not count:
            if fact.up_s < self.settings.ros.grace:
                raise api.CannotTell(f"service {name} has no server yet")
            return bad(f"service {name} has no server", f"no {last(name)}")
        return good(f"service {name} has a server") if self.entry.call is None else self._answer(name, called)

    def _answer(self, name: str, called: api.AnswerFact) -> Finding:
        unanswered_s, limit_s = round(called.unanswered_s, 1), max(self.entry.timeout, POLL_S)
        if called.unanswered_s >= limit_s:
            words = f"service {name} has not answered for {span(unanswered_s)}, expected within {span(limit_s)}"
            return bad(words, "no answer", unanswered_s=unanswered_s)
        if not called.answer:
            raise api.CannotTell(f"service {name} has not answered yet")
        detail = clean(called.detail)
        if called.answer != "true":
            return bad(f"service {name} answers success: false{f' ({detail})' if detail else ''}", "not successful")
        return good(f"service {name} answers{f': {detail}' if detail else ''}", unanswered_s=unanswered_s)
