"""How the child processes beacons: parsed or rejected, reported on changes, no node displaced."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest

from phm.beacon import BEACON_FORMAT, HELLO_FORMAT, MAX_NEIGHBOURS, MAX_NODES, _Neighbours
from phm.facts.ros import BeaconFact, NeighbourFact
from phm.probes.ros.beacon_registry import FORGET_S, MAX_RIVALS, MAX_STRANGERS, BeaconRegistry, portions
from phm.probes.ros.beacon_text import beacons_in, log_texts
from phm.probes.ros.beacons import MAX_BYTES, OTHERS_BYTES, choose
from phm.probes.ros.protocol import LINE_LIMIT, SelfReportUpdate, encode
from phm.probes.ros.self_reports import MAX_NAMES, ConfiguredNames, SelfReports

A, B = "/agent_1/a", "/agent_1/b"


def node(birth: str = "w.1", late_s: float = 0.0, beats: int = 5) -> dict[str, Any]:
    return {"birth": birth, "beats": beats, "turns": 3, "late_s": late_s}


def text(nodes: dict[str, Any] | None = None, *, witness: str = "w", views: object = None) -> str:
    said: dict[str, Any] = {"witness": witness, "period_s": 0.2, "nodes": nodes or {A: node(f"{witness}.1")}}
    if views is not None:
        said["views"] = views
    return json.dumps(said)


def ledger(*names: str) -> BeaconRegistry:
    return BeaconRegistry(frozenset(names))


def registered(book: BeaconRegistry, now_s: float) -> SelfReportUpdate:
    news = book.changes(now_s)
    assert news is not None
    return news


VIEWS = {B: {"alive": True, "age_s": 0.4, "late_s": 0.0}}


def test_a_beacon_is_parsed() -> None:
    """Every field arrives."""
    ((name, fact, has_views),) = beacons_in(text(views=VIEWS))
    assert (name, has_views) == (A, True)
    assert fact == BeaconFact(0.0, 0.2, 0.0, "w.1", 5, {B: NeighbourFact(True, 0.4, 0.0)}, 3, "w")


def test_a_full_list_of_neighbours_is_known_also_after_those_of_others_are_dropped() -> None:
    """A node that it does not contain may have had no space in it; until the next list this stays so."""
    book = ledger(A, B)
    names = [f"/agent_9/n{number}" for number in range(MAX_NEIGHBOURS - 1)]
    view = VIEWS[B]
    book.add(BEACON_FORMAT, text(views=dict.fromkeys(names, view)), 1.0)
    assert not registered(book, 1.0).beacons[A].full
    book.add(BEACON_FORMAT, text(views=dict.fromkeys([*names, "/agent_9/x"], view)), 2.0)
    book.add(BEACON_FORMAT, text(), 2.2)
    fact = registered(book, 2.2).beacons[A]
    assert fact.full and not fact.views


def greet(neighbours: _Neighbours, *names: str, at_s: float = 1.0) -> None:
    said = {"witness": "other", "period_s": 0.8, "nodes": dict.fromkeys(names, 0.0)}
    neighbours.receive(HELLO_FORMAT, json.dumps(said), at_s)


def test_nodes_of_the_own_namespace_take_the_place_of_others() -> None:
    """Of those that have been silent for longest; among themselves, and from others, they lose none."""
    neighbours = _Neighbours("w")
    neighbours.add_own(A)
    strangers = [f"/agent_9/n{number}" for number in range(MAX_NEIGHBOURS)]
    greet(neighbours, *strangers[:1])
    greet(neighbours, *strangers[1:], at_s=2.0)
    greet(neighbours, B, "/agent_7/x", at_s=3.0)
    seen = neighbours.views(3.0)
    assert len(seen) == MAX_NEIGHBOURS and B in seen and not {strangers[0], "/agent_7/x"} & seen.keys()
    own = [f"/agent_1/n{number}" for number in range(MAX_NEIGHBOURS)]
    greet(neighbours, *own, at_s=4.0)
    assert neighbours.views(4.0).keys() == {B, *own[:-1]}


WRONG: list[Any] = [
    "",
    "{",
    "[]",
    "7",
    "null",
    "{}",
    "[" * 100_000,
    "x" * 90_000,
    text(views=[1]),
    text(views={"b": VIEWS[B]}),
    text(views={B: {**VIEWS[B], "alive": 1}}),
    text(views={B: {**VIEWS[B], "age_s": -1}}),
    text(views={f"/n{i}": VIEWS[B] for i in range(MAX_NEIGHBOURS + 1)}),
    text(witness=""),
    text(witness="w" * 61),
    text(witness="a\nb"),
    text({"a": node()}),
    text({"/" + "a" * 300: node()}),
    text({"/a\x1b[2J": node()}),
    text({A: 5}),
    text({A: {}}),
    text({A: node(late_s=float("nan"))}),
    text({A: node(late_s=-1)}),
    text({A: node(late_s=True)}),
    text({A: node(beats=-1)}),
    text({A: {**node(), "beats": 1.5}}),
    text({A: {**node(), "birth": 7}}),
    text({f"/n{i}": node() for i in range(MAX_NODES + 1)}),
    text().replace("0.2", "0"),
    text().replace("0.2", "1e9"),
    text().replace("0.2", '"0.2"'),
    json.dumps({"witness": "w", "period_s": 0.2, "nodes": {}}),
]


@pytest.mark.parametrize("wrong", WRONG)
def test_other_messages_are_rejected_and_counted(wrong: str) -> None:
    """Nothing of them is kept, and nothing is raised."""
    book = ledger(A)
    book.add(BEACON_FORMAT, wrong, 1.0)
    assert book.changes(1.0) == SelfReportUpdate(refused=1)
    assert book.changes(1.1) is None


def test_another_format_version_is_rejected() -> None:
    """A version that this PHM does not know is counted, not misread."""
    book = ledger(A)
    book.add("phm.beacon/2", text(), 1.0)
    assert book.refused == 1


def test_the_first_beacon_is_sent_in_full_and_the_next_by_its_age() -> None:
    """On the pipe, a beacon without changes is a single number."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text(), 1.0)
    assert set(registered(book, 1.1).beacons) == {A}
    book.add(BEACON_FORMAT, text(), 1.2)
    assert book.changes(1.25) == SelfReportUpdate(ages={A: 0.05})
    assert book.changes(1.3) is None


