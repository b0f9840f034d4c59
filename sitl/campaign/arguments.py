"""The options of `python -m sitl campaign`."""

from __future__ import annotations

import argparse
from pathlib import Path

from sitl.campaign.trial import BUSY, QUIET
from sitl.swarm.options import DEFAULT_NAME, PROFILES

SEEDS = 5
_EPILOG = """
examples:
  python -m sitl campaign                                        five seeds of this commit, as PHM is shipped
  python -m sitl campaign --plan                                 only what would be injected, and how often each fault
  python -m sitl campaign --profile as-found --keep              an application that knows nothing of PHM
  python -m sitl campaign --load busy                            all cores busy with other containers
  python -m sitl campaign --record campaign.jsonl --stop-after 3600    an hour of it; the same command goes on
  python -m sitl campaign --record campaign.jsonl --report-only --html page.html
  python -m sitl campaign --agents 2 --seed 1 --trials 4 --only node_killed container_killed    a quick try

See docs/development/campaign.md.
"""


def parser() -> argparse.ArgumentParser:
    words = argparse.ArgumentParser(
        prog="python -m sitl campaign",
        description="Inject faults into a swarm of simulated agents and measure how PHM handles them.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    _what(words.add_argument_group("what is injected"))
    _where(words.add_argument_group("into which swarm"))
    _output(words.add_argument_group("record and reports"))
    return words


def _what(group: argparse._ArgumentGroup) -> None:
    seeds = group.add_mutually_exclusive_group()
    seeds.add_argument(
        "--seeds", type=int, default=SEEDS, metavar="N", help=f"seeds, all derived from the commit id ({SEEDS})"
    )
    seeds.add_argument("--seed", type=int, metavar="S", help="instead: this one, for a try")
    group.add_argument("--commit", default="", metavar="ID", help="full commit id (that of this working tree)")
    group.add_argument(
        "--trials",
        type=int,
        metavar="N",
        help="of each seed (20, or as many as inject every fault three times, once as the only one of its agent)",
    )
    group.add_argument("--only", nargs="+", default=(), metavar="FAULT", help="draw from these faults alone")
    group.add_argument("--profile", choices=PROFILES, default="shipped", help="how much is configured (shipped)")
    group.add_argument("--load", choices=(QUIET, BUSY), default=QUIET, help="of the machine meanwhile (quiet)")
    group.add_argument(
        "--nominal", type=float, default=60.0, metavar="S", help="seconds of each seed with nothing injected (60)"
    )
    group.add_argument(
        "--note",
        action="store_true",
        help="have PHM note each injection in its own log, for `phm report`; it costs PHM CPU time, so the result cannot be published",
    )
    group.add_argument("--plan", action="store_true", help="only print what would be injected, and how often")


def _where(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--agents", type=int, default=8, metavar="N", help="agents of the swarm (8)")
    group.add_argument("--interval", type=float, default=20.0, metavar="S", help="PHM's reactivation interval (20)")
    group.add_argument("--autopilot", choices=("sim", "ardupilot", "px4"), default="sim", help="(sim)")
    group.add_argument("--autopilot-path", default="", metavar="FILE", help="of a real autopilot, as in `up`")
    group.add_argument("--autopilot-image", default="", metavar="IMAGE", help="of a real autopilot, as in `up`")
    group.add_argument("--name", default=DEFAULT_NAME, help=f"of the swarm ({DEFAULT_NAME}); one that is up is used")
    group.add_argument("--keep", action="store_true", help="leave the swarm up at the end")
    group.add_argument("--no-build", action="store_true", help="use the images that exist")


def _output(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--record",
        type=Path,
        metavar="FILE",
        help="trials, one per line; a campaign continues from it (campaign-COMMIT.jsonl; with --seed campaign-COMMIT-seed-S.jsonl)",
    )
    group.add_argument("--stop-after", type=float, metavar="S", help="begin no trial after this many seconds")
    group.add_argument("--report-only", action="store_true", help="only make the reports from the record")
    group.add_argument("--json", type=Path, metavar="FILE", help="write the report with everything in it")
    group.add_argument("--html", type=Path, metavar="FILE", help="write the report as a page")
    group.add_argument(
        "--markdown",
        action="store_true",
        help="write record and result into docs/development, and the figures of the README",
    )
    group.add_argument(
        "--incomplete", action="store_true", help="with --markdown: also while trials are missing, which the page says"
    )
