"""The files of the page, read once: a path of a request is looked up, never opened."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

TYPES: Mapping[str, str] = {
    ".html": "text/html",
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".css": "text/css",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".woff2": "font/woff2",
    ".json": "application/json",
    ".webmanifest": "application/manifest+json",
    ".txt": "text/plain",
}
MAX_DEPTH = 4


@dataclass(frozen=True, slots=True)
class StaticFile:
    body: bytes
    content_type: str
    etag: str


def load() -> dict[str, StaticFile]:
    """All files of the page, by their path below `static`, with slashes."""
    return dict(_walk(Path(__file__).parent / "static", "", MAX_DEPTH))


def _walk(folder: Path, prefix: str, depth: int) -> list[tuple[str, StaticFile]]:
    found: list[tuple[str, StaticFile]] = []
    for entry in folder.iterdir():
        if entry.is_dir() and depth:
            found += _walk(entry, f"{prefix}{entry.name}/", depth - 1)
            continue
        kind = TYPES.get(entry.suffix)
        if kind is not None and entry.is_file():
            body = entry.read_bytes()
            found.append((f"{prefix}{entry.name}", StaticFile(body, kind, hashlib.sha256(body).hexdigest()[:32])))
    return found
