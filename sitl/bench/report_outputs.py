"""What two outputs of `phm report` cost: MTBF and MTTR over a dataset of many flights, and the page of many agents.

The records are generated (`sitl.bench.report_records`), and removed after each measurement.
"""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from sitl.bench import report_records
from sitl.bench.report_run import run

FLIGHT_S, PAGE_S = 1800.0, 3600.0
AGENTS = 8
"""Of the flights of a dataset, in turn."""
BATCH = 100
"""Flights that are added to the dataset together."""
QUERIES, OPENED = 3, 5
"""Number of repetitions; the median is the result."""
CHROMIUM = "/usr/bin/chromium"


@dataclass(frozen=True)
class Dataset:
    """text_bytes: of the records. files, disk_bytes: of the dataset. write_s: to read the records and write the dataset, of all flights
    together. query_s: MTBF and MTTR of all checks."""

    flights: int
    text_bytes: int
    files: int
    disk_bytes: int
    faults: int
    write_s: float
    query_s: float


@dataclass(frozen=True)
class Page:
    """time_s: of `phm report --html`, from start to end. open_s: from the address to the drawn page; None: there is no browser."""

    agents: int
    text_bytes: int
    page_bytes: int
    time_s: float
    open_s: float | None


def dataset(flights: int, made: list[report_records.Line], where: Path, batch: int = BATCH) -> Dataset:
    """made: the lines of one flight. Raises SystemExit if the dataset has not all of them."""
    from phm.review import parquet, record, record_reader

    text_bytes, write_s = 0, 0.0
    with tempfile.TemporaryDirectory(prefix="phm-bench-report-", dir=where) as name:
        logs, folder = Path(name) / "logs", Path(name) / "set"
        for first in range(0, flights, batch):
            for number in range(first, min(first + batch, flights)):
                text_bytes += _log(logs / str(number), made, number % AGENTS + 1, number // AGENTS + 1)
            began = time.monotonic()
            parquet.write(record.build(record_reader.read(record_reader.find([str(logs)]))), str(folder))
            write_s += time.monotonic() - began
            shutil.rmtree(logs)
        times = []
        for _ in range(QUERIES):
            began = time.monotonic()
            rates = parquet.rates(str(folder))
            times.append(time.monotonic() - began)
        if {row["runs"] for row in rates} != {flights}:
            raise SystemExit(f"the dataset has {sorted({row['runs'] for row in rates})} of {flights} flights")
        files = list(folder.rglob("*.parquet"))
        disk_bytes, faults = sum(path.stat().st_size for path in files), sum(row["faults"] for row in rates)
    return Dataset(flights, text_bytes, len(files), disk_bytes, faults, write_s, statistics.median(times))


def page(
    agents: int, made: list[report_records.Line], where: Path, look: Callable[[Path], list[float]] | None = None
) -> Page:
    """made: the lines of one agent. look: opens a page and returns seconds; default: in Chromium."""
    with tempfile.TemporaryDirectory(prefix="phm-bench-report-", dir=where) as name:
        logs, file = Path(name) / "logs", Path(name) / "page.html"
        text_bytes = sum(_log(logs / str(agent), made, agent, 1) for agent in range(1, agents + 1))
        with open(os.devnull, "wb") as output:
            time_s, _ = run([str(logs), "--html", str(file)], output.fileno())
        times = (look or opened)(file)
        open_s = statistics.median(times) if times else None
        return Page(agents, text_bytes, file.stat().st_size, time_s, open_s)


def opened(file: Path) -> list[float]:
    """Seconds from the address to the drawn page in Chromium, each time in a new tab; none: it is not installed."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return []
    if not Path(CHROMIUM).exists():
        return []
    found = []
    with sync_playwright() as programs:
        browser = programs.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for _ in range(OPENED):
            tab = browser.new_page(viewport={"width": 1300, "height": 900})
            began = time.monotonic()
            tab.goto(file.as_uri())
            tab.wait_for_selector("html[data-ready=yes]", state="attached")
            # The second frame begins when the first one, with everything, is drawn.
            tab.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
            found.append(time.monotonic() - began)
            tab.close()
        browser.close()
    return found


def _log(folder: Path, made: list[report_records.Line], agent: int, number: int) -> int:
    """One run of one agent. Returns its bytes."""
    folder.mkdir(parents=True)
    path = folder / "phm.jsonl"
    with path.open("wb") as stream:
        for line in report_records.lines(made, agent, number):
            stream.write(line)
    return path.stat().st_size


def text(row: Dataset | Page) -> str:
    """A sentence for docs/reference/report.md."""
    if isinstance(row, Dataset):
        return (
            f"{row.flights} flights of {FLIGHT_S / 60:g} min ({row.text_bytes / 1e6:.0f} MB of records, {row.faults} faults): dataset of "
            f"{row.files} files and {row.disk_bytes / 1e6:.1f} MB, written in {row.write_s:.1f} s; MTBF and MTTR in {row.query_s:.2f} s"
        )
    shown = "no Chromium to open it" if row.open_s is None else f"drawn in Chromium after {row.open_s:.2f} s"
    return (
        f"{row.agents} agents for {PAGE_S / 3600:g} h ({row.text_bytes / 1e6:.0f} MB of records): page of {row.page_bytes / 1e6:.2f} MB in "
        f"{row.time_s:.1f} s; {shown}"
    )