@pytest.mark.parametrize("news", [text({A: node(late_s=2.0)}), text({A: node("w.2")}), text(views=VIEWS)])
def test_a_change_is_sent_in_full(news: str) -> None:
    """Lateness, another life, a view."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text(), 1.0)
    book.changes(1.0)
    book.add(BEACON_FORMAT, news, 1.2)
    assert set(registered(book, 1.2).beacons) == {A}


@pytest.mark.parametrize("configured", [(), (A,)], ids=["stranger", "configured"])
def test_the_first_turn_of_an_executor_is_a_change(configured: tuple[str, ...]) -> None:
    """A beacon from before the executor ran does not represent later ones, also for nodes that are not configured."""
    book = ledger(*configured)
    book.add(BEACON_FORMAT, text({A: {**node(), "turns": 0}}), 1.0)
    assert registered(book, 1.0).beacons[A].turns == 0
    book.add(BEACON_FORMAT, text(), 1.2)
    assert registered(book, 1.2).beacons[A].turns == 3


def test_a_view_is_kept_until_the_next() -> None:
    """Views arrive once a second, beacons five times."""
    book = ledger(A, B)
    book.add(BEACON_FORMAT, text(views=VIEWS), 1.0)
    book.add(BEACON_FORMAT, text(), 1.2)
    assert set(registered(book, 1.2).beacons[A].views) == {B}
    book.add(BEACON_FORMAT, text(views={}), 1.4)
    assert registered(book, 1.4).beacons[A].views == {}


def test_silence_is_reported_when_it_begins_and_when_it_ends() -> None:
    """After two missed beacons, after three, and not again; then when a beacon arrives again."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text(), 1.0)
    book.changes(1.0)
    assert book.changes(1.35) is None
    assert registered(book, 1.41).beacons[A].age_s == 0.41
    assert registered(book, 1.61).beacons[A].age_s == 0.61
    assert book.changes(2.0) is None
    book.add(BEACON_FORMAT, text(), 2.1)
    assert set(registered(book, 2.1).beacons) == {A}


