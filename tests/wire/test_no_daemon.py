"""What a command says where it finds no daemon."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.wire import control, status_file


def test_both_messages_name_the_command_for_a_container(tmp_path: Path) -> None:
    """On a vehicle PHM runs in a container, and `phm` is typed on the host first."""
    with pytest.raises(status_file.NoStatus, match=r"in a container: `docker compose exec phm phm status`$"):
        status_file.read(str(tmp_path))
    with pytest.raises(control.NoAnswer, match=r"in a container: `docker compose exec phm phm status`$"):
        control.ask(str(tmp_path), {"do": "ping"})
