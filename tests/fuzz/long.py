"""The long mode of the fuzz targets: each in turn for its share of the time, with new seeds. `scripts/fuzz` runs it."""

from __future__ import annotations

import argparse
import importlib
import logging
import random
import sys
import time
import traceback
from pathlib import Path

import click

from tests.fuzz.targets import TARGETS, Target

ROUND = 500
"""Cases of one seed."""
WITH_ROS = "tests.ros.test_beacon_fuzz"
"""Imports messages of ROS, so it is not among those that run on every Python."""
MAX_FAILURES = 3
"""Of one target, after which it is left: most are the same."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="scripts/fuzz", description=__doc__)
    parser.add_argument("minutes", nargs="?", type=float, default=10.0, help="for all targets together (default: 10)")
    parser.add_argument("--only", action="append", default=[], metavar="TARGET", help="may be given several times")
    parser.add_argument("--seed", type=int, help="one round of each target with this seed, to see a failure again")
    options = parser.parse_args()
    for module in (WITH_ROS, *(f"tests.fuzz.{file.stem}" for file in sorted(Path(__file__).parent.glob("test_*.py")))):
        importlib.import_module(module)
    unknown = sorted(set(options.only) - TARGETS.keys())
    if unknown:
        parser.error(f"there is no target {', '.join(unknown)}; there are: {', '.join(TARGETS)}")
    logging.disable()  # log messages about hostile data are not tested
    chosen = [target for name, target in TARGETS.items() if not options.only or name in options.only]
    share_s = options.minutes * 60 / len(chosen)
    failures = {target.name: _fuzz(target, share_s, options.seed) for target in chosen}
    click.echo(f"\n{'target':24} {'cases':>9} {'failures':>9}")
    for target in chosen:
        click.echo(f"{target.name:24} {target.cases:9} {failures[target.name]:9}")
    click.echo(f"{'together':24} {sum(target.cases for target in chosen):9} {sum(failures.values()):9}")
    return 1 if any(failures.values()) else 0


def _fuzz(target: Target, share_s: float, only_seed: int | None) -> int:
    """Run rounds until the time is over; return how many failed."""
    end, found = time.monotonic() + share_s, 0
    while found < MAX_FAILURES:
        number = random.SystemRandom().getrandbits(32) if only_seed is None else only_seed
        try:
            target.run(number, ROUND)
        except BaseException as error:
            if isinstance(error, (KeyboardInterrupt, SystemExit)):
                raise
            found += 1
            _report(target, number, error)
        if only_seed is not None or time.monotonic() >= end:
            break
    click.echo(f"{target.name}: {target.cases} cases, {found} failures", err=True)
    return found


def _report(target: Target, number: int, error: BaseException) -> None:
    click.echo(f"\n{target.name} FAILED; again: scripts/fuzz --only '{target.name}' --seed {number}")
    click.echo("".join(traceback.format_exception(error)))


if __name__ == "__main__":
    sys.exit(main())
