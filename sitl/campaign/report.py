"""A campaign's report: JSON with all data, a self-contained HTML page, Markdown. Pure."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from dataclasses import asdict, fields
from html import escape
from typing import Any

from sitl.campaign import fault_rows, plots
from sitl.campaign.groups import Group, groups
from sitl.campaign.progress import progress
from sitl.campaign.sections import problems, sections
from sitl.campaign.targets import evaluated
from sitl.campaign.trial import Trial
from sitl.campaign.verdict import Verdict

BEGIN, END = "<!-- campaign: begin, written by scripts/campaign --markdown -->", "<!-- campaign: end -->"
PAPER_LINES = (("paper: detection 5.2 s", 5.2), ("paper: response 14.82 s", 14.82))
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; color: #1b1f24; background: #fff }
h1 { font-size: 1.5rem } h2 { font-size: 1.15rem; margin-top: 2rem }
table { border-collapse: collapse; margin: .5rem 0; font-variant-numeric: tabular-nums } .wide { overflow-x: auto }
th, td { border-bottom: 1px solid #d5dae0; padding: .2rem .6rem; text-align: left; vertical-align: top }
.met { color: #13672f } .missed { color: #a40e26; font-weight: 600 }
svg { width: 100%; height: auto; font: 12px system-ui, sans-serif; fill: #1b1f24 }
svg .grid { stroke: #e3e7eb } svg .mark { stroke: #9a6700; fill: #9a6700 } svg text.mark { stroke: none }
svg circle { fill: #0b61c4; fill-opacity: .55 } svg .curve { fill: none; stroke-width: 2 }
svg path.c0 { stroke: #0b61c4 } svg path.c1 { stroke: #b35900 } svg path.c2 { stroke: #13672f }
svg text.c0 { fill: #0b61c4 } svg text.c1 { fill: #b35900 } svg text.c2 { fill: #13672f }
"""
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
    found = groups(trials)
    parts = ["<h1>PHM fault campaign</h1>", *(f"<p>{escape(line)}</p>" for line in description(found).splitlines())]
    for section in sections(found):
        parts += [f"<h2>{escape(section.title)}</h2>", f"<p>{escape(section.words)}</p>" if section.words else ""]
        parts.append(_table(section.head, section.rows) if section.head else _list(section.sentences))
    for group in found:
        parts += _drawn(group)
    for group in found[1:]:
        parts += [
            f"<h2>Every injected fault ({escape(group.name)})</h2>",
            _table(fault_rows.FAULTS, fault_rows.faults(group)),
        ]
    body = "\n".join(part for part in parts if part)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>PHM fault campaign</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n'
    )


def _drawn(group: Group) -> list[str]:
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
        f"<h2>Times ({escape(group.name)})</h2>",
        plots.steps("Share of the faults within a time", curves, PAPER_LINES),
        "<h3>Detection: seconds from injection to the log, one dot per fault</h3>",
        plots.strips("Detection", per_class("detected_s"), PAPER_LINES[:1]),
        "<h3>Recovery: seconds from injection until PHM and the world agree, one dot per fault</h3>",
        plots.strips("Recovery", per_class("recovered_s")),
    ]


def as_markdown(trials: Sequence[Trial]) -> str:
    """The generated part of the page of results."""
    found = groups(trials)
    lines = [wrapped(line, "- ") for line in description(found).splitlines()]
    for section in sections(found):
        lines += ["", f"## {section.title}", ""]
        lines += [wrapped(section.words), ""] if section.words else []
        if section.head:
            lines += _rows(section.head, section.rows) if section.rows else ["Nothing."]
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


def _rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return lines + [f"| {' | '.join(_cell(cell) for cell in row)} |" for row in rows]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    titles = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = ["<tr>" + "".join(f"<td{_class(cell)}>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return f'<div class="wide"><table><tr>{titles}</tr>\n' + "\n".join(lines) + "</table></div>"


def _class(cell: str) -> str:
    if cell.endswith(": NOT met"):
        return ' class="missed"'
    return ' class="met"' if cell.endswith(": met") else ""


def _list(sentences: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(each)}</li>" for each in sentences or ["nothing"]) + "</ul>"
