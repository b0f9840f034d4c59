"""Removes secrets from text and from JSON, and counts what was removed. It removes too much rather than too little.

What counts as a secret: values of names such as `API_TOKEN` or `password`, credentials, tokens and paths in URLs of alerts, private
keys, and every value that was announced with `learn`, wherever it appears.
"""

from __future__ import annotations

import ipaddress
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any
from urllib.parse import quote, unquote, urlsplit

REMOVED = "<removed>"
MOST_KNOWN = 2000
SHORTEST = 6
"""Characters of a value that is removed wherever it appears; a shorter one is removed in its own place only."""
MOST_LINE = 20_000
LONGEST = 4000
"""Characters of a known value. This many are cut off after a cut, where the first part of a secret could be."""
MOST_KEY_LINES = 200
"""Of a private key: a key without an end does not hide the rest of a log."""
_PARTS = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
_SECRET_PARTS = frozenset(
    (
        "key",
        "keys",
        "pass",
        "passwd",
        "pwd",
        "pw",
        "auth",
        "authorization",
        "cookie",
        "dsn",
        "webhook",
        "psk",
        "pin",
        "otp",
    )
)
_SECRET_PIECES = ("passw", "passphrase", "secret", "token", "apikey", "credential", "privatekey", "accesskey")
_WORD = r"(?:passw|passphrase|secret|token|api[_-]?key|credential|private[_-]?key|access[_-]?key|signing[_-]?key)"
_NAME = rf"(?:{_WORD}[\w.\-]{{0,40}}|(?<![A-Za-z0-9])(?:key|pwd|pass|psk|auth|cookie|webhook))"
_VALUE = r"""(?:\\"[^"\\]*\\?"?|"(?:[^"\\]|\\.)*"?|'[^']*'?|[^\s,;&"'}\]]+)"""
_NO_DIRECTORY = r"(?!(?<!\w)(?-i:PWD)=/)"
"""Not before the current directory of a shell."""
_NAMED = re.compile(
    rf"""{_NO_DIRECTORY}({_NAME}\\?["']?\s{{0,4}}[=:]\s{{0,4}})(?!<removed>)({_VALUE})""", re.IGNORECASE
)
_OPTION = re.compile(rf"""(-[\w\-]{{0,40}}?{_NAME}\s{{1,4}})(?!<removed>|-)({_VALUE})""", re.IGNORECASE)
_HEADER = re.compile(r"(authorization\\?[\"']?\s{0,4}[=:]\s{0,4}\\?[\"']?)[^\s\"'\\]+(?:\s[^\s\"'\\]+)?", re.IGNORECASE)
_BEARER = re.compile(r"(\bbearer\s{1,4})[\w.~+/=\-]{4,}", re.IGNORECASE)
_USER = re.compile(r"([a-z][a-z0-9+.\-]{0,20}://)[^/\s@\"'<>]{1,512}@", re.IGNORECASE)
_PEM = re.compile(r"-----BEGIN [A-Z ]*PRIVATE KEY-----")
_PEM_END = re.compile(r"-----END [A-Z ]*PRIVATE KEY-----")
_URL = re.compile(r"\b([a-z][a-z0-9+.\-]{0,20})://([^\s\"'<>]*)", re.IGNORECASE)
_HARMLESS = frozenset(("unix", "tcp", "file", "udp", "npipe"))
_HINT = re.compile(r"pass|secret|token|key|credential|auth|bearer|cookie|pwd|psk|webhook|://|-----BEGIN", re.IGNORECASE)


def is_secret(name: str, value: object = None) -> bool:
    """Whether the name of a variable, key or option says that its value is secret. PWD with a path is the directory of a shell."""
    if name == "PWD" and isinstance(value, str) and value.startswith("/"):
        return False
    parts = [part.lower() for part in _PARTS.findall(name[:200])]
    joined = "".join(parts)
    return any(piece in joined for piece in _SECRET_PIECES) or not _SECRET_PARTS.isdisjoint(parts)


