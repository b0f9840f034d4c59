"""A container is killed in whose network namespace another one lives."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping

from docker.errors import NotFound

from sitl.faults._world import app_runs, network_namespace, runs
from sitl.faults.base import Agent, Fault, died

NODE = "node_4"


class Injection(Fault):
    """`docker kill` of the application while a container beside it has `network_mode: container:...`.

    Started again, the application has a new namespace, and its dependent one without an interface: PHM must restart it, too,
    and what breaks in it meanwhile is not a separate alarm. A ROS node in the dependent shows that.
    """

    name, title = "netns_owner_killed", "container killed, another shares its network"
    unit = "container/ros_app"
    condition = "exited"
    layer = "container"
    cause = "a container died in whose network namespace another one lives"
    needs = frozenset({"configuration"})
    prepared = "a container with a ROS node in the network namespace of the application"
    evidence, evidence_s = "the engine's event that the container has ended", 0.1

    def configuration(self, agent: Agent) -> Mapping[str, str]:
        graph, topics = "\n# The ROS graph of this agent.\n", "\n  # Topics that must have data, a list."
        return {
            graph: f"\n  - name: {self._dependent(agent)}\n    alias: dependent\n    recover: true\n{graph}",
            topics: f"\n    - name: /{agent.name}/{NODE}\n      container: dependent{topics}",
        }

    def prepare(self, agent: Agent) -> None:
        self.dismantle(agent)
        app = agent.app
        agent.docker.containers.run(
            app.attrs["Image"],
            [
                "python",
                "-m",
                "sitl.application.node",
                "--name",
                NODE,
                "--namespace",
                f"/{agent.name}",
                "--publish",
                "topic_4:10",
            ],
            name=self._dependent(agent),
            detach=True,
            # Fast DDS takes containers with one address for one machine and sends through shared memory, which they do not share.
            environment=[*app.attrs["Config"]["Env"], "FASTDDS_BUILTIN_TRANSPORTS=UDPv4"],
            # A container of the project, as far as its end goes: `docker compose down --remove-orphans` takes it, too.
            labels={**app.labels, "com.docker.compose.service": "dependent"},
            network_mode=f"container:{app.id}",
        )

    def dismantle(self, agent: Agent) -> None:
        with contextlib.suppress(NotFound):
            agent.docker.containers.get(self._dependent(agent)).remove(force=True)

    def inject(self, agent: Agent) -> float:
        app = agent.app
        before = app.attrs["State"]["FinishedAt"]
        moment = time.monotonic()
        app.kill()
        died(app, before)
        return moment

    def clear(self, agent: Agent) -> None:
        agent.app.start()

    def restored(self, agent: Agent) -> bool | None:
        dependent = agent.docker.containers.get(self._dependent(agent))
        owned = str(dependent.attrs["HostConfig"]["NetworkMode"]) == f"container:{agent.app.id}"
        return (
            app_runs(agent)
            and owned
            and runs(dependent)
            and network_namespace(dependent) == network_namespace(agent.app)
        )

    @staticmethod
    def _dependent(agent: Agent) -> str:
        return f"{agent.project}-dependent-1"
