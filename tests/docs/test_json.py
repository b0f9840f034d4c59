"""JSON of the documents: an event has the keys of the code, and PHM does what a button of QGroundControl says."""

from __future__ import annotations

import json
from typing import Any

import pytest

from phm.wire.command import CommandResult
from tests.commands.test_mavlink_commands import Scene, long
from tests.docs.blocks import Block, blocks
from tests.docs.story import play

BUTTONS = {("look",): "Run all checks", ("restart", "app"): "Restart the first container"}
"""What the scene did, and the words of the document."""


def objects(value: Any) -> list[dict[str, Any]]:
    """All objects in a JSON value."""
    if isinstance(value, list):
        return [found for item in value for found in objects(item)]
    if isinstance(value, dict):
        return [value, *(found for item in value.values() for found in objects(item))]
    return []


def pressed(button: dict[str, Any]) -> str:
    """What PHM does when an operator presses a button of QGroundControl, in the words of the document."""
    assert set(button) - {"param2"} == {"label", "description", "mavCmd", "compId", "param1"}
    scene = Scene("check", "restart")
    request = long(button["mavCmd"], button["param1"], button.get("param2", 0), to=(7, button["compId"]))
    assert scene.result(request) is CommandResult.ACCEPTED
    (done,) = scene.did
    return BUTTONS[tuple(done.split()[:2])]


@pytest.mark.parametrize("block", blocks("json"), ids=str)
def test_a_json_block_has_the_keys_of_the_code(block: Block) -> None:
    """An event has exactly the keys that the log writes for it; a button of QGroundControl does what it says."""
    keys = {str(line["event"]): set(line) for line in play().record}
    examined = [found for found in objects(json.loads(block.text)) if {"event", "mavCmd"} & set(found)]
    assert examined or block.generated, f"{block}: neither an event nor a button"
    for found in examined:
        if "event" in found:
            assert set(found) == keys[found["event"]], str(block)
        if "mavCmd" in found:
            assert pressed(found) == found["description"], str(block)
