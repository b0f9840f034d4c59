"""Type `serial`: a serial port of the host exists and, if PHM may read it, data arrive on it."""

from __future__ import annotations

from phm import api
from phm_checks._custom.base import CustomCheck, Finding, bad, good
from phm_checks._text import span


class Serial(CustomCheck):
    """Without `max_age` the port is not opened."""

    @property
    def wakes(self) -> frozenset[str]:
        return super().wakes | {"device"}

    def observe(self, world: api.World) -> Finding:
        entry, path = self.entry, self.entry.device
        fact = world.devices.inspect(path, open_it=False)
        if fact is None:
            return bad(f"{path} does not exist: check the cable and the power of the device", "missing")
        if not fact.character:
            return bad(f"{path} is {fact.reason}, expected a character device", "no device")
        if entry.max_age is None:
            return good(f"{path} exists", description=fact.description)
        return self._data(world, path)

    def _data(self, world: api.World, path: str) -> Finding:
        entry = self.entry
        fact = world.serial.inspect(path, baud=entry.baud, line=entry.line or "")
        if fact.problem:
            raise api.CannotTell(f"{path} is not read: {fact.problem}")
        age_s = fact.data_s if entry.line is None else fact.line_s
        what = "data" if entry.line is None else f"line {entry.line!r}"
        if age_s is None and fact.open_s <= entry.max_age:
            raise api.CannotTell(f"no {what} received on {path} yet")
        silent_s = fact.open_s if age_s is None else age_s
        if silent_s <= entry.max_age:
            return good(f"{path}: {what} received {span(silent_s)} ago", age_s=round(silent_s, 1))
        words = f"{path}: no {what} received for {span(silent_s)}, expected every {span(entry.max_age)}"
        others = entry.line is not None and fact.data_s is not None and fact.data_s <= entry.max_age
        more = "; other data arrive: check baud rate and device" if others else "; check the device and the baud rate"
        return bad(words + more, "no line" if others else "no data", age_s=round(silent_s, 1))
