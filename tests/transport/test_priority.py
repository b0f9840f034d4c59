"""The budget of a link: never exceeded, worst messages first, less when the radio's buffer fills."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, strategies as st

from phm.reporters.swarm import VIEW_HEARTBEATS
from phm.transport.priority import (
    BURST_MIN,
    LEADER,
    MAX_WAITING,
    RADIO_BYTES_S,
    REST,
    ROUTINE,
    ROUTINE_ROOM,
    SLOWEST,
    SWARM_BYTES_S,
    TXBUF_STALE_S,
    UNSIGNED_LAST,
    FlowControl,
    LinkBudget,
    MessagePriority,
    QueuedMessage,
    default_periods,
)
from phm.wire.tunnel import PeerState, PeerView, encode

TUNNEL_BYTES = 17
"""A TUNNEL around its payload: 12 bytes of MAVLink 2, 5 of its own fields."""

items = st.builds(
    QueuedMessage,
    st.sampled_from("abcdefgh"),
    st.sampled_from(MessagePriority),
    st.integers(20, 150),
    st.none(),
    st.integers(0, 7),
)
steps = st.lists(st.tuples(st.floats(0, 5), st.lists(items, max_size=5), st.integers(0, 100)), max_size=40)


def taken(budget: LinkBudget, now: float) -> list[QueuedMessage]:
    """All messages that may be sent now."""
    return list(iter(lambda: budget.next(now), None))


@given(steps, st.integers(1, 100))
def test_never_more_than_burst_and_rate(drawn: list[tuple[float, list[QueuedMessage], int]], agents: int) -> None:
    """Over any time, whatever is queued and whatever the radio reports."""
    budget = LinkBudget(SWARM_BYTES_S, 0.0, agents)
    now, left = 0.0, 0
    for pause, put, txbuf in drawn:
        now += pause
        budget.flow.txbuf(txbuf, now)
        for item in put:
            budget.put(item)
        left += sum(item.size for item in taken(budget, now))
        assert left <= budget.burst + now * budget.rate + 1e-6


@given(st.lists(items, max_size=60))
def test_nothing_is_lost_unless_a_newer_one_replaced_it(put: list[QueuedMessage]) -> None:
    """Without a limit; the order is by priority, then urgency, apart from the turns of answers and routine messages. Each
    replacement is counted.
    """
    budget = LinkBudget(None, 0.0)
    put = [replace(item, put_at=float(number)) for number, item in enumerate(put)]
    for item in put:
        budget.put(item)
    newest = {item.key: item.put_at for item in put}
    left = taken(budget, 0.0)
    assert {item.key: item.put_at for item in left} == newest
    assert {item.key: item.kind for item in left} == {key: min(i.kind for i in put if i.key == key) for key in newest}
    for kinds in ({MessagePriority.TRANSITION, MessagePriority.STATE}, ROUTINE, {MessagePriority.REQUEST}):
        order = [(item.kind, item.urgency) for item in left if item.kind in kinds]
        assert order == sorted(order)
    changes = sum(item.kind <= MessagePriority.STATE for item in left)
    assert all(item.kind <= MessagePriority.STATE for item in left[:changes])
    assert sum(count.coalesced for count in budget.counts.values()) == len(put) - len(newest)


@given(st.lists(st.one_of(items, st.sets(st.sampled_from("xy"))), max_size=60))
def test_a_message_waits_until_what_it_says_is_true(drawn: list[QueuedMessage | set[str]]) -> None:
    """It leaves only then, delays no other one, and is not lost."""
    budget, true, newest, left = LinkBudget(None, 0.0), set[str](), dict[str, int](), dict[str, int]()
    for number, what in enumerate(drawn):
        if isinstance(what, QueuedMessage):
            budget.put(replace(what, message=number, only_while=(("x",), ("x", "y"), ())[number % 3]))
            newest[what.key] = number
            continue
        true = what
        budget.set_true(true)
        waiting = budget.waiting
        now = taken(budget, 0.0)
        assert len(now) == waiting
        assert all(set(item.only_while) <= true for item in now)
        left |= {item.key: item.message for item in now}
    budget.set_true({"x", "y"})
    left |= {item.key: item.message for item in taken(budget, 0.0)}
    assert left == newest


def test_a_message_that_is_not_true_now_outlives_an_outage_and_is_dropped_first() -> None:
    """Its sender would not send it again."""
    budget = LinkBudget(None, 0.0)
    budget.put(QueuedMessage("fault", MessagePriority.TRANSITION, 60, None, 2, only_while=("bad",)))
    budget.expire(100.0)
    budget.set_true({"bad"})
    assert budget.waiting == 1
    budget.set_true(set())
    for number in range(MAX_WAITING):
        budget.put(QueuedMessage(str(number), MessagePriority.REFRESH, 60, None, 6))
    assert budget.waiting == MAX_WAITING
    assert budget.counts[MessagePriority.TRANSITION].dropped == 1


def test_a_fault_is_sent_before_repeated_messages() -> None:
    """A small refresh does not pass it while it waits for credit."""
    budget = LinkBudget(10.0, 0.0)
    budget.put(QueuedMessage("first", MessagePriority.TRANSITION, int(BURST_MIN), None))
    assert taken(budget, 0.0)
    budget.put(QueuedMessage("refresh", MessagePriority.REFRESH, 30, None, 6))
    budget.put(QueuedMessage("node_1", MessagePriority.TRANSITION, 60, None, 2))
    assert taken(budget, 5.9) == []  # 59 bytes would be enough for the refresh, which does not overtake
    assert [item.key for item in taken(budget, 6.0)] == ["node_1"]
    assert taken(budget, 6.0 + (ROUTINE_ROOM + 29) / 10) == []
    assert [item.key for item in taken(budget, 6.0 + (ROUTINE_ROOM + 30) / 10)] == ["refresh"]


@pytest.mark.parametrize("kind", [kind for kind in MessagePriority if kind is not MessagePriority.TRANSITION])
def test_a_new_fault_is_sent_when_everything_else_has_used_what_it_may(kind: MessagePriority) -> None:
    """The longest signed line; by a full state, views, refreshes or answers."""
    budget = LinkBudget(1.0, 0.0)
    for number in range(20):
        budget.put(QueuedMessage(str(number), kind, 60, None))
    assert len(taken(budget, 0.0)) < 20
    budget.put(QueuedMessage("fault", MessagePriority.TRANSITION, 76, None, 2))
    assert [item.key for item in taken(budget, 0.0)] == ["fault"]


def test_an_answer_is_sent_before_a_refresh_that_waits() -> None:
    """And one to an unsigned sender after it, where signing is on."""
    budget = LinkBudget(10.0, 0.0)
    for number in range(10):
        budget.put(QueuedMessage(f"refresh {number}", MessagePriority.REFRESH, 40, None, 6))
    assert len(taken(budget, 0.0)) == (BURST_MIN - ROUTINE_ROOM) // 40
    budget.put(QueuedMessage("unsigned", MessagePriority.REQUEST, 35, None, UNSIGNED_LAST))
    budget.put(QueuedMessage("ack", MessagePriority.REQUEST, 35, None))
    budget.put(QueuedMessage("reply", MessagePriority.REQUEST, 80, None, 2))
    assert [item.key for item in taken(budget, 0.0)] == ["ack", "reply"]


def test_answers_to_unsigned_senders_do_not_delay_one_to_a_signed_sender() -> None:
    """They may use as much as routine messages, and do not count as answers."""
    budget = LinkBudget(10.0, 0.0)
    for number in range(40):
        budget.put(QueuedMessage(f"unsigned {number}", MessagePriority.REQUEST, 35, None, UNSIGNED_LAST))
    for now in (0.0, 60.0):
        assert len(taken(budget, now)) == (BURST_MIN - ROUTINE_ROOM) // 35
    budget.put(QueuedMessage("refresh", MessagePriority.REFRESH, 60, None, 6))
    budget.put(QueuedMessage("ack", MessagePriority.REQUEST, 35, None))
    assert [item.key for item in taken(budget, 60.0)] == ["ack"]
    assert taken(budget, 70.0)[0].key == "refresh"


def test_a_message_is_as_important_as_the_one_that_it_replaces() -> None:
    """A fault that waits for credit is not sent later because its text has changed."""
    budget = LinkBudget(10.0, 0.0)
    budget.put(QueuedMessage("first", MessagePriority.TRANSITION, int(BURST_MIN), None))
    assert taken(budget, 0.0)
    budget.put(QueuedMessage("node_1", MessagePriority.TRANSITION, 40, None, 2))
    budget.put(QueuedMessage("disk", MessagePriority.TRANSITION, 40, None, 3))
    budget.put(QueuedMessage("node_1", MessagePriority.REFRESH, 45, None, 6))
    assert [(item.key, item.size) for item in taken(budget, 4.5)] == [("node_1", 45)]


def test_messages_that_are_replaced_all_the_time_take_turns() -> None:
    """Of equals the one whose key has waited longest is sent, however often each is replaced."""
    budget = LinkBudget(1.0, 0.0)
    left = []
    for second in range(3600):
        budget.put(QueuedMessage("text", MessagePriority.REFRESH, 70, None, 6))
        if second % 50 == 0:
            budget.put(QueuedMessage("refresh", MessagePriority.REFRESH, 70, None, 6))
        left += [item.key for item in taken(budget, float(second))]
    assert min(left.count("text"), left.count("refresh")) > len(left) / 4


def test_many_commands_do_not_stop_views_and_refreshes() -> None:
    """Answers and routine messages take turns: each gets about half of the bytes."""
    budget = LinkBudget(10.0, 0.0)
    for second in range(3600):
        budget.put(QueuedMessage(f"ack {second % 50}", MessagePriority.REQUEST, 35, None))
        if second % 10 == 0:
            budget.put(QueuedMessage("view", MessagePriority.SWARM, 40, None))
            budget.put(QueuedMessage("refresh", MessagePriority.REFRESH, 60, None, 6))
        taken(budget, float(second))
    routine = sum(budget.counts[kind].bytes for kind in ROUTINE)
    assert routine > 0.4 * (routine + budget.counts[MessagePriority.REQUEST].bytes)


@pytest.mark.parametrize("kind", MessagePriority)
def test_no_message_is_too_large_for_what_is_left_to_it(kind: MessagePriority) -> None:
    """The largest of each priority, with a signature: a line, a TUNNEL, ONBOARD_COMPUTER_STATUS."""
    largest = {MessagePriority.SWARM: 158, MessagePriority.REQUEST: 263}.get(kind, 76)
    budget = LinkBudget(SWARM_BYTES_S, 0.0, agents=100)
    budget.put(QueuedMessage("first", MessagePriority.TRANSITION, int(BURST_MIN), None))
    assert taken(budget, 0.0)
    budget.put(QueuedMessage("largest", kind, largest, None))
    assert taken(budget, 3600.0)


def test_heartbeats_use_the_common_budget() -> None:
    """The observed bytes per second of heartbeats are subtracted from the rate of the link."""
    budget = LinkBudget(20.0, 0.0)
    for at in range(10):
        budget.heartbeat(12, float(at))
    assert budget.rate == pytest.approx(8.0)


def test_heartbeats_of_a_large_swarm_leave_budget_for_faults() -> None:
    """At least REST of the share."""
    budget = LinkBudget(20.0, 0.0)
    for at in range(10):
        budget.heartbeat(100, float(at))
    assert budget.rate == pytest.approx(20.0 * REST)


def test_a_link_without_a_limit_delays_nothing() -> None:
    """Up to MAX_WAITING messages leave together."""
    budget = LinkBudget(None, 0.0)
    for number in range(MAX_WAITING):
        budget.put(QueuedMessage(str(number), MessagePriority.REQUEST, 280, None))
    assert len(taken(budget, 0.0)) == MAX_WAITING


def test_the_queue_is_limited_and_drops_the_least_important() -> None:
    """It is counted under its priority."""
    budget = LinkBudget(1.0, 0.0)
    for number in range(MAX_WAITING):
        budget.put(QueuedMessage(f"request {number}", MessagePriority.REQUEST, 280, None))
    budget.put(QueuedMessage("fault", MessagePriority.TRANSITION, 40, None))
    assert budget.waiting == MAX_WAITING
    assert budget.counts[MessagePriority.REQUEST].dropped == 1
    assert taken(budget, 0.0)[0].key == "fault"


def test_an_unsent_message_returns_to_the_front() -> None:
    """It keeps its place in the queue and is counted once."""
    budget = LinkBudget(10.0, 0.0)
    for name in "ab":
        budget.put(QueuedMessage(name, MessagePriority.TRANSITION, 40, None))
    first = budget.next(0.0)
    assert first is not None
    budget.give_back(first)
    assert [item.key for item in taken(budget, 0.0)] == ["a", "b"]
    assert budget.counts[MessagePriority.TRANSITION].sent == 2
    budget.put(QueuedMessage("a", MessagePriority.REFRESH, 45, None))
    budget.give_back(first)
    assert [(item.size, item.kind) for item in taken(budget, 0.0)] == [(45, MessagePriority.TRANSITION)]


def test_outdated_messages_are_dropped() -> None:
    """Those put before the limit are dropped and counted; newer ones are sent."""
    budget = LinkBudget(None, 0.0)
    budget.put(QueuedMessage("old", MessagePriority.TRANSITION, 40, None, put_at=1.0))
    budget.put(QueuedMessage("new", MessagePriority.TRANSITION, 40, None, put_at=9.0))
    budget.expire(5.0)
    assert [item.key for item in taken(budget, 9.0)] == ["new"]
    assert budget.counts[MessagePriority.TRANSITION].dropped == 1


def test_a_full_radio_buffer_slows_down_and_an_empty_one_speeds_up() -> None:
    """Between SLOWEST and the normal speed."""
    flow = FlowControl()
    for at in range(10):
        flow.txbuf(5, float(at))
    assert flow.factor(9.0) == SLOWEST
    for at in range(10, 20):
        flow.txbuf(98, float(at))
    assert flow.factor(19.0) == 1.0


def test_an_old_radio_status_does_not_count() -> None:
    """After TXBUF_STALE_S the speed is normal."""
    flow = FlowControl()
    for at in range(10):
        flow.txbuf(5, float(at))
    assert flow.factor(9.0 + TXBUF_STALE_S) == SLOWEST
    assert flow.factor(9.1 + TXBUF_STALE_S) == 1.0


@pytest.mark.parametrize(
    ("agents", "wanted"),
    [(1, (2, 10)), (8, (2, 10)), (9, (5, 60)), (30, (5, 60)), (31, (15, 150)), (100, (15, 150)), (250, (40, 300))],
)
def test_the_larger_the_swarm_the_longer_the_periods(agents: int, wanted: tuple[float, float]) -> None:
    """Seconds between heartbeats, and between refreshes."""
    assert default_periods(agents) == wanted


@pytest.mark.parametrize(("agents", "percent"), [(1, 5), (8, 5), (30, 5), (100, 6), (250, 6)])
def test_an_idle_swarm_stays_within_its_share(agents: int, percent: float) -> None:
    """Heartbeats of 21 bytes, refreshes of 28 and views, all agents together."""
    heartbeat_s, refresh_s = default_periods(agents)
    peers = dict.fromkeys(range(2, agents + 1), PeerState.ALIVE)
    view = TUNNEL_BYTES + len(encode(PeerView(0, True, True, True, peers)))
    views = view / (VIEW_HEARTBEATS * heartbeat_s) if peers else 0.0
    assert agents * (21 / heartbeat_s + 28 / refresh_s + views) <= RADIO_BYTES_S * percent / 100


@pytest.mark.parametrize("agents", [1, 8, 30])
def test_all_agents_together_stay_within_the_share(agents: int) -> None:
    """Heartbeats at their periods included; the leader's part is deducted from all. The reserve REST for faults may
    exceed it.
    """
    budgets = [LinkBudget(SWARM_BYTES_S, 0.0, agents=agents, leads=number == 0) for number in range(agents)]
    heartbeat_s = default_periods(agents)[0]
    for budget in budgets:
        budget.heartbeat(21, 0.0)
        budget.heartbeat(21, heartbeat_s)
    rest = sum(budget.rate for budget in budgets)
    kept = 0.0 if agents <= 8 else REST * SWARM_BYTES_S
    speaks = LEADER * SWARM_BYTES_S if agents == 1 else 0.0
    assert rest + agents * 21 / heartbeat_s <= SWARM_BYTES_S + kept + speaks + 1e-6
