"""A campaign's report: JSON with all data, a self-contained HTML page, Markdown. Pure."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from phm.review import charts
from sitl.campaign import fault_rows, plots
from sitl.campaign.groups import Group, groups
from sitl.campaign.progress import progress
from sitl.campaign.sections import Section, problems, sections
from sitl.campaign.targets import evaluated
from sitl.campaign.trial import Trial
from sitl.campaign.verdict import Verdict

BEGIN, END = "<!-- campaign: begin, written by scripts/campaign --markdown -->", "<!-- campaign: end -->"
PAPER_LINES = (("paper: detection 5.2 s", 5.2), ("paper: response 14.82 s", 14.82))
WIDTH = 100
"""Columns of a document's lines."""
NOT_FIGURES = {"classes", "judged"}


def description(found: Sequence[Group]) -> str:
    """Which campaigns these are, in sentences: commit, day, machine, seeds, number of trials."""
    sentences = []
    for group in found:
        words = [" / ".join(str(value) for value in group.settings(key)) for key in ("day", "machine", "commit")]
        done = progress(group.trials)
        of = f" of {done.planned} planned" if done.missing else ""
        if done.words:
            sentences.append(f"{group.name}: {done.words.upper()}.")
        seeds = ", ".join(str(seed) for seed in group.settings("seed"))
        sentences.append(
            f"{group.name}: {words[0]}, {words[1]}, commit {words[2] or 'not recorded'}, seeds {seeds}, "
            f"autopilot {' / '.join(group.settings('autopilot')) or 'sim'}; {group.all.agents} agents, "
            f"{group.all.trials}{of} trials, {group.all.injected} faults injected."
        )
    return "\n".join(sentences) or "No trial was run."


def as_json(trials: Sequence[Trial]) -> str:
    """Targets, figures, one verdict for each fault, and the complete record of each trial."""
    found = groups(trials)
    return json.dumps(
        {
            "groups": [_group(group, found) for group in found],
            "problems": problems(found),
            "trials": [asdict(trial) for trial in trials],
        },
        indent=1,
    )


def _group(group: Group, others: Sequence[Group]) -> dict[str, Any]:
    return {
        "profile": group.profile,
        "load": group.load,
        "seeds": group.settings("seed"),
        "commits": group.settings("commit"),
        "metrics": [
            {
                "name": each.metric.name,
                "paper": each.metric.paper,
                "value": each.value,
                "over_seeds": _plain(each.estimate),
                "aim": each.aim,
                "met": each.met,
            }
            for each in evaluated(group, others)
        ],
        "figures": {
            each.name: _plain(getattr(group.all, each.name))
            for each in fields(group.all)
            if each.name not in NOT_FIGURES
        },
        "classes": [asdict(each) for each in group.all.classes],
        "verdicts": [
            {
                "seed": each.trial.campaign[2],
                "kind": each.trial.kind,
                "number": each.trial.number,
                **_verdict(verdict),
                "remarks": fault_rows.remarks(each, verdict),
            }
            for each in group.all.judged
            for verdict in each.verdicts
        ],
    }


def _verdict(verdict: Verdict) -> dict[str, Any]:
    names = ("detected_s", "logged_s", "response_s", "published_s", "listed_s", "claimed_s", "world_s", "recovered_s")
    return {
        "fault": verdict.injection.fault,
        "agent": verdict.injection.agent,
        **{name: getattr(verdict, name) for name in names},
        "by": verdict.by,
        "ended_by": verdict.ended_by,
        "alarms": [alarm.unit for alarm in verdict.alarms],
        "missed": verdict.missed,
        "wrong": verdict.wrong,
    }


def _plain(value: Any) -> Any:
    return asdict(value) if hasattr(value, "__dataclass_fields__") else value


def as_html(trials: Sequence[Trial]) -> str:
    """One file that needs no network, made of the parts of `phm report`. Needs jinja2."""
    found = groups(trials)
    parts = [
        *sections(found),
        *(
            Section(f"Every injected fault ({group.name})", "", fault_rows.FAULTS, fault_rows.faults(group))
            for group in found[1:]
        ),
    ]
    drawn = [chart for group in found for chart in _drawn(group)]
    return charts.render("PHM fault campaign", description(found).splitlines(), parts, drawn)


def _drawn(group: Group) -> list[charts.Chart]:
    """The plots of a group."""
    verdicts = group.all.verdicts

    def all_of(name: str) -> list[float]:
        return [value for each in verdicts if (value := getattr(each, name)) is not None]

    def per_class(name: str) -> list[tuple[str, list[float]]]:
        known = [(each.injection.title, value) for each in verdicts if (value := getattr(each, name)) is not None]
        return [(title, [value for other, value in known if other == title]) for title in sorted(dict(known))]

    curves = [
        ("detected", all_of("detected_s")),
        ("reported at the ground", all_of("response_s")),
        ("recovered", all_of("recovered_s")),
    ]
    return [
        plots.steps(f"Share of the faults within a time ({group.name})", curves, PAPER_LINES),
        plots.strips(
            f"Detection: seconds from injection to the log, one dot per fault ({group.name})",
            per_class("detected_s"),
            PAPER_LINES[:1],
        ),
        plots.strips(
            f"Recovery: seconds from injection until PHM and the world agree, one dot per fault ({group.name})",
            per_class("recovered_s"),
        ),
    ]


def as_markdown(trials: Sequence[Trial]) -> str:
    """The generated part of the page of results."""
    found = groups(trials)
    lines = [wrapped(line, "- ") for line in description(found).splitlines()]
    for section in sections(found):
        lines += ["", f"## {section.title}", ""]
        lines += [wrapped(section.words), ""] if section.words else []
        if section.head:
            lines += markdown_rows(section.head, section.rows) if section.rows else ["Nothing."]
        else:
            lines += [wrapped(each, "- ") for each in section.sentences or ["nothing"]]
    return "\n".join(lines)


def between_marks(page: str, text: str, begin: str = BEGIN, end: str = END) -> str:
    """`page` with the text between the two marks replaced. Raises ValueError when it has no marks."""
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"the page has no marks {begin} and {end}")
    return f"{before}{begin}\n{text}\n{end}{after}"


def wrapped(text: str, mark: str = "") -> str:
    """The text in lines of a document, after a list mark."""
    return textwrap.fill(
        _cell(text),
        WIDTH,
        initial_indent=mark,
        subsequent_indent=" " * len(mark),
        break_long_words=False,
        break_on_hyphens=False,
    )


def _cell(text: str) -> str:
    return text.replace("|", "/").replace("\n", " ").replace("<", "&lt;")


def markdown_rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The lines of a table."""
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return lines + [f"| {' | '.join(_cell(cell) for cell in row)} |" for row in rows]
