"""The report as one HTML file that needs no network: data, style, code and uPlot are in it.

All text from records reaches the page through the template's autoescape or as JSON that the code puts into text nodes. The
Content-Security-Policy allows exactly this style and this code, by their digests, and nothing from outside.
"""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources
from typing import Any

from phm.review import tables
from phm.wire.report import clock_text

Json = dict[str, Any]
MOST_FAULTS = 3000
"""Rows of the table; the JSON document has all."""
MOST_OTHER = 5000
"""Marks of other records."""
UPLOT = "gcs/web/static/vendor"


def render(document: Json) -> str:
    """The page. Needs jinja2."""
    import jinja2

    loader = jinja2.FunctionLoader(_own)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    style = _vendor("uPlot.min.css") + _own("page.css")
    code = _vendor("uPlot.esm.js") + _own("page.js")
    policy = f"default-src 'none'; script-src '{_digest(code)}'; style-src '{_digest(style)}'; base-uri 'none'; form-action 'none'"
    return environment.get_template("page.html").render(
        report=document,
        title=_title(document),
        tables=[table for table in tables.tables(document, most=500) if table[0] != "Faults"],
        policy=policy,
        style=style,
        code=code,
        data=_data(document),
    )


def _title(document: Json) -> str:
    flight = document["window"]["flight"]
    return f"PHM report, {f'flight {flight}, ' if flight else ''}{clock_text(document['window']['begin'])[:16]} UTC"


def _data(document: Json) -> str:
    """What the code of the page needs, as JSON that cannot end its element. Times are seconds since the beginning."""
    begin = document["window"]["begin"]
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
        for row in document["other"]["rows"][:MOST_OTHER]
    ]
    shown = {
        "other": others,
        "window": document["window"],
        "agents": document["agents"],
        "faults": faults,
        "plots": plots,
    }
    text = json.dumps(shown, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _own(name: str) -> str:
    return (resources.files("phm.review") / "templates" / name).read_text("utf-8")


def _vendor(name: str) -> str:
    text = (resources.files("phm") / UPLOT / name).read_text("utf-8")
    assert "</s" not in text, "code that ends its own element"
    return text
