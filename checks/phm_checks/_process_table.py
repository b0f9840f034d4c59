"""The processes of one container over time: when to list them, and what they show about the container's nodes."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping, Sequence

from phm import api
from phm_checks._evidence import EvidencePiece, Kind, Observation
from phm_checks._known_process import KnownProcess
from phm_checks._process_matching import BARE, Match, Wanted, match

QUIET_S = 10.0
"""Time between two process lists while nothing is in doubt: a restarted node has a new process."""
BLIND_S = 2.0
"""The same while some node has neither a beacon nor a topic with a rate, whose silence would reveal that the node died."""
SOON_S, SHARE = 0.5, 4.0
"""While something is in doubt: every half second, then at intervals of a quarter of the time since the doubt began."""
CALM_S = 5.0
"""A doubt is over after it has been absent for this long: a jittering topic must not cause a process list each time."""
GAP_S = 0.2
AGAIN_S = 1.0
"""Time between queries about a container that does not run, or whose processes cannot be listed. If the engine itself does not
answer, QUIET_S: each query may take the full deadline."""
OLD_S = 3 * QUIET_S
"""A list older than this proves nothing."""
ABSENT_S, LATER = 2.0, 3.0
"""A node without a process, while all other nodes of its container have theirs, was left out of the start. PHM decides this ABSENT_S
after the first process started, or after LATER times the node's start delay in earlier generations plus one second, since process ages
are whole seconds."""
SLOWER = 2.0
"""The same as a multiple of the slowest other node's start delay, in case this start is slow."""
ENDING_S = 11.0
"""The engine reports a container as running until all its processes have ended: up to 1.5 s, measured, after its first process was
killed, while the others disappear one by one. The engine itself waits 10 s before it gives up on a killed container."""
YOUNGER_S = 2.0
"""A process that began this much later than the node appeared in the graph is not the node's: ages of processes are whole seconds, and
lists take a moment."""
NEVER = float("-inf")