def test_a_second_node_of_a_name_replaces_only_a_silent_one() -> None:
    """A forged or duplicate node cannot hide that the first one is alive, nor hide its death for long."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text(), 1.0)
    book.add(BEACON_FORMAT, text(witness="v"), 1.1)
    assert registered(book, 1.1).beacons[A].birth == "w.1"
    book.add(BEACON_FORMAT, text(witness="v"), 1.61)
    assert registered(book, 1.61).beacons[A].birth == "v.1"


def test_configured_nodes_have_reserved_space() -> None:
    """Other nodes fill their own share, are rejected beyond it, and are forgotten when they are silent."""
    book = ledger(A)
    for number in range(MAX_STRANGERS + 5):
        book.add(BEACON_FORMAT, text({f"/x{number}": node()}), 1.0)
    book.add(BEACON_FORMAT, text(), 1.0)
    news = registered(book, 1.0)
    assert (len(news.beacons), news.refused) == (MAX_STRANGERS + 1, 5)
    assert A in news.beacons
    book.changes(2.0)
    book.changes(1.1 + FORGET_S)
    book.add(BEACON_FORMAT, text({"/y": node()}), 2.0 + FORGET_S)
    assert set(registered(book, 2.0 + FORGET_S).beacons) == {"/y"}


def test_the_daemon_keeps_the_newest_and_its_age() -> None:
    """An age alone updates a known beacon; an unknown name is ignored."""
    kept = SelfReports().with_update(SelfReportUpdate(beacons={A: BeaconFact(0.1, 0.2)}, refused=2), 10.0)
    kept = kept.with_update(SelfReportUpdate(ages={A: 0.05, B: 0.05}, refused=2), 10.5)
    beacons, _ = kept.since(10.6)
    assert beacons[A].age_s == pytest.approx(0.15)
    assert set(beacons) == {A}
    assert kept.refused == 2


@pytest.mark.parametrize(
    ("fact", "differs"),
    [
        (BeaconFact(0.1, 0.2, 0.0, "w.1"), False),
        (BeaconFact(0.41, 0.2, 0.0, "w.1"), True),
        (BeaconFact(0.0, 0.2, 0.9, "w.1"), False),
        (BeaconFact(0.0, 0.2, 2.1, "w.1"), True),
        (BeaconFact(0.0, 0.2, 0.0, "w.2"), True),
    ],
)
def test_checks_are_woken_by_relevant_changes(fact: BeaconFact, differs: bool) -> None:
    """Silence, lateness, another life; not each beacon."""
    kept = SelfReports().with_update(SelfReportUpdate(beacons={A: BeaconFact(0.1, 0.2, 0.0, "w.1")}), 10.0)
    assert kept.differs(SelfReportUpdate(beacons={A: fact})) is differs
    assert SelfReports().differs(SelfReportUpdate(beacons={A: fact}))
    assert not kept.differs(SelfReportUpdate(ages={A: 0.1}))


def hello(witness: str, name: str, period_s: float = 0.4) -> str:
    return json.dumps({"witness": witness, "period_s": period_s, "nodes": {name: 0.0}})


def test_a_neighbour_is_alive_until_it_has_missed_three_greetings() -> None:
    """By the period that it announced; then it is not alive, and forgotten after a minute."""
    neighbours = _Neighbours("me")
    neighbours.receive(HELLO_FORMAT, hello("w", A), 10.0)
    neighbours.receive(HELLO_FORMAT, hello("me", B), 10.0)
    assert neighbours.views(11.2) == {A: {"alive": True, "age_s": 1.2, "late_s": 0.0}}
    assert not neighbours.views(11.5)[A]["alive"]
    assert neighbours.views(71.0) == {}


@pytest.mark.parametrize(
    "wrong", ["", "[]", "{}", "null", "x" * 90_000, hello("w", A).replace("0.4", "1e9"), "[" * 10_000]
)
def test_other_messages_on_the_topic_are_ignored_by_nodes(wrong: str) -> None:
    """In the application's own process, input from outside must neither raise nor be forwarded in a form that PHM
    rejects.
    """
    neighbours = _Neighbours("me")
    neighbours.receive(HELLO_FORMAT, wrong, 1.0)
    neighbours.receive("other", hello("w", A), 1.0)
    assert neighbours.views(1.0) == {} and neighbours.processes == 0


def test_neighbours_are_limited_to_what_fits_into_a_message() -> None:
    """The first ones are kept."""
    neighbours = _Neighbours("me")
    for number in range(MAX_NEIGHBOURS + 9):
        neighbours.receive(HELLO_FORMAT, hello(f"w{number}", f"/n{number}"), 1.0)
    assert len(neighbours.views(1.0)) == MAX_NEIGHBOURS == neighbours.processes
    assert "/n0" in neighbours.views(1.0)


# ---------------------------------------------------------------- bytes


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of lark, which rclpy depends on
@pytest.mark.parametrize(
    ("name", "said"), [("phm.beacon/1", "{}"), ("", ""), ("abc", "x" * 1001), ("ä", "\u20ac \U0001f681 end")]
)
def test_texts_are_read_from_bytes_as_rclpy_reads_them(name: str, said: str) -> None:
    """Of any length, and so at any alignment."""
    from rcl_interfaces.msg import Log
    from rclpy.serialization import deserialize_message, serialize_message

    data = serialize_message(Log(level=20, name=name, msg=said, file="f.py", function="g", line=7))
    read = deserialize_message(data, Log)
    assert log_texts(data) == (read.name, read.msg) == (name, said)


WHOLE = b"\0\1\0\0" + b"\0" * 8 + b"\x14\0\0\0" + b"\3\0\0\0ab\0\0" + b"\2\0\0\0c\0"


def test_truncated_or_foreign_bytes_are_rejected() -> None:
    """Anyone who publishes on this topic may send anything."""
    assert log_texts(WHOLE) == ("ab", "c")
    swapped = b"\0\0\0\0" + b"\0" * 8 + b"\x14\0\0\0" + b"\0\0\0\3ab\0\0" + b"\0\0\0\2c\0"
    assert log_texts(swapped) == ("ab", "c")
    strange = [WHOLE[:end] for end in range(len(WHOLE))]
    strange += [b"\0\7" + WHOLE[2:], WHOLE.replace(b"ab\0", b"abc"), WHOLE.replace(b"ab", b"\xff\xfe")]
    strange += [WHOLE.replace(b"\3\0\0\0", length) for length in (b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\0\x80")]
    for data in strange:
        with pytest.raises((ValueError, struct.error)):
            log_texts(data)


def test_two_active_processes_of_one_name_are_reported() -> None:
    """Each sends several beacons after the second appeared; then the second ends."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text(), 1.0)
    reported = []
    for number in range(1, 20):
        at_s = 1.0 + 0.2 * number
        book.add(BEACON_FORMAT, text(), at_s)
        if 5 <= number < 12:
            book.add(BEACON_FORMAT, text(witness="v"), at_s + 0.1)
        news = book.changes(at_s + 0.1)
        reported += [(number, news.beacons[A].rivals)] if news is not None and A in news.beacons else []
    assert reported == [(1, 0), (7, 1), (15, 0)]


