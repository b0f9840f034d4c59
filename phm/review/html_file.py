"""One HTML file that needs no network: template, data, style, code and uPlot are in it.

All text reaches the page through the template's autoescape or as JSON that the code puts into text nodes. The
Content-Security-Policy allows exactly this style and this code, by their digests, and nothing from outside.
"""

from __future__ import annotations

import base64
import hashlib
import json
from importlib import resources
from typing import Any

UPLOT = "gcs/web/static/vendor"


def render(template: str, code: str, data: Any, **values: Any) -> str:
    """The file. template, code: names in `templates`. data: what the code reads, as JSON. values: of the template. Needs jinja2."""
    import jinja2

    loader = jinja2.FunctionLoader(_own)
    environment = jinja2.Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)
    style, script = _vendor("uPlot.min.css") + _own("page.css"), _vendor("uPlot.esm.js") + _own(code)
    policy = f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'; base-uri 'none'; form-action 'none'"
    return environment.get_template(template).render(
        **values, policy=policy, style=style, code=script, data=_inert(data)
    )


def _inert(data: Any) -> str:
    """The value as JSON that cannot end its HTML element."""
    text = json.dumps(data, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _own(name: str) -> str:
    return (resources.files("phm.review") / "templates" / name).read_text("utf-8")


def _vendor(name: str) -> str:
    text = (resources.files("phm") / UPLOT / name).read_text("utf-8")
    assert "</s" not in text, "code that ends its own element"
    return text
