"""The questions of `phm init`, at most five: each has a flag, and a default that `--yes` takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import TypeAdapter, ValidationError

from phm.core.settings import AgentId, EndpointSettings, Name
from phm.setup import answers as decided
from phm.setup.answers import Answers, Network
from phm.setup.machine import Machine

_NAME: TypeAdapter[str] = TypeAdapter(Name)
_ID: TypeAdapter[int] = TypeAdapter(AgentId)


class InvalidAnswer(Exception):
    """An answer that is not possible; the message says what is."""


@dataclass(frozen=True, slots=True)
class Question:
    """key: of the answer in the mapping that `Interview` keeps; flag: the option that answers it."""

    key: str
    flag: str
    text: str
    default: Any


class Interview:
    """Asks what no option has answered. `given` maps keys to answers, None where there is none."""

    def __init__(self, machine: Machine, given: Mapping[str, Any]) -> None:
        self._machine = machine
        self._given = {key: value for key, value in given.items() if value is not None}

    def next(self) -> Question | None:
        """The next question that is open, None when all are answered. Defaults follow from earlier answers."""
        return next((one for one in self._questions() if one.key not in self._given), None)

    def open_flags(self) -> list[str]:
        """The options that answer what is open. A question that depends on a later answer is left out."""
        given = dict(self._given)
        flags = []
        while question := self.next():
            flags.append(question.flag)
            self._given[question.key] = question.default
        self._given = given
        return flags

    def answer(self, question: Question, value: Any) -> None:
        """Check and take over an answer. Raises InvalidAnswer."""
        self._given[question.key] = _CHECKED[question.key](self, value)

    def check(self) -> None:
        """The answers that options gave. Raises InvalidAnswer."""
        for key, check in _CHECKED.items():
            if key in self._given:
                self._given[key] = check(self, self._given[key])
        if self._given.get("flight_critical"):
            if self._given.get("recover") is False:
                raise InvalidAnswer("--flight-critical has no meaning with --no-recover: PHM restarts nothing then")
            if self._given.get("mavlink") == decided.NO_MAVLINK:
                raise InvalidAnswer("--flight-critical needs --mavlink: only the autopilot reports that it is disarmed")

    def answers(self) -> Answers:
        """All answers; every question must be answered. Raises InvalidAnswer."""
        given = self._given
        recover, mavlink = bool(given.get("recover")), str(given["mavlink"])
        critical = self._critical(given.get("flight_critical", ())) if recover and mavlink != decided.NO_MAVLINK else ()
        number = int(given["id"])
        return Answers(
            name=given.get("name") or f"agent_{number}",
            id=number,
            containers=tuple(given["containers"]),
            recover=recover,
            mavlink=mavlink,
            network=self._network(),
            flight_critical=tuple(critical),
            image=given.get("image") or decided.IMAGE,
            logs=_folder(given.get("logs") or "logs"),
        )

    def _questions(self) -> Sequence[Question]:
        """In order; a later default may need an earlier answer, so the list ends at the first that is open."""
        given = self._given
        asked = [Question("id", "--id", "MAVLink system id of the vehicle (1 to 250)", 1)]
        running = tuple(one.name for one in self._machine.applications if one.fact.running)
        asked.append(Question("containers", "--container", "Containers to watch, separated by spaces", running))
        if "containers" not in given:
            return asked
        if given["containers"]:
            asked.append(
                Question("recover", "--recover or --no-recover", "May PHM restart them when they fail?", False)
            )
        port = decided.ground(self._network())
        asked.append(Question("mavlink", "--mavlink", "MAVLink endpoint, or none", port))
        if (
            given["containers"]
            and given.get("recover")
            and given.get("mavlink", decided.NO_MAVLINK) != decided.NO_MAVLINK
        ):
            text = "Containers that PHM must not restart in flight, separated by spaces, or none"
            asked.append(Question("flight_critical", "--flight-critical", text, ()))
        return asked

    def _network(self) -> Network:
        chosen = self._given.get("network")
        if chosen in ("bridge", "host"):
            return "host" if chosen == "host" else "bridge"
        watched = self._given["containers"]
        return decided.network(decided.containers(self._machine, watched) if watched else ())

    # ------------------------------------------------------------ what is possible

    def _id(self, value: Any) -> int:
        try:
            return _ID.validate_python(value)
        except ValidationError as error:
            raise InvalidAnswer(f"--id: {value!r} is not an id: 1 to 250, but not 51 (SiK radios)") from error

    def _name(self, value: Any) -> str:
        try:
            return _NAME.validate_python(value)
        except ValidationError as error:
            allowed = "letters, digits, '_', '.' and '-', the first a letter or a digit"
            raise InvalidAnswer(f"--name: {value!r} is not a name: allowed are {allowed}") from error

    def _containers(self, value: Any) -> tuple[str, ...]:
        names = _words(value)
        try:
            return tuple(one.name for one in decided.containers(self._machine, names)) if names else ()
        except decided.UnknownContainer as error:
            raise InvalidAnswer(f"--container: {error}") from error

    def _critical(self, value: Any) -> tuple[str, ...]:
        names = _words(value)
        try:
            found = {one.name for one in decided.containers(self._machine, names)} if names else set()
        except decided.UnknownContainer as error:
            raise InvalidAnswer(f"--flight-critical: {error}") from error
        if "containers" not in self._given:
            return tuple(names)  # compared when they are known: `answers`
        watched = self._given["containers"]
        if unwatched := sorted(found - set(watched)):
            raise InvalidAnswer(f"--flight-critical: {unwatched[0]} is not among the containers to watch: {watched}")
        return tuple(name for name in watched if name in found)

    def _mavlink(self, value: Any) -> str:
        if value in ("", decided.NO_MAVLINK):
            return decided.NO_MAVLINK
        try:
            return EndpointSettings(url=str(value)).url
        except ValidationError as error:
            said = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
            raise InvalidAnswer(f"--mavlink: {said}, or {decided.NO_MAVLINK}") from error

    def _recover(self, value: Any) -> bool:
        return bool(value)


_CHECKED = {
    "id": Interview._id,
    "name": Interview._name,
    "containers": Interview._containers,
    "recover": Interview._recover,
    "mavlink": Interview._mavlink,
    "flight_critical": Interview._critical,
}


def _folder(path: str) -> str:
    """A path as a Compose file takes it: without `./` a word would be the name of a volume."""
    return path if path.startswith(("/", "./", "../")) else f"./{path}"


def _words(value: Any) -> tuple[str, ...]:
    """Names as an option gives them, or in one text; `none` means an empty list."""
    words = value.replace(",", " ").split() if isinstance(value, str) else value
    return () if list(words) == ["none"] else tuple(words)
