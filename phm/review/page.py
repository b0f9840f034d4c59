"""The report as one HTML file that needs no network."""

from __future__ import annotations

from typing import Any

from phm.review import html_file, tables
from phm.review.agent_row import UNITS_CUT
from phm.review.measurements import GROUPS
from phm.wire.report import clock_text

Json = dict[str, Any]
MOST_FAULTS = 3000
"""Maximum number of rows of the table; the JSON document has all faults."""
IN_FULL = (tables.FAULTS, tables.AVAILABILITY)
"""Tables of text that the page has as larger ones."""
MOST_OTHER = 5000
"""Maximum number of marks of other records."""


def render(document: Json) -> str:
    """The page as HTML. Needs jinja2."""
    return html_file.render(
        "page.html",
        "page.js",
        _data(document),
        report=document,
        title=_title(document),
        undrawn=max(0, len(document["other"]["rows"]) - MOST_OTHER),
        unlisted=max(0, len(document["faults"]) - MOST_FAULTS),
        tables=[table for table in tables.tables(document, most=500) if table[0] not in IN_FULL],
    )


def _marks(rows: list[Json]) -> list[Json]:
    """Those that are drawn: of too many those with a level, and as many others as there is room for."""
    places = sorted(range(len(rows)), key=lambda place: (not rows[place]["level"], place))[:MOST_OTHER]
    return [rows[place] for place in sorted(places)]


def _available(document: Json) -> list[list[Any]]:
    """Of all, the lowest first."""
    rows = [
        [row[key] for key in ("agent", "kind", "name", "availability", "error_s", "unknown_s")]
        for row in document["availability"]
    ]
    return sorted(rows, key=lambda row: 2.0 if row[3] is None else float(row[3]))


def _title(document: Json) -> str:
    flight = document["window"]["flight"]
    return f"PHM report, {f'flight {flight}, ' if flight else ''}{clock_text(document['window']['begin'])[:16]} UTC"


def _data(document: Json) -> Json:
    """What the code of the page needs. Times are seconds since the beginning."""
    begin, days = document["window"]["begin"], {clock_text(document["window"][key])[:10] for key in ("begin", "end")}
    faults = [
        {**fault, "lines": [[round(line["t"] - begin, 3), line["text"]] for line in fault["lines"]]}
        for fault in document["faults"][:MOST_FAULTS]
    ]
    plots = [
        {**plot, "points": [[round(t - begin, 1) for t, _ in plot["points"]], [value for _, value in plot["points"]]]}
        for plot in document["plots"]
    ]
    others = [
        [round(row["t"] - begin, 2), row["agent"], row["what"], row["text"], row["level"]]
        for row in _marks(document["other"]["rows"])
    ]
    return {
        "other": others,
        "window": document["window"],
        "dated": len(days) > 1,
        "agents": document["agents"],
        "faults": faults,
        "plots": plots,
        "groups": GROUPS,
        "units_cut": [[row["agent"], row["count"]] for row in document["cut"] if row["what"] == UNITS_CUT],
        "availability": _available(document),
    }
