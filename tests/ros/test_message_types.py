"""Message classes by the names of their types."""

from __future__ import annotations

import pytest

from phm.probes.ros.message_types import UnknownType, load_type


@pytest.mark.parametrize("name", ["no_such_msgs/msg/Thing", "std_msgs/msg/NoSuchType", "", "x", "/msg/A", "..//"])
def test_a_type_that_is_not_there_is_named(name: str) -> None:
    """An unknown type is a sentence, never another exception."""
    with pytest.raises(UnknownType, match="type unknown"):
        load_type(name)
