"""Make all pictures of README and docs again: `scripts/demo --pictures [FOLDER]`, by default docs/pictures.

Real agents, real faults, a real terminal and a real browser; the machine should be quiet. Needs Chromium, but neither Docker nor ROS.
Uses loopback alone, and the default port of `phm gcs`. A picture that would not show what its caption says ends the program.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from phm.simulation.demo import DemoPorts
from tests.docs.pictures import catalog, terminal_pictures
from tests.docs.pictures.agents import free_ports
from tests.gcs.web.browser import pictures as page_pictures
from tests.gcs.web.browser.scene import chromium


def main(folder: Path) -> None:
    """Write each picture into this folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as terminals, tempfile.TemporaryDirectory() as grounds:
        terminal_pictures.take(Path(terminals), folder, free_ports(DemoPorts().ground), DemoPorts())
        with chromium() as browser:
            page_pictures.take(browser, Path(grounds), folder)
    catalog.check_files(folder, catalog.PICTURES)
    for name in catalog.PICTURES:
        sys.stdout.write(f"{folder / name}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else catalog.FOLDER)
