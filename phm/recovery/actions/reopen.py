"""Close a MAVLink endpoint and open it again."""

from __future__ import annotations

import threading

from phm.core.model import Fault
from phm.facts import AutopilotFact
from phm.recovery.base import Action, ActionContext, ActionFailed, NotNeeded, Target, TargetKind

OPEN_S = 8.0
"""Timeout of a connection attempt: 5 s."""
FLOWS_S = 1.0
"""If data arrived within this time, the endpoint is not silent."""
PROMPT_S = 2.0
"""A live peer sends within this time after the connection is open: an autopilot sends one heartbeat a second. If data
come later, the peer recovered by itself."""
RADIO_S = 11.0
BOOT_S = 3.0
"""An autopilot reports its time since boot within this time, if it does."""
BEHIND_S = 2.0
"""An autopilot whose time since boot is behind by more than this has rebooted, or did not run meanwhile."""
POLL_S = 0.05


class Reopen(Action):
    """Close PHM's own end of a MAVLink endpoint that is open and silent, and open it again: a port with a stuck driver,
    or a connection that only one side considers open. A serial port keeps its DTR up meanwhile, so the hardware behind
    it is not reset."""

    name = "reopen"
    starts = False
    on_phm_itself = True
    deadline_s = OPEN_S + RADIO_S + 4.0

    def __init__(self) -> None:
        self._began = 0.0
        self._prompt = False
        """Data arrived soon on the new connection."""
        self._pilot: AutopilotFact | None = None
        """Uptime of the autopilot as known before."""

    def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
        if target.kind is not TargetKind.LINK:
            raise ActionFailed(
                f"reopen works on MAVLink endpoints, {target.name} is a {target.kind.value}: correct recovery.ladders"
            )
        link = target.key
        if _flows(link, context, FLOWS_S):
            return NotNeeded(f"data arrives by {link} again")
        self._began, self._pilot = context.clock.mono(), context.autopilot()
        if not context.reopen(link, OPEN_S):
            raise ActionFailed(f"the MAVLink endpoint {link} did not open again within {OPEN_S:g} s; PHM keeps trying")
        self._prompt = self._answers(link, _prompt_s(fault, context), context)
        return f"reopened the MAVLink endpoint {link}"

    def other_cause(self, target: Target, fault: Fault, context: ActionContext) -> str:
        """Whether a reboot or a stall of the autopilot, or a late answer, explains the recovery."""
        if not self._prompt:
            return "data arrived too late after the reopen to be its effect; the other side recovered by itself"
        before = self._pilot
        if before is None or before.link != target.key:
            return ""
        return self._behind(before, context)

    def _answers(self, link: str, within_s: float, context: ActionContext) -> bool:
        opened = context.clock.mono()
        while context.clock.mono() - opened < within_s:
            context.clock.wait(threading.Event(), POLL_S)
            if _flows(link, context, context.clock.mono() - opened):
                return True
        return False

    def _behind(self, before: AutopilotFact, context: ActionContext) -> str:
        """Compares the autopilot's time since boot with its expected value, once it has reported it. Without that nothing
        shows that the autopilot ran all the time."""
        end = context.clock.mono() + BOOT_S
        while context.clock.mono() < end:
            now, elapsed_s = context.autopilot(), context.clock.mono() - self._began
            if now is not None and now.reboots > before.reboots:
                ran = f", and has been running for {now.boot_s:.0f} s" if now.boot_s is not None else ""
                return f"the autopilot has rebooted{ran}"
            if before.boot_s is None:
                return ""
            if now is not None and now.boot_s is not None and (now.boot_age_s or 0.0) < elapsed_s:
                behind_s = before.boot_s + elapsed_s - now.boot_s
                return f"the autopilot did not run for {behind_s:.0f} s" if behind_s > BEHIND_S else ""
            context.clock.wait(threading.Event(), POLL_S)
        return (
            f"the autopilot has not reported its time since boot for {BOOT_S:g} s, so it may have hung or rebooted "
            "(see mavlink.request_boot_time)"
        )


def _prompt_s(fault: Fault, context: ActionContext) -> float:
    """A radio sends one report for each heartbeat from its own side."""
    if fault.result.condition != "radio_silent":
        return PROMPT_S
    return max(PROMPT_S, min(context.settings.heartbeat_s + 1.0, RADIO_S))


def _flows(link: str, context: ActionContext, within_s: float) -> bool:
    fact = context.link(link)
    return fact is not None and fact.open and fact.rx_age_s is not None and fact.rx_age_s < within_s
