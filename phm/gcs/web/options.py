"""Options of the page's server: its address, its tokens and its TLS files."""

from __future__ import annotations

import ipaddress
import os
import ssl
import stat
from dataclasses import dataclass, field
from pathlib import Path

MIN_TOKEN = 16
"""Least number of characters of a token."""
MAX_FILE = 10_000
VIEW, OPERATE = "view", "operate"


class OptionError(Exception):
    """The options do not fit together, or a file cannot be used; the message says what to do."""


@dataclass(frozen=True, slots=True)
class Tokens:
    """The tokens of both roles; empty: there is no such token."""

    view: str = ""
    operate: str = ""


@dataclass(frozen=True, slots=True)
class ListenOptions:
    """Where the server listens; call `check` before use. behind_proxy: a proxy in front of the server terminates TLS."""

    host: str = "127.0.0.1"
    port: int = 8080
    tokens: Tokens | None = field(default=None, repr=False)
    tls: ssl.SSLContext | None = None
    behind_proxy: bool = False

    @property
    def loopback(self) -> bool:
        return is_loopback(self.host)

    def check(self) -> ListenOptions:
        """Return these options if they are safe. Raises OptionError."""
        where = f"{self.host}:{self.port}"
        if not self.loopback and self.tokens is None:
            raise OptionError(
                f"{where} can be reached by other machines: add --token-file FILE, or listen on 127.0.0.1"
            )
        if not self.loopback and self.tls is None and not self.behind_proxy:
            raise OptionError(
                f"{where}: a token must not cross the network in the clear: add --tls-cert FILE and --tls-key FILE, or "
                "--behind-proxy if a proxy in front of it terminates TLS"
            )
        if self.behind_proxy and self.tokens is None:
            raise OptionError("--behind-proxy needs --token-file FILE: everyone who reaches the proxy reaches the page")
        return self


def is_loopback(host: str) -> bool:
    """Whether a name or an address is of this machine alone. Other names are not: anyone can let one point here."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def read_tokens(path: str) -> Tokens:
    """``view: TOKEN`` and ``operate: TOKEN``, one a line. Raises OptionError."""
    found: dict[str, str] = {}
    for number, line in enumerate(_private(path).splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        role, colon, token = (piece.strip() for piece in line.partition(":"))
        if not colon or role not in (VIEW, OPERATE) or role in found:
            raise OptionError(f"{path}:{number}: write 'view: TOKEN' or 'operate: TOKEN', each at most once")
        if len(token) < MIN_TOKEN or not token.isascii() or not token.isprintable() or " " in token:
            raise OptionError(
                f"{path}:{number}: a token has {MIN_TOKEN} or more printable ASCII characters without blanks; "
                "make one with: openssl rand -hex 16"
            )
        found[role] = token
    if not found:
        raise OptionError(f"{path}: the file contains no token: write 'view: TOKEN' or 'operate: TOKEN'")
    if found.get(VIEW) == found.get(OPERATE):
        raise OptionError(f"{path}: both roles have the same token")
    return Tokens(found.get(VIEW, ""), found.get(OPERATE, ""))


def tls_context(cert: str | None, key: str | None) -> ssl.SSLContext | None:
    """The TLS context of these files, None without files. Raises OptionError."""
    if cert is None and key is None:
        return None
    if cert is None or key is None:
        raise OptionError("--tls-cert and --tls-key must be given together")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_cert_chain(cert, key, password=_no_password)
    except ssl.SSLError as error:
        raise OptionError(
            f"--tls-cert {cert}, --tls-key {key}: expected a certificate and its private key, both in PEM format "
            f"({error.reason or error})"
        ) from None
    except (OSError, ValueError) as error:
        raise OptionError(f"--tls-cert {cert}, --tls-key {key}: {error}") from None
    return context


def _no_password() -> str:
    raise ValueError("the key is encrypted; give a key without a passphrase")


def _private(path: str) -> str:
    """The text of a file that others cannot read. Raises OptionError."""
    try:
        with Path(path).open("rb") as stream:
            mode = os.fstat(stream.fileno()).st_mode
            data = stream.read(MAX_FILE + 1)
    except OSError as error:
        raise OptionError(f"--token-file {path}: {error.strerror or error}") from None
    if not stat.S_ISREG(mode) or len(data) > MAX_FILE:
        raise OptionError(f"{path}: not a file of at most {MAX_FILE} bytes")
    if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise OptionError(f"{path}: other users can read the tokens; make it yours alone: chmod 600 {path}")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        raise OptionError(f"{path}: not a text file") from None
