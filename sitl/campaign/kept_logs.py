"""Keeps PHM's log of the agents on which a trial had a problem: the swarm's logs are deleted with the swarm."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from sitl.campaign.fault_rows import remarks
from sitl.campaign.verdict import ScoredTrial
from sitl.harness.log_follower import Event


def folder_of(record: Path) -> Path:
    """Beside the record, e.g. `campaign-0123abcd-logs` of `campaign-0123abcd.jsonl`."""
    return record.with_name(f"{record.stem}-logs")


def keep(folder: Path, judged: ScoredTrial, events: Mapping[int, Sequence[Event]]) -> Path | None:
    """Write the events of each agent with a problem as `A03/phm.jsonl` in a folder of the trial, which `phm report` reads.
    Return that folder, or None if there was no problem. events: of the trial, by agent.
    """
    agents = sorted(_with_problems(judged) & events.keys())
    if not agents:
        return None
    trial = judged.trial
    setting = trial.setting
    kept = folder / f"{setting['profile']}-{setting['load']}-seed-{setting['index'] + 1}-{trial.kind}-{trial.number}"
    for agent in agents:
        file = kept / f"A{agent:02d}" / "phm.jsonl"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("".join(json.dumps(event) + "\n" for event in events[agent]), "utf-8")
    return kept


def _with_problems(judged: ScoredTrial) -> set[int]:
    """Agents with a fault that has remarks, or with a false alarm."""
    found = {verdict.injection.agent for verdict in judged.verdicts if remarks(judged, verdict)}
    return found | {alarm.agent for alarm in judged.false}
