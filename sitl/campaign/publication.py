"""Writes the result of a campaign into the project: the record, the page of results, and the figures of the README."""

from __future__ import annotations

import gzip
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sitl.campaign import seeds
from sitl.campaign.groups import Group, groups
from sitl.campaign.progress import progress
from sitl.campaign.report import as_markdown, between_marks, wrapped
from sitl.campaign.schedule import NOTED
from sitl.campaign.table import machine_cpu
from sitl.campaign.targets import percent
from sitl.campaign.trial import NOMINAL, Trial, load
from sitl.harness.compose_stack import ROOT

PAGE = Path("docs/development/results.md")
RECORD = Path("docs/development/results/campaign.jsonl.gz")
README = Path("README.md")
BEGIN, END = (
    "<!-- campaign figures: begin, written by scripts/campaign --markdown -->",
    "<!-- campaign figures: end -->",
)
DIGITS = 3
"""Milliseconds are enough."""


def publish(trials: Sequence[Trial], root: Path = ROOT) -> None:
    """Write the compressed record, then page and README from what was written, so that they can be reproduced. Raises
    ValueError, and writes nothing, when the record is not that of a campaign whose seeds follow from its commit.
    """
    check(trials, root)
    record = root / RECORD
    record.parent.mkdir(exist_ok=True)
    record.write_bytes(compressed(trials))
    written = load(record)
    page, readme = root / PAGE, root / README
    page.write_text(between_marks(page.read_text("utf-8"), as_markdown(written)), "utf-8")
    readme.write_text(between_marks(readme.read_text("utf-8"), for_readme(written), BEGIN, END), "utf-8")


def check(trials: Sequence[Trial], root: Path = ROOT) -> None:
    """Raise ValueError with the first run that may not be published."""
    commits = {str(trial.setting.get("commit", "")) for trial in trials}
    for commit in sorted(commits):
        check_commit(commit, root)
    for trial in trials:
        if trial.setting.get(NOTED):
            raise ValueError("not published: PHM noted the injections in its log (--note), which costs CPU time")
        seed, index = trial.setting.get("seed"), trial.setting.get("index")
        if index is None or seed != seeds.seed_of(str(trial.setting.get("commit", "")), index):
            raise ValueError(
                f"not published: the record has a run of seed {seed}, which does not follow from the commit as seed "
                f"{index}: it was chosen with --seed"
            )


def check_commit(commit: str, root: Path = ROOT) -> None:
    """Raise ValueError for a commit whose campaign may not be published."""
    if commit.endswith("-dirty"):
        raise ValueError(f"not published: the record is of {commit}, with changes that are in no commit")
    if not seeds.in_history(commit, root):
        raise ValueError(
            f"not published: the record is of commit {commit or 'unknown'}, which is not in the history of {root}"
        )


def compressed(trials: Sequence[Trial]) -> bytes:
    """The record with times in milliseconds; the same trials give the same bytes."""
    lines = [json.dumps(_rounded(asdict(trial)), allow_nan=False, separators=(",", ":")) for trial in trials]
    return gzip.compress("".join(f"{line}\n" for line in lines).encode("ascii"), mtime=0)


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return round(value, DIGITS)
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    return [_rounded(each) for each in value] if isinstance(value, list | tuple) else value


def for_readme(trials: Sequence[Trial]) -> str:
    """The paragraph of the README about the first profile and load."""
    found = groups(trials)
    return wrapped(_paragraph(found[0]) if found else "No campaign was run.")


def _paragraph(group: Group) -> str:
    detection, response = group.mean(lambda f: f.detection.mean), group.mean(lambda f: f.response.mean)
    logged, published = group.mean(lambda f: f.logged.mean), group.mean(lambda f: f.published.mean)
    done = progress(group.trials).words
    by_action, alarms = group.mean(lambda f: f.by_action), group.mean(lambda f: f.alarms_per_fault)
    sentences = [
        f"In a campaign of {group.all.injected} faults of every layer in a simulated swarm of {group.all.agents} agents "
        f"({_named(group)}; {len(group.seeds)} seeds), PHM detected a fault after "
        f"{_seconds(detection)} on average and reported it on the ground after {_seconds(response)}.",
        f"By the definitions of a published prototype, detection took {_seconds(logged)} (prototype: 5.2 s) and response "
        f"{_seconds(published)} (prototype: 14.82 s).",
        f"An action of PHM ended {'-' if by_action is None else percent(by_action.mean)} of the faults, confirmed from "
        "outside (prototype: 16.6 %).",
        f"There were {'-' if alarms is None else f'{alarms.mean:.2f}'} alarms per fault and {group.all.false} false "
        f"alarm{'' if group.all.false == 1 else 's'}, "
        f"beside {len(group.all.beside)} about the measured load of the machine, which the agents share. "
        f"{sum(verdict.missed for verdict in group.all.verdicts)} faults were missed. The times to detect are those of "
        f"{group.all.detection.n} faults, those to report of {group.all.response.n}.",
    ]
    return " ".join([f"The campaign is {done}." if done else "", *sentences]).strip()


def _named(group: Group) -> str:
    used = machine_cpu(group.all, NOMINAL)
    words = [
        f"{group.profile} configuration" if group.profile else "",
        {"quiet": "no other load"}.get(group.load, f"load: {group.load}") if group.load else "",
        f"{used:.0f} % of the machine's CPU in use with nothing injected" if used is not None else "",
    ]
    return ", ".join(word for word in words if word) or "one configuration"


def _seconds(found: Any) -> str:
    return "-" if found is None else f"{found.mean:.2f} s"
