"""The settings of a valid file, the choice of the file, and files that cannot be read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from phm.config import ConfigError, Problem, find, load, loader, loads
from phm.config.yaml_scalars import resolve
from phm.config.yaml_tree import MAX_BYTES
from phm.core.settings import Settings

NAMES = ("host", "nodes")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"), ("yes", "yes"), ("off", "off"), ("NO", "NO"), ("true", True), ("False", False), ("~", None),
        ("", None), ("null", None), ("12:30:45", "12:30:45"), ("2024-12-03", "2024-12-03"), ("1e3", 1000.0), ("1.", 1.0),
        (".5", 0.5), ("+7", 7), ("007", 7), ("0o17", 15), ("0x1F", 31), ("1_000", "1_000"), ("0b1", "0b1"),
        ("-.inf", float("-inf")), ("9" * 64, "9" * 64), ("1e", "1e"), ("=", "="),
    ],
)  # fmt: skip
def test_plain_scalars_follow_yaml_1_2(text: str, value: object) -> None:
    """on/off, times and dates stay text, numbers with an exponent are numbers, long runs of digits stay text."""
    found = resolve(text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "name", "number"),
    [
        ("name: ${A}\n  id: ${N}", "drone", 7),
        ("name: x-${A}-${N}\n  id: ${N}${N}", "x-drone-7", 77),
        ("name: '${A}'\n  id: ${NONE:-9}", "drone", 9),
        ('name: "${EMPTY:-b}"\n  id: ${N:-9}', "b", 7),
        ("name: >-\n    ${A}\n  id: 1", "drone", 1),
        ('name: "${N}"\n  id: 1', "7", 1),
    ],
)
def test_variables_are_expanded_before_types_are_decided(text: str, name: str, number: int) -> None:
    """A variable works alone, inside a longer text and in quotes; alone and unquoted it may be a number."""
    read = loads(f"agent:\n  {text}\n", environ={"A": "drone", "N": "7", "EMPTY": ""})
    assert (read.agent.name, read.agent.id) == (name, number)


@pytest.mark.parametrize(
    ("text", "value"),
    [("$${A}", "${A}"), ("a$b", "a$b"), ("$A", "$A"), ("'${OTHER}'", "${A}"), ("${NONE:-}", None), ("$$${A}", "$${A}")],
)
def test_escapes_and_dollar_signs_are_literal(text: str, value: object) -> None:
    """`$${` is a literal `${`, other dollar signs are literal, and values of variables are not expanded again."""
    read = loads(f"checks:\n  host:\n    options:\n      x: {text}\n", environ={"A": "drone", "OTHER": "${A}"})
    assert read.checks["host"].options["x"] == value


def test_quantities_with_units_become_seconds_bytes_and_hertz() -> None:
    """The units of the model apply to values of the file, beside strictly typed values."""
    read = loads("interval: 2min\nlog: {max_size: 1MiB}\nhost: {cpu: {warn: 50%, error: 60}}\n", environ={})
    assert (read.interval, read.log.max_size, read.host.cpu.warn) == (120.0, 2.0**20, 50.0)


def test_anchors_avoid_repetition() -> None:
    """An alias is replaced by its anchor, as in YAML."""
    read = loads("host:\n  cpu: &limits {warn: 1, error: 2}\n  disk: *limits\n", environ={})
    assert read.host.disk == read.host.cpu


@pytest.mark.parametrize(("value", "interval"), [("5", 5.0), ("1min", 60.0), (" ", 20.0), ("", 20.0)])
def test_the_environment_overrides_the_interval(value: str, interval: float) -> None:
    """PHM_INTERVAL has priority over the file, with units; a blank value counts as unset."""
    assert loads("interval: 20s\n", environ={"PHM_INTERVAL": value}).interval == interval


def test_a_node_may_have_no_container_when_several_are_configured() -> None:
    """Its container is unknown then, and nothing is restarted for it."""
    read = loads("containers: [{name: a}, {name: b}]\nros: {nodes: [{name: /n}]}\n", environ={})
    assert read.container_of_node("/n") == ""


def test_a_topic_may_name_any_node_if_no_nodes_are_listed() -> None:
    """Without `ros.nodes` there is nothing to compare publishers with."""
    read = loads("ros: {topics: [{name: /t, publishers: [/n], subscribers: [/m]}]}\n", environ={})
    assert read.ros.topics[0].publishers == ["/n"]


def test_needs_may_name_a_check_or_one_unit_of_the_check_itself() -> None:
    """All nodes may depend on one node without a cycle."""
    text = "checks:\n  nodes:\n    needs: [host, nodes/a/one]\n"
    read = loads(text, environ={}, known_checks=NAMES, units_of=lambda settings: (("nodes/a/one",), {"nodes": ()}))
    assert read.checks["nodes"].needs == ["host", "nodes/a/one"]


def test_a_dependency_of_a_disabled_check_closes_no_cycle() -> None:
    """A check that does not run has no dependencies."""
    text = "checks:\n  host: {needs: [nodes]}\n  nodes: {needs: [host], enabled: false}\n"
    assert not loads(text, environ={}, known_checks=NAMES).checks["nodes"].enabled


def test_names_are_not_validated_without_the_installed_checks() -> None:
    """`known_checks=None` ignores names of checks, e.g. on a ground station."""
    assert "anything" in loads("checks: {anything: {}}\n", environ={}).checks


def test_a_byte_order_mark_and_windows_line_ends_are_harmless(tmp_path: Path) -> None:
    """Files from Windows editors are read, with the right line numbers."""
    path = tmp_path / "phm.yaml"
    path.write_bytes(b"\xef\xbb\xbfinterval: 5\r\nlog:\r\n  files: 0\r\n")
    with pytest.raises(ConfigError, match=r"phm\.yaml:3: log\.files: "):
        load(path, environ={})


def unreadable(folder: Path, kind: str) -> Path:
    """A path without a readable configuration, of one kind."""
    path = folder / "phm.yaml"
    match kind:
        case "directory":
            path.mkdir()
        case "empty":
            path.touch()
        case "latin-1":
            path.write_bytes(b"interval: 5\nagent:\n  name: M\xfcller\n")
        case "huge":
            path.write_bytes(b"# " + b"x" * MAX_BYTES)
        case "fifo":
            os.mkfifo(path)
        case "loop":
            path.symlink_to(path)
        case "below a file":
            path.touch()
            path /= "x.yaml"
    return path


@pytest.mark.parametrize(
    ("kind", "line", "words"),
    [
        ("missing", 0, "file not found"), ("directory", 0, "is a directory"), ("empty", 0, "is empty"),
        ("latin-1", 3, "is not UTF-8"), ("huge", 0, "is larger than 256 KiB"), ("fifo", 0, "is not a regular file"),
        ("loop", 0, "cannot be read"), ("below a file", 0, "file not found"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_is_one_problem(tmp_path: Path, kind: str, line: int, words: str) -> None:
    """Whatever is at the path, there is one problem with the reason, and nothing blocks."""
    path = unreadable(tmp_path, kind)
    with pytest.raises(ConfigError) as caught:
        load(path, environ={})
    (problem,) = caught.value.problems
    assert (problem.file, problem.line, problem.key) == (str(path), line, "")
    assert words in problem.message


def test_a_denied_permission_names_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    """Root may read anything, so here the system call itself is replaced."""

    def refuse(*_: object, **__: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(ConfigError, match=r"secret\.yaml: permission denied for user \d+: change its permissions"):
        load("secret.yaml", environ={})


def test_the_default_file_is_the_installed_one_or_that_of_the_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A given path has priority; without one, /etc/phm/phm.yaml, else config/phm.yaml."""
    installed = tmp_path / "phm.yaml"
    # By name: the package's attribute `load` is the function, not the module.
    monkeypatch.setattr(loader, "INSTALLED", installed)
    assert find("other.yaml") == Path("other.yaml")
    assert find() == Path("config/phm.yaml")
    installed.touch()
    assert find() == installed


