"""JSON5 of the documents is configuration of a Zenoh router: the library that PHM uses reads it."""

from __future__ import annotations

import json

import pytest
import zenoh

from phm.wire import fleet_status
from tests.docs.blocks import Block, blocks


def problem(text: str) -> str:
    """Why a router refuses the text, or lets PHM's agent of it not publish; empty: neither."""
    try:
        control = json.loads(zenoh.Config.from_json5(text).get_json("access_control"))
    except zenoh.ZError as error:
        return str(error)
    rules, subjects = ({one["id"]: one for one in control[part]} for part in ("rules", "subjects"))
    for policy in control["policies"]:
        if not set(policy["rules"]) <= set(rules) or not set(policy["subjects"]) <= set(subjects):
            return f"the policy {policy} names a rule or a subject that does not exist"
        for agent in policy["subjects"]:
            keys = [zenoh.KeyExpr(key) for rule in policy["rules"] for key in rules[rule]["key_exprs"]]
            for own in (fleet_status.key("north", agent), fleet_status.alive_key("north", agent, "1a2b")):
                if not any(key.includes(zenoh.KeyExpr(own)) for key in keys):
                    return f"{agent} may not publish {own}"
    return ""


@pytest.mark.parametrize("block", blocks("json5"), ids=str)
def test_the_router_accepts_the_block(block: Block) -> None:
    """Zenoh knows each key and value, rules and subjects of its policies exist, and their keys are those of PHM."""
    assert not problem(block.text), f"{block}: {problem(block.text)}"


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("enable_mtls", "mtls"),
        ('"liveliness_token"', '"token"'),
        ('rules: ["own", "asked"]', 'rules: ["owner"]'),
        ("phm/north/", "phm/south/"),
        ("policies", "policy"),
    ],
)
def test_a_wrong_word_is_found(right: str, wrong: str) -> None:
    """Of Zenoh's, of the block's own names, and of PHM's keys."""
    (block,) = blocks("json5")
    assert right in block.text and problem(block.text.replace(right, wrong))
