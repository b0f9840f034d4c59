"""Type `http`: a web server answers a GET request as expected."""

from __future__ import annotations

import json
from typing import Any

from phm import api
from phm_checks._custom.base import CustomCheck, Finding, bad, good

_MISSING = object()


class Http(CustomCheck):
    """Compares status, body, and a field of a JSON body."""

    def observe(self, world: api.World) -> Finding:
        entry = self.entry
        url = entry.url.partition("?")[0]  # what follows may be a key
        fact = world.sockets.get(
            entry.url, timeout_s=entry.timeout, pattern=entry.body or "", verify_tls=entry.verify_tls
        )
        if fact.problem:
            return bad(f"{url}: {fact.problem}, expected an answer", "no answer")
        values = {"status": fact.status, "took_s": round(fact.took_s, 3)}
        if fact.status not in entry.status:
            leads = f" to {fact.location[:100]}" if fact.location else ""
            wanted = ", ".join(map(str, entry.status))
            return bad(f"{url} answers {fact.status}{leads}, expected {wanted}", f"HTTP {fact.status}", **values)
        if not fact.found:
            return bad(f"{url}: the body does not match {entry.body!r}", "wrong content", **values)
        problem = self._field(fact.body) if entry.json_field else ""
        if problem:
            return bad(f"{url}: {problem}", "wrong content", **values)
        return good(f"{url} answers {fact.status}", **values)

    def _field(self, body: str) -> str:
        """What is wrong with the field; empty: nothing."""
        name, wanted = self.entry.json_field, self.entry.equals
        try:
            value = _at(json.loads(body), name.split("."))
        except (ValueError, RecursionError):
            return "the body is not JSON"
        if value is _MISSING:
            return f"the body has no field {name!r}"
        if wanted is None:
            return f"{name} is {json.dumps(value)}, expected a value" if value is None or value is False else ""
        same = value == wanted and isinstance(value, bool) == isinstance(wanted, bool)
        return "" if same else f"{name} is {json.dumps(value)[:80]}, expected {json.dumps(wanted)}"


def _at(value: Any, path: list[str]) -> Any:
    for key in path:
        if isinstance(value, dict):
            value = value.get(key, _MISSING)
        elif isinstance(value, list) and key.isdecimal() and int(key[:6]) < len(value):
            value = value[int(key[:6])]
        else:
            return _MISSING
    return value