class Secrets:
    """First `learn` every known value; then clean. `removed` counts by (where, what); values are never in it."""

    def __init__(self) -> None:
        self.removed: Counter[tuple[str, str]] = Counter()
        self._known: dict[str, str] = {}
        self._pattern: re.Pattern[str] | None = None

    # ------------------------------------------------------------ learning

    def learn(self, value: str, what: str) -> None:
        """Remove this value wherever it appears, each of its lines, also escaped as in JSON or in a URL."""
        for line in {value, *value.splitlines()}:
            text = line.strip()
            if not SHORTEST <= len(text) <= LONGEST or text.lower() in ("true", "false", "none", "null"):
                continue
            for form in (text, json.dumps(text)[1:-1], quote(text, safe=""), quote(text), unquote(text)):
                if len(self._known) < MOST_KNOWN:
                    self._known.setdefault(form, what)
        self._pattern = None

    def learn_url(self, url: str, what: str) -> None:
        """The URL of an alert, and each part of it that can be a token."""
        self.learn(url, what)
        try:
            parts = urlsplit(url)
            host = parts.hostname or ""
        except ValueError:
            return
        pieces = re.split(
            r"[/?&=:@,#]", f"{parts.netloc.rpartition('@')[0]}/{parts.path}/{parts.query}/{parts.fragment}"
        )
        for piece in pieces:
            if len(piece) >= 8:
                self.learn(piece, what)
        if len(host) >= 12 and "." not in host and not _is_address(host):
            where = url.lower().find(host)
            self.learn(url[where : where + len(host)], what)

    def learn_environment(self, variables: Iterable[str], where: str) -> None:
        """Learn the secrets in entries such as ``API_TOKEN=abc``."""
        for entry in variables:
            name, _, value = entry.partition("=")
            if is_secret(name, value):
                self.learn(value, f"value of {name} ({where})")
            for match in _USER.finditer(value):
                self.learn(match[0].partition("://")[2][:-1].rpartition(":")[2], f"password in {name} ({where})")

    def learn_tree(self, tree: Any, where: str) -> None:
        """Values under secret names in what YAML or JSON gave."""
        if isinstance(tree, dict):
            for key, value in tree.items():
                if is_secret(str(key), value) or (key == "value" and is_secret(str(tree.get("name", "")), value)):
                    for text in _texts(value):
                        self.learn(text, f"value of {key} ({where})")
                self.learn_tree(value, where)
        elif isinstance(tree, list):
            self.learn_environment((entry for entry in tree if isinstance(entry, str)), where)
            for entry in tree:
                self.learn_tree(entry, where)

    # ------------------------------------------------------------ cleaning

    def clean_json(self, value: Any, where: str) -> Any:
        """The same structure with secrets replaced: by name, `NAME=VALUE`, option, URL, known value."""
        if isinstance(value, dict):
            return {
                self.clean(str(key), where): self._named(where, str(key), entry)
                if is_secret(str(key), entry) and isinstance(entry, (str, int)) and entry not in ("", True, False)
                else self.clean_json(entry, where)
                for key, entry in value.items()
            }
        if isinstance(value, list):
            made, before = [], ""
            for entry in value:
                option = before.startswith("-") and "=" not in before and is_secret(before) and isinstance(entry, str)
                made.append(self._named(where, before, entry) if option else self.clean_json(entry, where))
                before = entry if isinstance(entry, str) else ""
            return made
        if not isinstance(value, str):
            return value
        name, sign, rest = value.partition("=")
        if sign and rest and is_secret(name, rest) and not re.search(r"\s", name):
            return f"{name}={self._named(where, name.lstrip('-'), rest)}"
        return self.clean_urls("\n".join(self.clean_lines(value.split("\n"), where)), where)

    def clean_lines(self, lines: Iterable[str], where: str) -> Iterable[str]:
        """Each line without secrets, also in private keys of several lines."""
        inside = 0
        for line in lines:
            if inside:
                inside = 0 if _PEM_END.search(line) else inside - 1
                continue
            if _PEM.search(line):
                inside = 0 if _PEM_END.search(line) else MOST_KEY_LINES
                self._count(where, "private key", 1)
                yield REMOVED
                continue
            yield self.clean(line, where)

    def clean(self, line: str, where: str) -> str:
        """One line. One of MOST_LINE characters and more is cut."""
        if len(line) < MOST_LINE:
            return self._clean(line, where)
        return self._clean(line[:MOST_LINE], where)[:-LONGEST] + "[cut]"

    def clean_event(self, line: str, where: str) -> str:
        """A line of JSON by its structure; a torn one as text."""
        try:
            event = json.loads(line) if len(line) < MOST_LINE else None
            return (
                json.dumps(self.clean_json(event, where), separators=(",", ":")) if event else self.clean(line, where)
            )
        except (ValueError, RecursionError):
            return self.clean(line, where)

    def _clean(self, line: str, where: str) -> str:
        if self._known:
            if self._pattern is None:
                known = sorted(self._known, key=len, reverse=True)
                self._pattern = re.compile("|".join(map(re.escape, known)))
            line = self._pattern.sub(lambda match: self._known_value(where, match[0]), line)
        if not _HINT.search(line):
            return line
        for pattern, what, by in (
            (_USER, "credentials in a URL", rf"\1{REMOVED}@"),
            (_HEADER, "authorization header", rf"\1{REMOVED}"),
            (_BEARER, "bearer token", rf"\1{REMOVED}"),
            (_NAMED, "value with a secret's name", rf"\1{REMOVED}"),
            (_OPTION, "value of an option with a secret's name", rf"\1{REMOVED}"),
        ):
            line, count = pattern.subn(by, line)
            self._count(where, what, count)
        return line

    def clean_urls(self, text: str, where: str) -> str:
        """Also what is behind the host of each web address, and all of other URLs: the place of tokens in URLs of alerts."""
        return _URL.sub(lambda match: self._url(where, match), text)

    def _url(self, where: str, match: re.Match[str]) -> str:
        scheme, rest = match[1], match[2]
        if scheme.lower() in _HARMLESS:
            return match[0]
        host, slash, behind = rest.partition("/")
        if scheme.lower() in ("http", "https"):
            if not behind and "?" not in host:
                return match[0]
            host = host.partition("?")[0].rpartition("@")[2]
            self._count(where, "path of a URL", 1)
            return f"{scheme}://{host}{slash or '/'}{REMOVED}"
        self._count(where, "URL", 1)
        return f"{scheme}://{REMOVED}"

    def _named(self, where: str, name: str, _value: object) -> str:
        self._count(where, f"value of {name.lstrip('-')[:80]}", 1)
        return REMOVED

    def _known_value(self, where: str, found: str) -> str:
        self._count(where, self._known[found], 1)
        return REMOVED

    def _count(self, where: str, what: str, count: int) -> None:
        if count:
            self.removed[where, what] += count


def listed(removed: Mapping[tuple[str, str], int]) -> list[str]:
    """What was removed, as sentences for REMOVED.txt and the terminal."""
    return [
        f"{where}: {what}, {count} time{'s' if count > 1 else ''}" for (where, what), count in sorted(removed.items())
    ]


def _texts(value: Any) -> Iterable[str]:
    if isinstance(value, dict):
        for entry in value.values():
            yield from _texts(entry)
    elif isinstance(value, list):
        for entry in value:
            yield from _texts(entry)
    elif value is not None and not isinstance(value, bool):
        yield str(value)


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return host == "localhost"
    return True
