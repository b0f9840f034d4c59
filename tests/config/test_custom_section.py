"""The section `custom`: each mistake is named at its line, and what is allowed."""

from __future__ import annotations

import pytest

from phm.config import ConfigError, loads

APP = "containers:\n  - {name: app, recover: true}\n  - {name: other}\n"
UNITS = ("container/app", "container/other", "custom/web", "custom/ssh")
TCP = "name: ssh, type: tcp, host: localhost, port: 22"


def refused(entries: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        loads(
            f"{APP}custom:\n{entries}",
            "phm.yaml",
            environ={},
            known_checks=("container", "custom"),
            units_of=lambda settings: (UNITS, {}),
        )
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("entry", "problem"),
    [
        ("{name: a, host: x}", "custom[0].type: is missing: it says what the entry is"),
        ("{name: a, type: tccp}", "custom[0].type: unknown type 'tccp', did you mean 'tcp'?"),
        ("abc", "custom[0]: is text 'abc', expected a section with keys"),
        (f"{{{TCP}, prot: 1}}", "custom[0].prot: unknown key 'prot', did you mean 'port'?"),
        ("{name: a, type: tcp, host: x, port: 70000}", "custom[0].port: is 70000, allowed is 1 to 65535"),
        ("{name: a, type: tcp, host: '1.2.3.4:55', port: 55}", "custom[0].host: the host '1.2.3.4:55' has ':'"),
        ("{name: a, type: tcp, host: 1.2.3.400, port: 7}", "custom[0].host: the host '1.2.3.400' is not an IPv4 address"),
        ("{name: a, type: tcp, host: x/y, port: 7}", "custom[0].host: is 'x/y', allowed is the name or IP address"),
        (f"{{{TCP}, period: 0.1}}", "custom[0].period: is 0.1, allowed is 0.5 to 3600 seconds"),
        (f"{{{TCP}, brief: 'zu kalt °C'}}", "custom[0].brief: is 'zu kalt °C', allowed is printable ASCII characters"),
        (f"{{{TCP}, needs: [contaner/app]}}", "custom[0].needs[0]: unknown unit 'contaner/app', did you mean 'container/app'"),
        (f"{{{TCP}, needs: [container]}}", "custom[0].needs[0]: unknown unit 'container'"),
        (f"{{{TCP}, needs: [custom/ssh]}}", "custom[0].needs[0]: is 'custom/ssh', the check itself"),
        (f"{{{TCP}, recovery: {{container: ap}}}}", "custom[0].recovery.container: unknown container 'ap'"),
        (f"{{{TCP}, recovery: {{container: other}}}}", "custom[0].recovery.container: is 'other', which has no 'recover: true' (line 3)"),
        (f"{{{TCP}, level: warn, recovery: {{container: app}}}}", "custom[0].recovery: is never used with 'level: warn'"),
        ("{name: a, type: command, command: check_load -w 5}", "custom[0].command: is text 'check_load -w 5', expected a list of words, because no shell"),
        ("{name: a, type: command, command: [x], container: ap}", "custom[0].container: unknown container 'ap'"),
        ("{name: a, type: command, command: []}", "custom[0].command: is []"),
        ("{name: a, type: http, url: 'ftp://x/'}", "custom[0].url: is 'ftp://x/', allowed is http://HOST"),
        ("{name: a, type: http, url: 'http://me:pw@x/'}", "custom[0].url: is 'http://me:pw@x/', allowed is http://HOST"),
        ("{name: a, type: http, url: 'http://x:99999/'}", "custom[0].url: 'http://x:99999/' has no valid host and port"),
        ("{name: a, type: http, url: 'http://x/', body: '('}", "custom[0].body: is '(', which is not a regular expression"),
        ("{name: a, type: http, url: 'http://x/', equals: 3}", "custom[0].equals: is never used without 'json_field'"),
        ("{name: a, type: http, url: 'http://x/', json_field: f, equals: [1]}", "custom[0].equals: is a list, expected true or false, text or a number"),
        ("{name: a, type: topic, topic: /t, field: data, equals: [1]}", "custom[0].equals: is a list, expected true or false, a number or text"),
        ("{name: a, type: topic, topic: /t, field: data, equals: .inf}", "custom[0].equals: is inf, expected a finite number"),
        (f"{{name: a, type: topic, topic: /t, field: data, equals: {'x' * 101}}}", "custom[0].equals: is 'xxx"),
        ("{name: a, type: log, patterns: [{pattern: x}]}", "custom[0]: has no log: give 'path' or 'container'"),
        ("{name: a, type: log, path: /x, container: app, patterns: [{pattern: x}]}", "custom[0]: has 'path' and 'container'"),
        ("{name: a, type: log, path: /x, patterns: [{pattern: '['}]}", "custom[0].patterns[0].pattern: is '[', which is not"),
        ("{name: a, type: process, process: [x], min_count: 3, max_count: 2}", "custom[0].min_count: is 3, above 'max_count' which is 2"),
        (f"{{{TCP}, grace: 60, recovery: {{container: app}}}}", "custom[0].grace: is 60, above 'verify' which is 30"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_line(entry: str, problem: str) -> None:
    """The index in the list is the place, whatever the type."""
    (found,) = refused(f"  - {entry}\n")
    assert found.startswith(f"phm.yaml:5: {problem}")


def test_the_list_of_units_is_named_where_a_unit_is_unknown() -> None:
    """`phm checks` alone lists names of checks, which are no units. With the need that is wrong it lists nothing."""
    (found,) = refused(f"  - {{{TCP}, needs: [container]}}\n")
    assert found.endswith("(without this need, `phm checks --graph` lists them)")


def test_names_are_unique_over_all_types() -> None:
    """Each is a unit."""
    web = "  - {name: ssh, type: http, url: http://localhost/}\n"
    assert refused(f"  - {{{TCP}}}\n{web}") == [
        "phm.yaml:6: custom[1].name: check 'ssh' is defined twice, first in line 5: keep one"
    ]


def test_needs_of_each_other_are_named_with_their_line() -> None:
    """A longer way round is a cycle, too; it is reported once, at its first need."""
    ways = "".join(
        f"  - {{name: {name}, type: tcp, host: x, port: 7, needs: [custom/{need}]}}\n"
        for name, need in (("a", "b"), ("b", "c"), ("c", "a"), ("d", "a"))
    )
    (found,) = refused(ways)
    assert found.startswith(
        "phm.yaml:5: custom[0].needs[0]: dependency cycle: custom/a -> custom/b -> custom/c -> custom/a"
    )
