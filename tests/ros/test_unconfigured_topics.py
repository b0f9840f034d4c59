"""Names of topics come from other participants, and their message to the daemon must fit into a line."""

from __future__ import annotations

import pytest

from phm.facts import NameFact
from phm.probes.ros.protocol import LINE_LIMIT, OtherTopics, encode
from phm.probes.ros.unconfigured_topics import MAX_TOPICS, _fitting


@pytest.mark.parametrize("character", ["a", "€", "\U0001f600"])
def test_long_names_fit_into_one_line(character: str) -> None:
    """A longer line is dropped by the daemon, and with it the graph. A character beyond U+FFFF takes 12 bytes."""
    facts = {f"/t{number}{character * 900}": NameFact(("/n",), ()) for number in range(MAX_TOPICS)}
    kept = _fitting(dict(facts))
    assert kept
    assert len(encode(OtherTopics(kept))) < LINE_LIMIT