def test_without_any_configuration_phm_init_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `phm run` in an empty folder says."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(loader, "INSTALLED", tmp_path / "none.yaml")
    with pytest.raises(
        ConfigError, match=r"config/phm\.yaml: file not found, nor /etc/phm/phm\.yaml: `phm init` writes"
    ):
        load(environ={})


yaml_like = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.sampled_from(["5s", "${A}", "/a", "a"])),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.one_of(st.text(max_size=8), st.sampled_from([*Settings.model_fields, "name", "cpu", "warn",
            "nodes", "topics", "needs", "files", "path", "ladders", "endpoints", "url", "label", "host"])), inner, max_size=5),
    ),
    max_leaves=20,
)  # fmt: skip


def outcome(text: str) -> Settings | tuple[Problem, ...]:
    """The only two outcomes; any other exception fails the test."""
    try:
        return loads(
            text,
            environ={"A": "x"},
            known_checks=NAMES,
            known_actions=("start",),
            units_of=lambda settings: ((), {"nodes": ("host",)}),
        )
    except ConfigError as error:
        return error.problems


def settings_or_problems(text: str) -> None:
    """Settings, or at least one problem, each of which is one printable line."""
    found = outcome(text)
    if isinstance(found, Settings):
        return
    assert found
    for problem in found:
        assert problem.line >= 0
        assert "\n" not in str(problem)
        str(problem).encode()


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet=st.characters(), max_size=200))
def test_any_text_gives_settings_or_problems(text: str) -> None:
    """No text ends in another exception."""
    settings_or_problems(text)


@settings(max_examples=300, deadline=None)
@given(st.text(alphabet="ab:-{}[]\"'\\U${}&*!|>%?@`#,\n \t~0.eE", max_size=120))
def test_any_mix_of_yaml_characters_gives_settings_or_problems(text: str) -> None:
    """Nor does text made of the special characters of YAML."""
    settings_or_problems(text)


@settings(max_examples=300, deadline=None)
@given(yaml_like)
def test_any_structure_gives_settings_or_problems(data: object) -> None:
    """Nor does well-formed YAML of any shape, with known keys in unknown places."""
    import yaml

    settings_or_problems(yaml.safe_dump(data, allow_unicode=True))


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_in_the_file_give_settings_or_problems(tmp_path_factory: pytest.TempPathFactory, raw: bytes) -> None:
    """Nor do bytes that are not text."""
    path = tmp_path_factory.getbasetemp() / "phm-any.yaml"
    path.write_bytes(raw)
    try:
        problems: tuple[Problem, ...] | None = None if load(path, environ={}) else ()
    except ConfigError as error:
        problems = error.problems
    assert problems is None or problems
