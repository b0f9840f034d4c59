"""A real Prometheus server (Debian's package) with its own configuration and data, on loopback."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

from tests.fakes.until import until

PROMTOOL, PROMETHEUS = shutil.which("promtool"), shutil.which("prometheus")
MISSING = "tests/metrics needs Prometheus and promtool: apt-get install --no-install-recommends prometheus"


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


def promtool(*words: str, stdin: bytes = b"", folder: Path | None = None) -> str:
    """Its output; fails if it does not accept the input."""
    assert PROMTOOL, MISSING
    done = subprocess.run(
        [PROMTOOL, *words],
        input=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        timeout=120,
        cwd=folder,
        check=False,
    )
    said = done.stdout.decode()
    assert done.returncode == 0, said
    return said


@contextmanager
def page(text: bytes, content_type: str) -> Iterator[str]:
    """The HOST:PORT at which every scrape gets `text`."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", content_type)
            self.end_headers()
            self.wfile.write(text)

        def log_message(self, format: str, *args: object) -> None:
            """Nothing to stderr."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        Thread(target=server.serve_forever, name="page", daemon=True).start()
        try:
            yield f"127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()


class Prometheus:
    """Scrapes `targets`, pairs of job and HOST:PORT, every second. rules: files with rules."""

    def __init__(self, folder: Path, targets: dict[str, str], rules: tuple[Path, ...] = ()) -> None:
        assert PROMETHEUS, MISSING
        jobs = [{"job_name": job, "static_configs": [{"targets": [where]}]} for job, where in targets.items()]
        times = {"scrape_interval": "1s", "scrape_timeout": "1s", "evaluation_interval": "1s"}
        config = {"global": times, "scrape_configs": jobs, "rule_files": [str(path) for path in rules]}
        (folder / "prometheus.yml").write_text(json.dumps(config))  # JSON is YAML
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        self.log = folder / "prometheus.log"
        with self.log.open("wb") as log:
            self.process = subprocess.Popen(
                [
                    PROMETHEUS,
                    f"--config.file={folder / 'prometheus.yml'}",
                    f"--storage.tsdb.path={folder / 'data'}",
                    f"--web.listen-address=127.0.0.1:{port}",
                    "--storage.tsdb.retention.time=1h",
                ],
                stdout=log,
                stderr=log,
            )
        until(self._ready, "Prometheus", self.log.read_text)

    def query(self, text: str) -> list[dict[str, Any]]:
        """The result of a query now; fails if Prometheus does not accept it."""
        return list(self.get("query", query=text)["result"])

    def value(self, text: str) -> float | None:
        """The value of the first series; None: there is none."""
        found = self.query(text)
        return float(found[0]["value"][1]) if found else None

    def get(self, what: str, **parameters: str) -> Any:
        address = f"{self.url}/api/v1/{what}?{urllib.parse.urlencode(parameters)}"
        try:
            with urllib.request.urlopen(address, timeout=60) as response:
                answer = json.load(response)
        except urllib.error.HTTPError as error:
            raise AssertionError(f"{parameters}: {error.read().decode()}") from None
        assert answer["status"] == "success", answer
        return answer["data"]

    def errors(self) -> list[str]:
        """Why targets cannot be scraped now."""
        return [one["lastError"] for one in self.get("targets")["activeTargets"] if one["lastError"]]

    def close(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(60)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()

    def _ready(self) -> bool:
        assert self.process.poll() is None, self.log.read_text()
        try:
            with urllib.request.urlopen(f"{self.url}/-/ready", timeout=60) as response:
                return bool(response.status == 200)
        except OSError:
            return False
