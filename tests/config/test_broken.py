"""Invalid configurations: each is rejected with the line, the key, the mistake and the allowed values."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from phm.config import ConfigError, Problem, loads

CHECKS = ("companion", "container", "files", "network", "nodes", "topics", "rates", "host")
ACTIONS = ("start", "restart", "unpause", "reconnect")
BUILTIN = {"files": {"container"}, "network": {"container"}, "nodes": {"container", "network"}, "topics": {"nodes"}}
UNITS = ("container/app", "nodes/a/one", "nodes/a/two", "host")
ENVIRON = {"WORD": "abc", "NUMBER": "300", "EMPTY": ""}


class Broken(NamedTuple):
    """The text of a file, and the expected problem: line, key, words in this order."""

    name: str
    text: str
    line: int
    key: str
    words: tuple[str, ...]


def refused(text: str, **environ: str) -> tuple[Problem, ...]:
    """All problems of a text that must be rejected."""
    with pytest.raises(ConfigError) as caught:
        loads(
            text, "phm.yaml", environ={**ENVIRON, **environ}, known_checks=CHECKS, known_actions=ACTIONS,
            units_of=lambda settings: (UNITS, BUILTIN),
        )  # fmt: skip
    return caught.value.problems


ONE = "containers:\n  - name: app\n"

BROKEN = [
    # readiness
    Broken("ready without a requirement", ONE + "    ready: {within: 9s}\n", 3, "containers[0].ready", ("services, topics",)),
    Broken(
        "lifecycle state of a container", ONE + "    ready: {lifecycle: active, services: [/a/s]}\n", 3,
        "containers[0].ready.lifecycle", ("lifecycle", "services"),
    ),
    Broken(
        "unknown lifecycle state", "ros: {nodes: [{name: /a/one, ready: {lifecycle: activ}}]}\n", 1,
        "ros.nodes[0].ready.lifecycle", ("active",),
    ),
    Broken(
        "ready topic that has a rate", "ros:\n  nodes: [{name: /a/one, ready: {topics: [/a/t]}}]\n  topics: [{name: a/t, rate: 5}]\n", 2,
        "ros.nodes[0].ready.topics[0]", ("'ros.topics'", "remove it"),
    ),
    Broken(
        "ready service twice", ONE + "    ready: {services: [/a/s, a/s]}\n", 3,
        "containers[0].ready.services[1]", ("service 'a/s' is defined twice",),
    ),
    Broken(
        "ready after the verification", ONE + "    ready: {services: [/a/s], within: 60s}\n", 3,
        "containers[0].ready.within", ("'verify'", "30 or less"),
    ),
    Broken(
        "verification before ready", ONE + "    ready: {services: [/a/s]}\nrecovery: {verify: 20s}\n", 4,
        "recovery.verify", ("'within' which is 30", "30 or more"),
    ),
    Broken(
        "ready silence without topics", ONE + "    ready: {services: [/a/s], silence: 9s}\n", 3,
        "containers[0].ready.silence", ("is never used without 'topics'",),
    ),
    Broken(
        "ready within the grace", ONE + "    ready: {services: [/a/s], within: 5s}\n", 3,
        "containers[0].ready.within", ("is 5, below ros.grace which is 8", "8 or more"),
    ),
    Broken(
        "ready topic of PHM", "ros: {nodes: [{name: /a/one, ready: {topics: [/diagnostics]}}]}\n", 1,
        "ros.nodes[0].ready.topics[0]", ("PHM publishes on /diagnostics itself", "ros.diagnostics.publish"),
    ),
    Broken(
        "ready topic with PHM's verdict", ONE + "    ready: {topics: [phm/consensus]}\n", 3,
        "containers[0].ready.topics[0]", ("PHM publishes on /phm/consensus itself", "ros.consensus.publish"),
    ),
    Broken(
        "rate of PHM's verdict", "ros: {topics: [{name: /phm/consensus, rate: 1}]}\n", 1,
        "ros.topics[0].rate", ("PHM publishes on /phm/consensus itself", "ros.consensus.publish"),
    ),
    # diagnostics of the application
    Broken(
        "diagnostics of no container", ONE + "ros: {diagnostics: {watch: [{name: x, container: ap}]}}\n", 3,
        "ros.diagnostics.watch[0].container", ("unknown container 'ap'", "did you mean 'app'?"),
    ),
    Broken(
        "diagnostics of no node", "ros: {nodes: [{name: /a/one}], diagnostics: {watch: [{name: x, node: /a/on}]}}\n", 1,
        "ros.diagnostics.watch[0].node", ("unknown node '/a/on'", "did you mean '/a/one'?"),
    ),
    Broken(
        "diagnostics twice", "ros:\n  diagnostics:\n    watch:\n      - name: x\n      - name: x\n", 5,
        "ros.diagnostics.watch[1].name", ("'x'", "line 4"),
    ),
    Broken(
        "diagnostics not listened to", "ros: {diagnostics: {listen: [], watch: [{name: x}]}}\n", 1,
        "ros.diagnostics.listen", ("is empty", "'watch'"),
    ),
    Broken(
        "diagnostics too impatient", "ros: {diagnostics: {watch: [{name: x, timeout: 0.1}]}}\n", 1,
        "ros.diagnostics.watch[0].timeout", ("0.5",),
    ),
    # what messages must contain
    Broken(
        "data without a rate", "ros:\n  topics:\n    - name: /a\n      data: {frozen: 2s}\n", 4, "ros.topics[0].data",
        ("requires 'rate' above 0",),
    ),
    Broken(
        "data of a latched topic", "ros:\n  topics:\n    - {name: /a, rate: 0Hz, data: {frozen: 2s}}\n", 3,
        "ros.topics[0].data", ("requires 'rate' above 0",),
    ),
    Broken(
        "data of nothing", "ros:\n  topics:\n    - {name: /a, rate: 1, data: {sample: 1Hz}}\n", 3, "ros.topics[0].data",
        ("examines nothing", "max_age, order, frozen, counter, ranges"),
    ),
    Broken(
        "gaps of no counter", "ros:\n  topics:\n    - {name: /a, rate: 1, data: {frozen: 1s, gaps: 1%}}\n", 3,
        "ros.topics[0].data.gaps", ("never used without 'counter'",),
    ),
    Broken(
        "range in the wrong order", "ros:\n  topics:\n    - {name: /a, rate: 1, data: {ranges: {x: [5, -5]}}}\n", 3,
        "ros.topics[0].data.ranges.x", ("is 5 to -5", "first number is the lowest"),
    ),
    Broken(
        "range of one number", "ros:\n  topics:\n    - {name: /a, rate: 1, data: {ranges: {x: [5]}}}\n", 3,
        "ros.topics[0].data.ranges.x", ("2",),
    ),
    Broken(
        "range of no field", "ros:\n  topics:\n    - {name: /a, rate: 1, data: {ranges: {'x[a]': [0, 1]}}}\n", 3,
        "ros.topics[0].data.ranges.x[a]", (),
    ),
    Broken(
        "too many samples", "ros:\n  topics:\n    - {name: /a, rate: 1, data: {frozen: 1s, sample: 100Hz}}\n", 3,
        "ros.topics[0].data.sample", ("100Hz", "4 Hz"),
    ),
    # what recovery needs
    Broken("after unknown", ONE + "    after: [ap]\n", 3, "containers[0].after[0]", ("unknown container 'ap'", "did you mean 'app'?")),
    Broken("after itself", ONE + "    after: [app]\n", 3, "containers[0].after[0]", ("cannot start after itself",)),
    Broken(
        "after an alias", ONE + "    after: [two]\n  - {name: two, alias: second}\n", 3, "containers[0].after[0]",
        ("container 'two' has the alias 'second'",),
    ),
    Broken(
        "after in a circle", ONE + "    after: [two]\n  - {name: two, after: [three]}\n  - {name: three, after: [app]}\n",
        5, "containers[2].after[0]", ("cycle", "three after app after two after three"),
    ),
    Broken(
        "copy of an absent file", ONE + "    recover: true\n    files: [{path: /a, present: false, restore: image}]\n",
        4, "containers[0].files[0].restore", ("'present: false'", "never restored"),
    ),
    Broken(
        "relaunch nowhere", ONE + "  - name: two\nros: {nodes: [{name: /a, relaunch: [run]}]}\n",
        4, "ros.nodes[0].relaunch", ("no container to run in", "'container'"),
    ),
    Broken(
        "relaunch without containers", "ros: {nodes: [{name: /a, relaunch: [run]}]}\n", 1, "ros.nodes[0].relaunch",
        ("no container to run in",),
    ),
    Broken(
        "process nowhere", ONE + "  - name: two\nros: {nodes: [{name: /a, process: [run]}]}\n",
        4, "ros.nodes[0].process", ("no container to search", "'container'"),
    ),
    Broken(
        "process without words", ONE + "ros: {nodes: [{name: /a, process: ['']}]}\n", 3, "ros.nodes[0].process[0]", (),
    ),
    Broken(
        "relaunch where nothing may be done", ONE + "ros: {nodes: [{name: /a, relaunch: [run]}]}\n", 3,
        "ros.nodes[0].relaunch", ("never used", "'app' has not opted in", "'recover: true'"),
    ),
    Broken(
        "relaunch in another that may not", "containers: [{name: app, recover: true}, {name: two, recover: false}]\n"
        "ros: {nodes: [{name: /a, container: two, relaunch: [run]}, {name: /b, container: app, relaunch: [run]}]}\n",
        2, "ros.nodes[0].relaunch", ("'two' has not opted in",),
    ),
    Broken(
        "copy where nothing may be done", ONE + "    files: [{path: /a, restore: image}]\n",
        3, "containers[0].files[0].restore", ("never used", "'app' has not opted in"),
    ),
    # the file as YAML
    Broken("empty", "", 0, "", ("is empty",)),
    Broken("only comments", "# nothing\n", 0, "", ("is empty",)),
    Broken("list at the top", "- agent\n", 1, "", ("top level is not a mapping", "'agent:'")),
    Broken("text at the top", "\nhello\n", 2, "", ("top level is not a mapping",)),
    Broken("tab", "agent:\n\tname: a\n", 2, "", ("tab used", "spaces")),
    Broken("unclosed list", "containers: [\n", 1, "", ("the '[' is not closed",)),
    Broken("unclosed quote", 'agent:\n  name: "abc\n', 2, "", ("the quote that begins here is not closed",)),
    Broken("two colons", "agent: name: a\n", 1, "", ("':'", "indentation")),
    Broken("missing colon", "agent:\n  name\n  id: 3\n", 3, "", ("':'", "line before")),
    Broken("two documents", "interval: 5\n---\ninterval: 6\n", 2, "", ("second document", "keep one")),
    Broken("tag", "agent:\n  name: !!python/name:os.system x\n", 2, "", ("tag", "not supported")),
    Broken("local tag", "interval: !secret x\n", 1, "", ("tag '!secret'",)),
    Broken("undefined alias", "agent:\n  name: *missing\n", 2, "", ("undefined alias 'missing'", "quotes")),
    Broken("control character", "agent:\n  name: a\x01b\n", 2, "", ("'\\x01'", "not allowed")),
    Broken("impossible escape", 'agent:\n  name: "\\UFFFFFFFF"\n', 2, "", ("invalid escape sequence",)),
    Broken("half a character", 'agent:\n  name: "\\uD800"\n', 2, "agent.name", ("text that is valid Unicode",)),
    Broken("deep", "checks: " + "[" * 60 + "]" * 60, 1, "", ("deeper than 24 levels",)),
    Broken("list as key", "? [a, b]\n: 1\n", 1, "", ("a key is a list or a mapping",)),
    Broken("merge key", "agent: &a {id: 2}\nlog:\n  <<: *a\n", 3, "log.<<", ("merge keys are not supported",)),
    Broken("cycle", "checks:\n  host:\n    options: &o\n      again: *o\n", 3, "checks.host.options.again", ("own anchor",)),
    # keys
    Broken("repeated key", "interval: 5\nagent: {}\ninterval: 6\n", 3, "interval", ("is defined twice", "line 1")),
    Broken("repeated key inside", "agent:\n  id: 2\n  id: 3\n", 3, "agent.id", ("is defined twice", "line 2")),
    Broken("unknown key", "intervall: 5\n", 1, "intervall",
           ("unknown key 'intervall', did you mean 'interval'? allowed: agent, interval, containers",)),
    Broken("unknown key inside", "log:\n  sink: a\n", 2, "log.sink", ("unknown key 'sink'", "directory, max_size")),
    Broken("unknown key in a list", ONE + "    restart: true\n", 3, "containers[0].restart", ("unknown key", "recover")),
    Broken("unknown key in a check", "checks:\n  host:\n    perod: 1\n", 3, "checks.host.perod", ("did you mean 'period'",)),
    Broken("empty key", "agent:\n  '': 5\n", 2, "agent.''", ("unknown key ''",)),
    Broken("missing path", ONE + "    files:\n      - present: true\n", 4, "containers[0].files[0].path", ("is missing",)),
    Broken("missing limit", "host:\n  cpu: {warn: 50}\n", 2, "host.cpu.error", ("is missing", "ERROR from here")),
    # types
    Broken("text for a number", "agent:\n  id: one\n", 2, "agent.id", ("is text 'one', expected a whole number",)),
    Broken("quoted number", "agent:\n  id: '7'\n", 2, "agent.id", ("is text '7', expected a whole number",)),
    Broken("fraction", "agent:\n  id: 1.5\n", 2, "agent.id", ("is the number 1.5, expected a whole number",)),
    Broken("number for a name", "agent:\n  name: 7\n", 2, "agent.name", ("whole number 7, expected text", "quotes")),
    Broken("yes", ONE + "    recover: yes\n", 3, "containers[0].recover", ("true or false", "write true")),
    Broken("off", "mavlink:\n  autopilot: off\n", 2, "mavlink.autopilot", ("is text 'off'", "write false")),
    Broken("one for true", "mavlink:\n  autopilot: 1\n", 2, "mavlink.autopilot", ("whole number 1, expected true or false",)),
    Broken("unknown word", "log:\n  sync: sometimes\n", 2, "log.sync", ("'sometimes'", "auto", "always", "never")),
    Broken("nothing for a list", "containers:\n", 1, "containers", ("is empty, expected a list", "remove the key")),
    Broken("mapping for a list", "containers:\n  name: app\n", 1, "containers", ("is a mapping, expected a list",)),
    Broken("text for a list", ONE + "    networks: net\n", 3, "containers[0].networks", ("expected a list", "[net]")),
    Broken("list for a section", "agent: [1]\n", 1, "agent", ("is a list, expected a section",)),
    Broken("nothing for a section", "ros:\n", 1, "ros", ("is empty, expected a section",)),
    Broken("list for a duration", "interval: [5]\n", 1, "interval", ("is a list, expected a number of seconds",)),
    # quantities
    Broken("wrong unit", "interval: 20 Hz\n", 1, "interval", ("wrong unit 'Hz'", "ms, s, min, h")),
    Broken("time of day", "interval: 12:30:45\n", 1, "interval", ("'12:30:45' is not a duration",)),
    Broken("wrong unit of size", "log:\n  max_size: 5s\n", 2, "log.max_size", ("wrong unit 's'", "kB, KB, MB")),
    Broken("true for a duration", "interval: true\n", 1, "interval", ("is not a duration", "number")),
    Broken("too short", "interval: 10ms\n", 1, "interval", ("is '10ms', allowed is 1 to 3600 seconds",)),
    Broken("infinite", "interval: .inf\n", 1, "interval", ("is inf, allowed is 1 to 3600 seconds",)),
    Broken("not a number", "docker:\n  timeout: .nan\n", 2, "docker.timeout", ("above 0, at most 60 seconds",)),
    Broken("share above 100", "host:\n  disk: {warn: 50, error: 120%}\n", 2, "host.disk.error", ("0 to 100 percent",)),
    Broken("too large", "agent:\n  id: 251\n", 2, "agent.id", ("is 251, allowed is 1 to 250",)),
    Broken("radio's number", "agent:\n  id: 51\n", 2, "agent.id", ("SiK", "choose another")),
    # patterns and choices
    Broken("name with a space", "agent:\n  name: my drone\n", 2, "agent.name", ("is 'my drone', allowed is letters",)),
    Broken("relative path", "run_dir: run/phm\n", 1, "run_dir", ("is 'run/phm'", "absolute path")),
    Broken("digest", ONE + "    files:\n      - {path: /a, sha256: abc}\n", 4, "containers[0].files[0].sha256", ("64 hex",)),
    Broken("message type", "ros:\n  topics:\n    - {name: /t, type: String}\n", 3, "ros.topics[0].type", ("std_msgs/msg",)),
    Broken("ros name", "ros:\n  nodes:\n    - name: /a//b\n", 3, "ros.nodes[0].name", ("a ROS name such as",)),
    Broken("choice", "recovery:\n  mode: acct\n", 2, "recovery.mode", ("is 'acct', allowed are act, advise, off",)),
    Broken("socket", "docker:\n  socket: /run/docker.sock\n", 2, "docker.socket", ("unix:///path or tcp://",)),
    Broken("endpoint", "mavlink:\n  endpoints:\n    - url: serial:1\n", 3, "mavlink.endpoints[0].url", ("udpout:HOST",)),
    Broken("port", "mavlink:\n  endpoints:\n    - url: tcp:h:99999\n", 3, "mavlink.endpoints[0].url", ("1 to 65535",)),
    # variables
    Broken("unset variable", "agent:\n  name: ${MISSING}\n", 2, "agent.name", ("${MISSING} is not set", ":-default")),
    Broken("unclosed variable", "agent:\n  name: ${WORD\n", 2, "agent.name", ("never closed",)),
    Broken("variable in braces", "agent: {id: ${NUMBER}}\n", 1, "", ("inside [] and {}", "quotes")),
    Broken("odd variable", "agent:\n  name: ${WORD:?no}\n", 2, "agent.name", ("'${WORD:?no}' is not a variable",)),
    Broken("variable in a default", "agent:\n  name: ${A:-${WORD}}\n", 2, "agent.name", ("default of ${A}",)),
    Broken("variable out of range", "agent:\n  id: ${NUMBER}\n", 2, "agent.id", ("is 300, allowed is 1 to 250",)),
    Broken("variable of wrong type", "agent:\n  id: ${WORD}\n", 2, "agent.id", ("is text 'abc'",)),
    Broken("empty variable", "agent:\n  name: ${EMPTY}\n", 2, "agent.name", ("is empty, expected text",)),
    # containers
    Broken("no identity", "containers:\n  - recover: true\n", 2, "containers[0]", ("neither 'name' nor 'label'",)),
    Broken("two identities", ONE + "    label: a=b\n", 3, "containers[0].label", ("only one of them",)),
    Broken("same container", ONE + "  - name: app\n", 3, "containers[1]", ("container 'app' is defined twice", "line 2")),
    Broken("same alias", ONE + "  - {name: b, alias: app}\n", 3, "containers[1]", ("'app' is defined twice",)),
    Broken("two aliases", ONE + "  - {name: app, alias: b}\n", 3, "containers[1].name", ("'app' is defined twice",)),
    Broken("label without value", "containers:\n  - label: a=\n", 2, "containers[0].label", ("empty value", "alias")),
    Broken("same file", ONE + "    files:\n      - path: /a\n      - path: //a/.\n", 5, "containers[0].files[1].path",
           ("file '/a' is defined twice", "line 4")),
    Broken("same device", ONE + "    devices:\n      - path: /dev/a\n      - path: /dev/a\n", 5,
           "containers[0].devices[1].path", ("device '/dev/a' is defined twice",)),
    Broken("same network", ONE + "    networks: [a, b, a]\n", 3, "containers[0].networks[2]", ("network 'a'",)),
    # ros
    Broken("same node", "ros:\n  nodes:\n    - name: /a/one\n    - name: a/one\n", 4, "ros.nodes[1].name", ("line 3",)),
    Broken("same topic", "ros:\n  topics:\n    - name: /t\n    - name: t\n", 4, "ros.topics[1].name", ("topic 't'",)),
    Broken("node's container", ONE + "ros:\n  nodes:\n    - {name: /n, container: ap}\n", 5, "ros.nodes[0].container",
           ("unknown container 'ap', did you mean 'app'?",)),
    Broken("node without containers", "ros:\n  nodes:\n    - {name: /n, container: app}\n", 3, "ros.nodes[0].container",
           ("none is configured",)),
    Broken("container by name beside its alias", "containers:\n  - {name: long, alias: short}\n"
           "ros:\n  topics:\n    - {name: /t, container: long}\n", 5, "ros.topics[0].container", ("alias 'short'",)),
    Broken("publisher", "ros:\n  nodes: [{name: /a/one}]\n  topics:\n    - name: /t\n      publishers: [/a/onee]\n", 5,
           "ros.topics[0].publishers[0]", ("unknown node '/a/onee', did you mean '/a/one'?", "ros.nodes")),
    Broken("subscriber", "ros:\n  nodes: [{name: /a/one}]\n  topics:\n    - name: /t\n      subscribers:\n"
           "        - a/one\n        - /zzz\n", 7, "ros.topics[0].subscribers[1]", ("unknown node '/zzz', allowed: /a/one",)),
    # mavlink
    Broken("same endpoint", "mavlink:\n  endpoints:\n    - url: tcp:h:1\n    - url: tcp:h:1\n", 4,
           "mavlink.endpoints[1].url", ("endpoint 'tcp:h:1' is defined twice",)),
    Broken("same endpoint name", "mavlink:\n  endpoints:\n    - {url: tcp:h:1, name: g}\n    - {url: tcp:h:2, name: g}\n",
           4, "mavlink.endpoints[1].name", ("endpoint name 'g'",)),
    Broken("same link id", "mavlink:\n  endpoints:\n    - {url: tcp:h:1, link_id: 3}\n    - {url: tcp:h:2, link_id: 3}\n",
           4, "mavlink.endpoints[1].link_id", ("3 is also used by the endpoint in line 3", "its own")),
    Broken("link id of a place", "mavlink:\n  endpoints:\n    - {url: tcp:h:1, link_id: 1}\n    - {url: tcp:h:2}\n",
           3, "mavlink.endpoints[0].link_id", ("1 is also used by the endpoint in line 4",)),
    Broken("nothing to receive on", "mavlink:\n  autopilot: true\n", 2, "mavlink.autopilot", ("no endpoints",)),
    Broken(
        "received on no endpoint", "mavlink:\n  endpoints: [{url: 'tcp:a:1', leads_to: ground}]\n  autopilot: true\n", 3,
        "mavlink.autopilot", ("no endpoint leads to it",),
    ),
    Broken(
        "critical, and no link", "containers:\n  - name: app\n    flight_critical: true\n", 3, "containers[0].flight_critical",
        ("no MAVLink endpoint leads to the autopilot", "add one to 'mavlink.endpoints'", "or remove this"),
    ),
    Broken(
        "critical, links elsewhere",
        "mavlink:\n  endpoints:\n    - {url: 'tcp:a:1', leads_to: ground}\n    - {url: 'tcp:a:2', leads_to: peers}\n"
        "containers:\n  - {name: app, flight_critical: true}\n", 6, "containers[0].flight_critical",
        ("no MAVLink endpoint leads to the autopilot",),
    ),
    Broken(
        "critical, and a link to anywhere",
        "mavlink:\n  endpoints:\n    - {url: 'tcp:a:1', leads_to: autopilot}\n    - {url: 'tcp:a:2'}\n"
        "containers:\n  - {name: app, flight_critical: true}\n", 4, "mavlink.endpoints[1]",
        ("has no 'leads_to'", "flight_critical (line 6)", "'leads_to: ground'"),
    ),
    Broken("autopilot's number", "mavlink:\n  component_id: 1\n", 2, "mavlink.component_id", ("allowed is 2 to 250",)),
    # pairs
    Broken("own diagnostics", "ros:\n  topics:\n  - {name: diagnostics, rate: 1Hz}\n", 3, "ros.topics[0].rate",
           ("cannot be measured while PHM publishes on /diagnostics", "ros.diagnostics.publish to false")),
    Broken("topic limits", "ros:\n  topics:\n  - {name: /t, rate: 1, error_tolerance: 5%}\n", 3,
           "ros.topics[0].error_tolerance", ("is 5", "10 or more")),
    Broken("limits", "host:\n  cpu:\n    warn: 99%\n    error: 98\n", 3, "host.cpu.warn", ("98 or less",)),
    Broken("warm", "host:\n  temperature_warn: 90C\n", 2, "host.temperature_warn", ("is 90", "85 or less")),
    Broken("cold", "host:\n  temperature_error: 70\n", 2, "host.temperature_error", ("is 70", "75 or more")),
    Broken(
        "relieve critical",
        "containers:\n  - {name: app, flight_critical: true}\nmavlink:\n  endpoints: [{url: 'udpin:0.0.0.0:14550'}]\n"
        "recovery:\n  relieve: [app]\n",
        6, "recovery.relieve[0]", ("flight-critical", "only other containers"),
    ),
    Broken(
        "relieve what a critical one needs",
        "containers:\n  - {name: app, flight_critical: true, after: [vpn]}\n  - {name: vpn, after: [base]}\n"
        "  - {name: base}\nmavlink:\n  endpoints: [{url: 'udpin:0.0.0.0:14550'}]\nrecovery:\n  relieve: [base]\n",
        8, "recovery.relieve[0]", ("'app' is flight-critical and needs it", "'after'", "remove this"),
    ),
    Broken("reserve", "recovery:\n  reserve: 6\n", 2, "recovery.reserve", ("is 6", "'budget'", "5 or less")),
    Broken("back-off", "recovery:\n  backoff: 2min\n", 2, "recovery.backoff", ("is 120", "'backoff_max'")),
    Broken("hold", "recovery:\n  hold: 5h\n", 2, "recovery.hold", ("is 18000", "'hold_max'")),
    Broken("manual stop", "recovery:\n  on_manual_stop: ignore\n", 2, "recovery.on_manual_stop",
           ("'ignore'", "heal", "advise", "respect")),
    Broken("window", "recovery:\n  maintenance:\n  - when: sun 2-4\n", 3, "recovery.maintenance[0].when",
           ("'sun 2-4'", "HH:MM-HH:MM")),
    Broken("window of no container", ONE + "recovery:\n  maintenance:\n  - {when: '02:00-04:00', container: ap}\n", 5,
           "recovery.maintenance[0].container", ("ap",)),
    Broken("same disk", "host:\n  disks: [/, /data, /data/]\n", 2, "host.disks[2]", ("disk '/data' is defined twice",)),
    Broken("room", "host:\n  free_disk:\n  - {path: /bags, files: [run/*.mcap]}\n", 3, "host.free_disk[0].files[0]",
           ("is 'run/*.mcap'", "without '/'")),
    Broken("all may go together", "host:\n  free_disk:\n  - {path: /bags, files: ['*'], older_than: 1s}\n", 3,
           "host.free_disk[0].older_than", ("is 1", "10 or more")),
    Broken("link to no container", ONE + "mavlink:\n  endpoints:\n  - {url: 'tcp:a:5760', container: rooter}\n", 5,
           "mavlink.endpoints[0].container", ("unknown container 'rooter'",)),
    Broken("commands through no container", ONE + "mavlink: {application: ap}\n", 3, "mavlink.application",
           ("unknown container 'ap', did you mean 'app'?",)),
    Broken("commands through a container and through nodes",
           ONE + "ros: {nodes: [{name: /a, commands: true}]}\nmavlink: {application: app}\n", 4, "mavlink.application",
           ("is 'app'", "nodes with 'commands: true' (line 3)", "remove one of the two")),
    Broken("commands through nodes and none", "ros: {nodes: [{name: /a, commands: true}]}\nmavlink: {application: none}\n",
           2, "mavlink.application", ("is 'none'", "(line 1)")),
    Broken("devices by folder", "host:\n  unexpected_devices: {watch: [/dev/*/by-id/x]}\n", 2,
           "host.unexpected_devices.watch[0]", ("is '/dev/*/by-id/x'", "a path below /dev")),
    # names of parts
    Broken("check", "checks:\n  nods: {}\n", 2, "checks.nods", ("unknown check 'nods', did you mean 'nodes'?",)),
    Broken("need", "checks:\n  host:\n    needs: [hots]\n", 3, "checks.host.needs[0]", ("unknown need 'hots'", "'host'")),
    Broken("need of a unit", "checks:\n  host:\n    needs: [nodes/a/on]\n", 3, "checks.host.needs[0]",
           ("unknown unit 'nodes/a/on', did you mean 'nodes/a/one'?",)),
    Broken("circle of two", "checks:\n  host: {needs: [rates]}\n  rates: {needs: [host]}\n", 2, "checks.host.needs[0]",
           ("cycle: host -> rates -> host",)),
    Broken("circle through built-in needs", "checks:\n  container:\n    needs:\n      - topics\n", 4,
           "checks.container.needs[0]", ("cycle: container -> topics -> nodes -> container",)),
    Broken("circle through a unit", "checks:\n  container: {needs: [nodes/a/one]}\n", 2, "checks.container.needs[0]",
           ("cycle: container -> nodes -> container",)),
    Broken("need of itself", "checks:\n  host: {needs: [host]}\n", 2, "checks.host.needs[0]", ("cycle: host -> host",)),
    Broken("action", "recovery:\n  ladders:\n    exited: [start, reboot]\n", 3, "recovery.ladders.exited[1]",
           ("unknown action 'reboot'", "reconnect, restart, start, unpause")),
]  # fmt: skip


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.name)
def test_a_mistake_is_reported_once_with_its_location(broken: Broken) -> None:
    """A file with one mistake has one problem, with its line, its key, and the allowed values."""
    problems = refused(broken.text)
    assert [(problem.file, problem.line, problem.key) for problem in problems] == [
        ("phm.yaml", broken.line, broken.key)
    ]
    start = 0
    for word in broken.words:
        assert word in problems[0].message[start:], problems[0].message
        start = problems[0].message.index(word, start)


def test_all_mistakes_are_reported_together_in_order_of_lines() -> None:
    """One error has the mistakes of YAML keys, types, variables, names and pairs of one file."""
    text = (
        "agent: {id: '${MISSING}'}\n"
        "intervall: 5\n"
        "containers: [{name: a}, {name: a}, {files: [{path: b}]}]\n"
        "host: {temperature_warn: 99C, disks: /}\n"
        "log: {files: 0}\n"
        "log: {}\n"
        "checks: {nods: {needs: [x]}}\n"
    )
    problems = refused(text, PHM_INTERVAL="soon")
    assert [(problem.line, problem.key) for problem in problems] == [
        (0, "interval"), (1, "agent.id"), (2, "intervall"), (3, "containers[1]"), (3, "containers[2]"),
        (3, "containers[2].files[0].path"), (4, "host.disks"), (4, "host.temperature_warn"), (5, "log.files"),
        (6, "log"), (7, "checks.nods"), (7, "checks.nods.needs[0]"),
    ]  # fmt: skip


def test_a_problem_is_printed_as_file_line_key_and_sentence() -> None:
    """The printed form is `file:line: key: message`, one problem per line."""
    with pytest.raises(ConfigError) as caught:
        loads("log:\n  files: 0\nmavlink:\n  autopilot: 1\n", "config/phm.yaml", environ={})
    assert str(caught.value).splitlines() == [
        "config/phm.yaml:2: log.files: is 0, allowed is 1 to 100",
        "config/phm.yaml:4: mavlink.autopilot: is the whole number 1, expected true or false",
    ]


@pytest.mark.parametrize(
    ("value", "words"),
    [("soon", "'soon' is not a duration"), ("0.1", "allowed is 1 to 3600 seconds"), ("5 Hz", "wrong unit 'Hz'")],
)
def test_a_wrong_interval_in_the_environment_is_named_as_such(value: str, words: str) -> None:
    """PHM_INTERVAL is validated like the key, and the problem names the environment variable."""
    (problem,) = refused("interval: 5\n", PHM_INTERVAL=value)
    assert str(problem).startswith("environment PHM_INTERVAL: interval: ")
    assert words in problem.message


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("udpout://10.0.0.5:14550", "write udpout:HOST:PORT, without //"),
        ("tcp://10.0.0.5:5760", "write tcp:HOST:PORT, without //"),
        ("udpin://0.0.0.0", "write udpin:HOST:PORT, without //"),
        ("/dev/ttyAMA0:115200", "the speed is the key 'baud'"),
        ("/dev/ttyAMA0,57600", "the speed is the key 'baud'"),
        ("/dev/serial/by-path/pci-0000:00:14.0-usb-0:1.2:1.0-port0:57600", "the speed is the key 'baud'"),
        ("udpout:1.2.3.4:14550:14551", "the host '1.2.3.4:14550' has ':' and is not an IPv6 address"),
        ("udpout:ground:14550:udp", "needs a host and a port"),
        ("udpout:300.1.2.3:14550", "the host '300.1.2.3' is not an IPv4 address"),
        ("udpout:10.0.5:14550", "the host '10.0.5' is not an IPv4 address"),
        ("udpout:[]:5", "needs a host and a port"),
    ],
)  # fmt: skip
def test_an_endpoint_as_other_tools_write_it_is_rejected(url: str, words: str) -> None:
    """Nothing would reach the ground."""
    (problem,) = refused(f"mavlink:\n  endpoints:\n    - url: '{url}'\n")
    assert (problem.line, problem.key) == (3, "mavlink.endpoints[0].url")
    assert words in problem.message and url in problem.message


@pytest.mark.parametrize(
    "url",
    [
        "/dev/ttyAMA0",
        "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1.2:1.0-port0",
        "/dev/serial/by-path/platform-fd500000.pcie-pci-0000:01:00.0-usb-0:1.3:1.0",
        "/dev/serial/by-path/platform-fe201000.serial:0",
        "udpout:::1:14550",
        "udpout:[fe80::1%eth0]:14550",
        "udpin:0:14551",
        "udpout:host.docker.internal:14550",
        "udpout:ground_pc:14550",
        "udpout:4.drone.lan:14550",
        "udpbcast:192.168.1.255:14550",
    ],
)
def test_an_endpoint_with_an_unusual_name_is_valid(url: str) -> None:
    """Names of devices have colons, hosts need not be IPv4 addresses."""
    settings = loads(f"mavlink: {{endpoints: [{{url: '{url}'}}]}}\n", environ={})
    assert settings.mavlink.endpoints[0].url == url


def test_an_alias_bomb_is_rejected() -> None:
    """Nine lines that expand to a billion values are rejected after a bounded amount of work."""
    lines = ["checks:", "  host:", "    options:", "      a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"      a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 10)}]" for level in range(1, 9)]
    (problem,) = refused("\n".join(lines))
    assert "more than 20000 values" in problem.message


def test_a_file_that_grows_by_its_variables_is_rejected() -> None:
    """A long variable, repeated, cannot fill the memory."""
    text = "checks:\n  host:\n    options:\n" + "".join(f"      k{n}: ${{LONG}}\n" for n in range(3000))
    problems = refused(text, LONG="x" * 4096)
    assert all("after expansion of its variables" in problem.message for problem in problems)


def test_a_message_is_short_and_on_one_line() -> None:
    """Whatever the file contains, a problem is one printable line, so that it cannot fake another."""
    problems = refused('agent:\n  name: "a\\nphm.yaml:1: fine"\n  "x\\ny\\e[31m": 1\n  id: "' + "z" * 5000 + '"\n')
    for problem in problems:
        assert str(problem).isprintable()
        assert len(str(problem)) < 300