class ProcessTable:
    """Known processes of one container. Invariant: `_known` contains only processes of its current generation."""

    def __init__(self, key: str, nodes: Sequence[Wanted], grace_s: float) -> None:
        self.key, self._grace_s = key, grace_s
        self._nodes = tuple(nodes)
        self._known: dict[str, KnownProcess] = {}
        self._unclear: Mapping[str, int] = {}
        self._ways: dict[str, int] = {}
        """The most certain method that ever matched each node's process, in any generation: if that method finds none now, there is none."""
        self._commands: dict[str, str] = {}
        """The command line of each node's process in the previous generation."""
        self._late_s: dict[str, float] = {}
        """The longest time by which each node started after the container's first node, over all earlier generations."""
        self._status = ""
        self._generation = ""
        self._first = 0
        """The container's first process, once a list of this generation has contained it."""
        self._ending_since: float | None = None
        self._born_at = NEVER
        self._began_at: dict[str, float] = {}
        self._appeared_at: dict[str, float] = {}
        """When each node appeared in the graph, or appeared one more time."""
        self._vanished_at: dict[str, float] = {}
        """When a process that an earlier generation had was first missing in this one."""
        self._listed_at: float | None = None
        self._asked_at = NEVER
        self._again_s = QUIET_S
        self._suspicions: dict[Hashable, float] = {}
        """When each doubt last existed. Bounded: a few strings for each configured node."""
        self._doubt_since = NEVER

    # ------------------------------------------------------------ queries

    def observe(self, world: api.World, suspicions: Collection[Hashable], *, blind: bool) -> None:
        """Query the engine if there is a reason. suspicions: a new one causes an immediate query."""
        now = world.clock.mono()
        if not self._due(now, suspicions, blind):
            return
        self._asked_at = now
        try:
            fact = world.docker.container(self.key)
        except api.CannotTell:
            self._status, self._listed_at, self._again_s = "", None, QUIET_S
            return
        self._meet(fact, now)
        self._listed_at, self._again_s = None, AGAIN_S
        if fact is None or not fact.running:
            return
        try:
            processes = world.docker.processes(self.key)
        except api.CannotTell:
            return
        self._again_s = 0.0
        if not self._ends(fact.pid, processes, world.clock.mono()):
            self._take(processes, world.clock.mono())

    def _ends(self, first: int, processes: Sequence[api.ProcessFact], now: float) -> bool:
        """Whether the first process has ended, which ends all others: then a missing process proves nothing. If the lists never contain
        it, this is unknown and False."""
        if any(process.pid == first for process in processes):
            self._first, self._ending_since = first, None
        elif self._first == first and self._ending_since is None:
            self._ending_since = now
        return self._ending_since is not None and now - self._ending_since < ENDING_S

    def _due(self, now: float, suspicions: Collection[Hashable], blind: bool) -> bool:
        waited = now - self._asked_at
        self._suspicions = {why: at for why, at in self._suspicions.items() if now - at <= CALM_S}
        new = [why for why in suspicions if why not in self._suspicions]
        if new and waited < max(GAP_S, self._again_s):
            return False
        self._suspicions.update(dict.fromkeys(suspicions, now))
        if new:
            self._doubt_since = now
            return True
        if self._suspicions:
            return waited >= max(SOON_S, min((now - self._doubt_since) / SHARE, QUIET_S), self._again_s)
        return waited >= max(BLIND_S if blind else QUIET_S, self._again_s)

    def _meet(self, fact: api.ContainerFact | None, now: float) -> None:
        self._status = fact.status if fact is not None else "missing"
        generation = fact.generation if fact is not None else ""
        if generation and generation != self._generation:
            # The first generation that PHM sees may be old: PHM does not know when it began.
            if self._generation:
                self._born_at = now
            self._learn()
            if generation.partition("@")[0] != self._generation.partition("@")[0]:
                # A new container may name its processes differently.
                self._ways = dict.fromkeys(self._ways, BARE)
            self._generation, self._first, self._ending_since = generation, 0, None
            self._known.clear()
            self._vanished_at.clear()

    def _take(self, processes: Sequence[api.ProcessFact], now: float) -> None:
        self._listed_at = now
        by_pid = {one.pid: one for one in processes}
        wrappers = {name: known.match.wrappers for name, known in self._known.items()}
        found, self._unclear = match(self._nodes, processes, wrappers, self._ways)
        for node in self._nodes:
            known, matched = self._known.get(node.name), found.get(node.name)
            if (
                matched is not None
                and (known is None or known.pid in by_pid)
                and self._younger(node.name, matched, now)
            ):
                matched = None
            if matched is not None and (known is None or known.pid not in by_pid or matched.way < known.match.way):
                known = self._renew(node.name, known, matched, now)
            if known is None:
                continue
            known.observe(now, by_pid.get(known.pid))

    def _younger(self, name: str, matched: Match, now: float) -> bool:
        """Whether the node was in the graph, in this generation, before the process began: then it is another program, such as a tool
        that was started by hand with the node's name in its command line."""
        appeared_at, age_s = self._appeared_at.get(name, NEVER), matched.process.age_s
        return self._born_at < appeared_at and age_s is not None and now - age_s > appeared_at + YOUNGER_S

    def _renew(self, name: str, known: KnownProcess | None, matched: Match, now: float) -> KnownProcess:
        """Assign another process to the node: it is the first in this generation, or the old one has ended, or the old match was wrong:
        until a launcher has started its nodes, it is the only process with their names."""
        first = not self.not_started(name) if known is None else known.first and known.match.way > matched.way
        if known is not None and known.match.way <= matched.way:
            self._began_at[name] = now
        self._ways[name] = min(matched.way, self._ways.get(name, matched.way))
        self._vanished_at.pop(name, None)
        self._known[name] = KnownProcess(matched, first)
        return self._known[name]

    def _learn(self) -> None:
        """Learn from the ended generation how its nodes start. A node that started much later had been restarted."""
        for name, known in self._known.items():
            self._commands[name] = known.command
            late_s = known.began_at - self._first_at()
            if known.first and late_s < self._grace_s:
                self._late_s[name] = max(late_s, self._late_s.get(name, 0.0))

    def _first_at(self) -> float:
        """When the first node process of this generation was started; infinite if none was seen."""
        return min((known.began_at for known in self._known.values()), default=float("inf"))

    def appeared(self, name: str, since: float) -> None:
        """The node appeared in the graph at `since`. Forget its process if it had ended before, or if none is in a newer list of this
        generation: it now runs as another process."""
        self._appeared_at[name] = since
        known = self._known.get(name)
        unmatched = known is None and not self._unclear.get(name) and self._born_at < since < (self._listed_at or NEVER)
        if unmatched or (known is not None and known.ended_at < since):
            self.forget(name)

    def forget(self, name: str) -> None:
        """Forget all that was learned about the node's process: it was another program's."""
        for kept in (self._known, self._ways, self._commands, self._late_s, self._vanished_at):
            kept.pop(name, None)

    # ------------------------------------------------------------ results

    @property
    def generation(self) -> str:
        """The container generation that was seen last; empty before the first query."""
        return self._generation

    def was_alive(self, name: str) -> bool:
        """Whether a process of the node was seen in this generation."""
        return name in self._known

    def running(self, name: str) -> tuple[str, int] | None:
        """The node's process as container generation and process id, to compare; None if it is unknown or has ended."""
        known = self._known.get(name)
        return (self._generation, known.pid) if known is not None and known.there else None

    def began_at(self, name: str) -> float:
        """When the node or its container was last seen to start, on the monotonic clock; -inf if no start was seen."""
        return max(self._born_at, self._began_at.get(name, NEVER))

    def container(self, now: float) -> EvidencePiece | None:
        """Evidence from the container's state, for all its nodes; None while the container is running."""
        age_s = now - self._asked_at
        if self._status == "running" and self._ending_since is not None and now - self._ending_since < ENDING_S:
            words = f"its container is stopping: its first process {self._first} has ended"
            return EvidencePiece(Kind.CONTAINER, Observation.ENDING, words, age_s)
        if self._status in ("", "running") or age_s > OLD_S:
            return None
        says = Observation.STOPPED if self._status == "paused" else Observation.GONE
        return EvidencePiece(Kind.CONTAINER, says, f"its container is {self._status}", age_s)

    def process(self, name: str, now: float) -> EvidencePiece | None:
        """Evidence from the newest list about one node; None if its state is unknown."""
        known = self._known.get(name)
        if self._listed_at is None or now - self._listed_at > OLD_S:
            return None
        age_s = now - self._listed_at
        if known is None:
            words = "no process in its container matches it"
            if not self._vanished(name, now):
                return None
            lasted_s = now - self._vanished_at.setdefault(name, self._listed_at)
            return EvidencePiece(Kind.PROCESS, Observation.GONE, words, age_s, lasted_s)
        if not known.there:
            words, lasted_s = f"its process {known.pid} has ended", now - known.ended_at
            return (
                EvidencePiece(Kind.PROCESS, Observation.GONE, words, age_s, lasted_s)
                if self._unclear.get(name, 0) < 2
                else None
            )
        if known.state in ("T", "t"):
            words = f"its process {known.pid} is stopped (state {known.state}: SIGSTOP or a debugger)"
            return EvidencePiece(Kind.PROCESS, Observation.STOPPED, words, age_s)
        if known.state == "D":
            # It does not use the CPU because it cannot: a restart would wait for the same disk.
            words = f"its process {known.pid} waits for a disk or a device (state D)"
            return EvidencePiece(Kind.PROCESS, Observation.ALIVE, words, age_s, measured=False)
        if known.busy:
            return EvidencePiece(Kind.PROCESS, Observation.BUSY, f"its process {known.pid} is using the CPU", age_s)
        words = f"its process {known.pid} is running"
        if known.measured:
            return EvidencePiece(Kind.PROCESS, Observation.ALIVE, words, age_s, now - known.idle_since)
        return EvidencePiece(Kind.PROCESS, Observation.ALIVE, f"{words}, its CPU use is unknown", age_s, measured=False)

    def fit(self, name: str, now: float) -> int:
        """The number of processes in the newest list that may be the node's own, if more than one; 0 for one, none, or no list."""
        if self._listed_at is None or now - self._listed_at > OLD_S:
            return 0
        count = self._unclear.get(name, 0)
        return count if count > 1 else 0

    @property
    def unlisted(self) -> bool:
        """Whether the engine failed to list the processes at the last query, although the container is running."""
        return self._status == "running" and self._listed_at is None

    def describe(self, name: str) -> str:
        """The state of the node's process as text, for the values of a result."""
        known, count = self._known.get(name), self._unclear.get(name, 0)
        if known is not None:
            return f"{known.pid} {known.state}".rstrip() if known.there else f"{known.pid} ended"
        return f"{count} fit" if count > 1 else "none found"

    def _vanished(self, name: str, now: float) -> bool:
        """Whether the node's process was found in an earlier generation of the container, but not in this one."""
        if name not in self._ways or self._unclear.get(name):
            return False
        return now - self.began_at(name) >= self._grace_s or self.not_started(name)

    def not_started(self, name: str) -> bool:
        """Whether the others started as before but this node did not, long after it should have: PHM need not wait for it.

        Only if it and the others are known from earlier generations: the same commands start the same nodes.
        """
        others = [node.name for node in self._nodes if node.name != name]
        if self._listed_at is None or not others or name not in self._late_s or name in self._known:
            return False
        if not all(self._as_before(other) for other in others):
            return False
        slowest_s = max(self._known[other].began_at for other in others) - self._first_at()
        limit_s = max(ABSENT_S, LATER * self._late_s[name] + 1.0, SLOWER * slowest_s)
        return self._listed_at - self._first_at() >= limit_s

    def _as_before(self, name: str) -> bool:
        """Whether the node is running with the same command line as in the previous generation."""
        known = self._known.get(name)
        return known is not None and known.there and known.command == self._commands.get(name)
