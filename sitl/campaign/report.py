"""A campaign's report: JSON with all data, a self-contained HTML page, Markdown. Pure."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from html import escape
from typing import Any

from sitl.campaign import plots, table
from sitl.campaign.metrics import Figures, figures
from sitl.campaign.targets import judged as aims_judged, short as aims_short
from sitl.campaign.trial import Trial

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


@dataclass(frozen=True)
class Setting:
    """The parameters of a campaign. `day` as 2026-01-01."""

    seed: int
    machine: str
    day: str
    autopilot: str = "sim"
    interval_s: float = 20.0
    planned: int = 0
    more: dict[str, Any] = field(default_factory=dict)

    @property
    def words(self) -> str:
        return f"{self.day}, {self.machine}, seed {self.seed}, autopilot {self.autopilot}"


def as_json(trials: Sequence[Trial], setting: Setting) -> str:
    """Parameters, targets, figures, one verdict for each fault, and the complete record of each trial."""
    found = figures(trials)
    scalars = {each.name: getattr(found, each.name) for each in fields(found) if each.name not in ("classes", "judged")}
    return json.dumps(
        {
            "setting": asdict(setting),
            "aims": [asdict(row) for row in aims_judged(found)],
            "figures": {name: _plain(value) for name, value in scalars.items()},
            "classes": [asdict(each) for each in found.classes],
            "verdicts": [
                {
                    "kind": each.trial.kind,
                    "number": each.trial.number,
                    "fault": verdict.injection.fault,
                    "agent": verdict.injection.agent,
                    "detected_s": verdict.detected_s,
                    "response_s": verdict.response_s,
                    "healed_s": verdict.healed_s,
                    "by": verdict.by,
                    "alarms": [alarm.unit for alarm in verdict.alarms],
                    "missed": verdict.missed,
                    "wrong": verdict.wrong,
                    "remarks": table.remarks(each, verdict),
                }
                for each in found.judged
                for verdict in each.verdicts
            ],
            "short": [*aims_short(found), *table.short(found.judged)],
            "trials": [asdict(trial) for trial in trials],
        },
        indent=1,
    )


def _plain(value: Any) -> Any:
    return asdict(value) if hasattr(value, "__dataclass_fields__") else value


def as_html(trials: Sequence[Trial], setting: Setting) -> str:
    found = figures(trials)
    verdicts = [verdict for each in found.judged if each.trial.kind == "trial" for verdict in each.verdicts]

    def per_class(name: str) -> list[tuple[str, list[float]]]:
        known = [(each.injection.title, value) for each in verdicts if (value := getattr(each, name)) is not None]
        return [
            (title, [value for other, value in known if other == title])
            for title in dict.fromkeys(sorted(t for t, _ in known))
        ]

    def all_of(name: str) -> list[float]:
        return [value for each in verdicts if (value := getattr(each, name)) is not None]

    curves = [
        ("detected", all_of("detected_s")),
        ("reported at the ground", all_of("response_s")),
        ("healed", all_of("healed_s")),
    ]
    parts = [
        f"<h1>PHM fault campaign</h1><p>{escape(setting.words)}. {escape(_done(found, setting))}</p>",
        "<h2>Beside the paper's Table 2</h2>",
        _table(table.TABLE2, table.table2(found, setting.interval_s)),
        "<h2>Further figures</h2>",
        _table(("figure", "value"), table.beyond(found)),
        "<h2>How soon</h2>",
        plots.steps("Share of the faults within a time", curves, PAPER_LINES),
        "<h2>Detection, one dot a fault</h2>",
        plots.strips("Seconds from injection to the log", per_class("detected_s"), PAPER_LINES[:1]),
        "<h2>Healing, one dot a fault</h2>",
        plots.strips("Seconds from injection to proven healing", per_class("healed_s")),
        "<h2>Classes of faults</h2>",
        _table(table.CLASSES, table.classes(found)),
        "<h2>What is not as it should be</h2>",
        _list([*aims_short(found), *table.short(found.judged)]),
        "<h2>Every injected fault</h2>",
        _table(table.TRIALS, table.trials(found.judged)),
    ]
    body = "\n".join(parts)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>PHM fault campaign</title>'
        f'<meta name="viewport" content="width=device-width"><style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n'
    )


def as_markdown(trials: Sequence[Trial], setting: Setting) -> str:
    found = figures(trials)
    lines = [
        f"{setting.words}. {_done(found, setting)}",
        "",
        *_rows(table.TABLE2, table.table2(found, setting.interval_s)),
        "",
    ]
    lines += [*_rows(("further figures", ""), table.beyond(found)), "", "## Classes of faults", ""]
    lines += ["Seconds; one row for each class that was injected.", "", *_rows(table.CLASSES, table.classes(found)), ""]
    lines += ["## What is not as it should be", ""]
    lines += [f"- {_cell(each)}" for each in [*aims_short(found), *table.short(found.judged)] or ["nothing"]]
    lines += ["", "## Every injected fault", "", *_rows(table.TRIALS, table.trials(found.judged))]
    return "\n".join(lines)


def between_marks(page: str, text: str) -> str:
    """`page` with the text between the two marks replaced. Raises ValueError when it has no marks."""
    head, begin, rest = page.partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page has no marks {BEGIN} and {END}")
    return f"{head}{BEGIN}\n{text}\n{END}{tail}"


def _done(found: Figures, setting: Setting) -> str:
    planned = f" of {setting.planned} planned" if setting.planned and setting.planned != found.trials else ""
    return f"{found.agents} agents, {found.trials}{planned} trials, {found.injected} faults injected."


def _cell(text: str) -> str:
    return text.replace("|", "/").replace("\n", " ").replace("<", "&lt;")


def _rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return lines + [f"| {' | '.join(_cell(cell) for cell in row)} |" for row in rows]


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    classes = {"met": ' class="met"', "NOT met": ' class="missed"'}
    titles = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = [
        "<tr>" + "".join(f"<td{classes.get(cell, '')}>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    ]
    return f'<div class="wide"><table><tr>{titles}</tr>\n' + "\n".join(lines) + "</table></div>"


def _list(sentences: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(each)}</li>" for each in sentences or ["nothing"]) + "</ul>"
