"""The application may use 3 % of one core."""

from __future__ import annotations

import time

from sitl.faults._cgroups import update
from sitl.faults.base import Agent, Fault, undoing

SHARE = 0.03
PERIOD_US = 100_000


class Injection(Fault):
    """``docker update --cpus 0.03``, or the same as a quota where the container has no limit: this engine cannot take back
    `--cpus`, so only the quota lets `clear` restore what was before."""

    name, title, unit = "cpu_limited", "CPU limit lowered to 3 %", "pressure/ros_app"
    condition = "cpu_throttled"
    layer = "container"
    cause = "the application's CPU limit is far below what it needs"
    healable = False
    needs = frozenset({"starvation"})
    evidence, evidence_s = "the first period of 0.1 s in which the kernel stops the container", 0.3
    evidence_period_s = 0.1

    _restore: list[str] = []

    def inject(self, agent: Agent) -> float:
        app = agent.app
        host = app.attrs["HostConfig"]
        limit = ["--cpu-period", str(PERIOD_US), "--cpu-quota", f"{SHARE * PERIOD_US:.0f}"]
        restore = ["--cpu-period", str(host["CpuPeriod"] or PERIOD_US), "--cpu-quota", str(host["CpuQuota"] or -1)]
        if host["NanoCpus"]:
            limit, restore = ["--cpus", str(SHARE)], ["--cpus", f"{host['NanoCpus'] / 1e9:.9f}"]
        self._restore = self._restore or restore
        moment = time.monotonic()
        with undoing(lambda: self.clear(agent)):
            update(app, *limit)
        return moment

    def clear(self, agent: Agent) -> None:
        if self._restore:
            update(agent.app, *self._restore)
            self._restore = []

    def restored(self, agent: Agent) -> bool | None:
        host = agent.app.attrs["HostConfig"]
        return bool(host["NanoCpus"] != SHARE * 1e9 and host["CpuQuota"] != int(SHARE * PERIOD_US))