def test_a_node_that_replaces_another_is_not_a_rival() -> None:
    """The first one falls silent as the second begins to send: from then on the second is the node."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text(), 1.0)
    for number in range(1, 10):
        at_s = 1.0 + 0.2 * number
        if number == 1:
            book.add(BEACON_FORMAT, text(), at_s)
        book.add(BEACON_FORMAT, text(witness="v"), at_s)
        news = book.changes(at_s)
        assert news is None or all(fact.rivals == 0 for fact in news.beacons.values())
    assert news is not None


def test_the_number_of_rivals_is_capped() -> None:
    """Anyone may send under any name."""
    book = ledger(A)
    for number in range(100):
        book.add(BEACON_FORMAT, text(), 1.0)
        book.add(BEACON_FORMAT, text(witness=f"v{number}"), 1.0)
    assert len(book._beacons[A].rivals) == MAX_RIVALS


ONE, TWO = b"1" * 16, b"2" * 16


def listing(*writers: bytes) -> Any:
    return lambda: {writer: "/elsewhere/forger" if writer == TWO else "/_phm_beacon" for writer in writers}


def test_an_identity_belongs_to_the_writer_that_used_it_first() -> None:
    """A message of another writer with this identity is rejected, and that writer is reported; the first one keeps
    counting.
    """
    book = BeaconRegistry(frozenset({A}), listing(ONE, TWO))
    book.add(BEACON_FORMAT, text(), 1.0, ONE)
    book.changes(1.0)
    book.add(BEACON_FORMAT, text({A: node(late_s=99.0)}), 1.1, TWO)
    fact = registered(book, 1.2).beacons[A]
    assert (fact.late_s, fact.age_s, fact.copied_by, book.refused) == (0.0, 0.2, "/elsewhere/forger", 1)
    book.add(BEACON_FORMAT, text(), 1.2, ONE)
    assert book.changes(1.2) == SelfReportUpdate(ages={A: 0.0}, refused=1)
    book.add(BEACON_FORMAT, text(), 20.0, ONE)
    assert registered(book, 20.0).beacons[A].copied_by == ""


def test_a_copied_identity_does_not_keep_a_dead_node_alive() -> None:
    """Its first writer is listed until its lease ends: until then its silence counts."""
    book = BeaconRegistry(frozenset({A}), listing(ONE, TWO))
    book.add(BEACON_FORMAT, text(), 1.0, ONE)
    for number in range(1, 20):
        book.add(BEACON_FORMAT, text(), 1.0 + number / 10, TWO)
    assert registered(book, 3.0).beacons[A].age_s == 2.0


def test_copied_messages_cost_one_look_at_the_graph_per_poll() -> None:
    """Anyone can send 250 of them in a poll."""
    looks = 0

    def listed() -> dict[bytes, str]:
        nonlocal looks
        looks += 1
        return {ONE: A}

    book = BeaconRegistry(frozenset({A}), listed)
    for poll in range(1, 3):
        for writer in (ONE, *[TWO] * 250):
            book.add(BEACON_FORMAT, text(), 1.0 * poll, writer)
        book.changes(1.0 * poll)
        assert looks == poll


def test_a_copied_identity_adds_no_nodes_to_a_process() -> None:
    """The message is rejected entirely."""
    book = BeaconRegistry(frozenset({A, B}), listing(ONE, TWO))
    book.add(BEACON_FORMAT, text(), 1.0, ONE)
    book.add(BEACON_FORMAT, text({B: node()}), 1.0, TWO)
    assert set(registered(book, 1.0).beacons) == {A}


@pytest.mark.parametrize("listed", [(TWO,), (ONE, TWO)])
def test_an_identity_is_free_again_when_its_writer_is_silent_and_gone(listed: tuple[bytes, ...]) -> None:
    """As behind a bridge that was restarted. A writer that is only silent, or only gone, is not enough: PHM may have
    lost a lease, and a node may be stopped.
    """
    book = BeaconRegistry(frozenset({A}), listing(*listed))
    book.add(BEACON_FORMAT, text(), 1.0, ONE)
    book.add(BEACON_FORMAT, text(), 1.3, TWO)
    assert registered(book, 1.3).beacons[A].age_s == 0.3
    book.add(BEACON_FORMAT, text(), 2.0, TWO)
    news = registered(book, 2.0)
    age_s = news.beacons[A].age_s if A in news.beacons else news.ages[A]
    assert age_s == (1.0 if ONE in listed else 0.0)


def test_a_restarted_node_is_accepted_immediately() -> None:
    """It is another process with another writer; the first one, now silent, may be listed until its lease ends."""
    book = BeaconRegistry(frozenset({A}), listing(ONE, TWO))
    book.add(BEACON_FORMAT, text(), 1.0, ONE)
    book.add(BEACON_FORMAT, text(witness="v"), 1.7, TWO)
    fact = registered(book, 1.7).beacons[A]
    assert (fact.birth, fact.age_s, fact.copied_by) == ("v.1", 0.0, "")


def test_the_number_of_bound_writers_is_limited_like_nodes() -> None:
    """Process names from outside are unlimited."""
    book = BeaconRegistry(frozenset({A}), listing())
    for number in range(MAX_STRANGERS * 3):
        book.add(BEACON_FORMAT, text({f"/x{number}": node()}, witness=f"w{number}"), 1.0, ONE)
    book.changes(1.0)
    assert len(book._writers) <= MAX_STRANGERS
    book.changes(2.0 + FORGET_S)
    assert not book._writers


def test_messages_of_configured_nodes_are_read_first() -> None:
    """Others share the remaining space in turn, short ones first; a message that is too long is not read at all."""
    large, short = b"x" * 70_000, b"x" * 500
    flood = [(large, TWO, number) for number in range(100)]
    honest = [(short, ONE, 200), (short, b"3" * 16, 201), (b"x" * (MAX_BYTES + 1), ONE, 202), (short, ONE, 203)]
    chosen = choose([*flood, *honest], {ONE})
    assert [number for _, _, number in chosen[:3]] == [200, 203, 201]
    assert sum(len(data) for data, _, _ in chosen[2:]) <= OTHERS_BYTES
    assert choose([(short, ONE, number) for number in range(20)], {ONE})[0][2] == 0
    assert len(choose([(large, ONE, number) for number in range(100)], {ONE})) == 1 + OTHERS_BYTES // len(large)


def test_changes_fit_into_messages_and_begin_with_the_configured_nodes() -> None:
    """As many neighbours as a beacon may name, with names of maximum length."""
    names = [f"/{'n' * 250}{number:03}" for number in range(400)]
    views = {name: NeighbourFact(alive=True, age_s=123456.789, late_s=123456.789) for name in names[:MAX_NEIGHBOURS]}
    beacons = {name: BeaconFact(0.1, 0.2, birth="w" * 60, witness="\u00e9" * 60, views=views) for name in names}
    messages = portions(
        SelfReportUpdate(beacons=beacons, ages=dict.fromkeys(map(str, range(2500)), 0.1), lost=True), {names[-1]}
    )
    assert next(iter(messages[0].beacons)) == names[-1]
    assert {name for message in messages for name in message.beacons} == set(names)
    assert sum(len(message.ages) for message in messages) == 2500
    assert all(len(encode(message)) < LINE_LIMIT and message.lost for message in messages)


def test_views_of_unconfigured_nodes_about_each_other_are_dropped() -> None:
    """Nothing uses them, and they make messages long."""
    book = ledger(A)
    book.add(BEACON_FORMAT, text({A: node(), "/x": node()}, views={**VIEWS, A: VIEWS[B]}), 1.0)
    beacons = registered(book, 1.0).beacons
    assert set(beacons[A].views) == {A} and beacons["/x"].views == {}


def test_unconfigured_nodes_displace_no_configured_node_in_the_daemon() -> None:
    """The oldest configured one is kept: a dead node is recognized by its silence."""
    kept = SelfReports(configured=ConfiguredNames(frozenset({A}))).with_update(
        SelfReportUpdate(beacons={A: BeaconFact(0.1, 0.2)}), 1.0
    )
    for number in range(3 * MAX_NAMES):
        kept = kept.with_update(SelfReportUpdate(beacons={f"/x{number}": BeaconFact(0.1, 0.2)}), 2.0 + number)
    assert A in kept.beacons and len(kept.beacons) == MAX_NAMES + 1


def test_silence_while_beacons_are_lost_is_not_evidence() -> None:
    """A node silent since before the loss is unknown; one whose beacon arrived after it is known."""
    kept = SelfReports().with_update(SelfReportUpdate(beacons={A: BeaconFact(0.0, 0.2), B: BeaconFact(0.0, 0.2)}), 10.0)
    kept = kept.with_update(SelfReportUpdate(lost=True), 12.0)
    kept = kept.with_update(SelfReportUpdate(ages={B: 0.0}), 13.0)
    assert set(kept.since(15.0)[0]) == {B}
    assert kept.with_update(SelfReportUpdate(ages={A: 0.0}), 15.0).since(18.0)[0].keys() == {A, B}


def test_a_rival_wakes_the_checks() -> None:
    """Checks run immediately."""
    known = SelfReports().with_update(SelfReportUpdate(beacons={A: BeaconFact(0.0, 0.2)}), 1.0)
    assert known.differs(SelfReportUpdate(beacons={A: BeaconFact(0.0, 0.2, rivals=1)}))
    assert not known.differs(SelfReportUpdate(beacons={A: BeaconFact(0.1, 0.2)}))
