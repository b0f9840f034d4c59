"""After a reload the commands from before are known, and requested messages continue."""

from __future__ import annotations

from phm.commands.mavlink_commands import MavlinkCommands
from phm.testing import settings
from phm.wire.command import CommandResult
from tests.commands.test_mavlink_commands import ALL, Scene, long


def reload(scene: Scene) -> None:
    """Another handler on the same links."""
    before, chosen = scene.handler, settings(agent={"id": 7}, mavlink={"commands": ALL})
    scene.handler = MavlinkCommands(scene, before._handler, before._services, chosen.mavlink, 7, scene.clock)
    scene.handler.resume(before)


def test_a_command_is_not_executed_again_after_a_reload() -> None:
    """The ground station repeats it, because the acknowledgement was lost."""
    scene = Scene(*ALL)
    assert scene.result(long(31010, 3, 1)) is CommandResult.ACCEPTED
    done = list(scene.did)
    assert done
    reload(scene)
    assert scene.result(long(31010, 3, 1, again=1)) is CommandResult.ACCEPTED
    assert scene.did == done


def test_requested_messages_continue_after_a_reload() -> None:
    """Ground stations request them once. They can still be stopped."""
    scene = Scene(*ALL)
    assert scene.result(long(511, 253, 5e6)) is CommandResult.ACCEPTED
    scene.handler.tick()
    reload(scene)
    scene.sent.clear()
    scene.clock.advance(5.0)
    scene.handler.tick()
    assert [message.get_type() for message, _link in scene.sent] == ["STATUSTEXT"]
    assert scene.result(long(511, 253, -1)) is CommandResult.ACCEPTED
    scene.sent.clear()
    scene.clock.advance(10.0)
    scene.handler.tick()
    assert scene.sent == []


def test_limits_do_not_begin_again_after_a_reload() -> None:
    """HEARTBEATs on request have no other limit."""
    scene = Scene(*ALL)
    assert scene.result(long(512, 0)) is CommandResult.ACCEPTED
    reload(scene)
    assert scene.result(long(512, 0)) is CommandResult.TEMPORARILY_REJECTED
