"""`phm logs bundle`: complete, bounded, and without the secrets that were planted everywhere."""

from __future__ import annotations

import gzip
import io
import json
import os
import stat
import tarfile
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, strategies as st

from phm.cli import group
from phm.logs import bundle as bundles
from phm.logs.secrets import MOST_LINE, Secrets, is_secret
from tests.logs.test_logs import note, record

KEY = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff"
DELIVERY_KEY = "ffeeddccbbaa99887766554433221100ffeeddccbbaa99887766554433221100"
HOOK = "json://robot:Pa55phrase@example.org/T0PSECRETPATH?x=Qu3ryT0ken"
SLACK = "slack://T1JJ3T3L2AAAA/A1BRTD4JD/TIiajkdnlazkcOXrIdevi7FQ"
PLANTED = (
    *(KEY, KEY.upper(), HOOK, "Pa55phrase", "T0PSECRETPATH", "Qu3ryT0ken", "TIiajkdnlazkcOXrIdevi7FQ", "T1JJ3T3L2AAAA"),
    *("env-v4lue-one", "env-v4lue-two", "c0mmented-0ut", "b3arer-in-a-log", "url-passw0rd", "block-l1ne-one"),
    *(DELIVERY_KEY, DELIVERY_KEY.upper()),
    *("MIIBVwIBADANBg", "j5on-in-a-log", "opti0n-value", 'quo"ted-s3cret', r"quo\"ted-s3cret"),
)


@pytest.fixture
def agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An agent with secrets in its configuration, environment, keys and logs. Returns its configuration."""
    for name, text in (("key", KEY), ("delivery.key", DELIVERY_KEY)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o600)
    config = tmp_path / "phm.yaml"
    config.write_text(
        f"""\
# password: c0mmented-0ut
agent: {{name: agent_1, id: 1}}
log: {{directory: {tmp_path / "log"}}}
state_dir: {tmp_path / "state"}
docker: {{socket: "unix://{tmp_path}/none.sock"}}
mavlink: {{signing: {{key: {tmp_path}/key}}}}
delivery: {{key: {tmp_path}/delivery.key}}
notify:
  urls: ["{HOOK}", "{SLACK}"]
"""
    )
    monkeypatch.setenv("PHM_API_TOKEN", "env-v4lue-one")
    monkeypatch.setenv("SOME_PASSWORD", "env-v4lue-two")
    monkeypatch.setenv("QUOTED_SECRET", 'quo"ted-s3cret')
    said = (
        f"with {DELIVERY_KEY} or {DELIVERY_KEY.upper()}",
        f"key {KEY} and {HOOK} and TIiajkdnlazkcOXrIdevi7FQ",
        "env-v4lue-one, env-v4lue-two, Authorization: Bearer b3arer-in-a-log",
        'http://user:url-passw0rd@example.org/x {"token": "j5on-in-a-log"} --password opti0n-value quo"ted-s3cret',
        "-----BEGIN PRIVATE KEY----- MIIBVwIBADANBg -----END PRIVATE KEY-----",
        "an ordinary line",
    )
    record(tmp_path / "log", *map(note, said))
    lines = (tmp_path / "log" / "phm.jsonl").read_bytes()
    (tmp_path / "log" / "phm.jsonl.1.gz").write_bytes(gzip.compress(lines) + b"damaged")
    return config


def bundle(config: Path, file: Path) -> Result:
    words = ["logs", "bundle", str(file), "-c", str(config), "--run-dir", str(file.parent / "run")]
    return CliRunner().invoke(group, words)


def members(file: Path) -> dict[str, bytes]:
    with tarfile.open(file) as archive:
        made = {member.name.partition("/")[2]: archive.extractfile(member) for member in archive}
        return {name: content.read() for name, content in made.items() if content is not None}


def test_no_planted_secret_is_in_the_bundle_or_on_the_terminal(agent: Path, tmp_path: Path) -> None:
    """Whatever the place it was planted in; what was removed is listed in both."""
    file = tmp_path / "problem.tar.gz"
    result = bundle(agent, file)
    assert result.exit_code == 0, result.output
    inside = members(file)
    for name, content in [*inside.items(), ("the terminal", result.output.encode())]:
        for secret in PLANTED:
            assert secret.encode() not in content, f"{secret} is in {name}"
    removed = inside["REMOVED.txt"].decode()
    for words in (
        "MAVLink signing key",
        "delivery key",
        "URL of notify.urls",
        "value of PHM_API_TOKEN",
        "logs/phm.jsonl",
        "phm.yaml",
    ):
        assert words in removed and words in result.output


def test_the_bundle_has_what_a_reader_needs(agent: Path, tmp_path: Path) -> None:
    """Logs that can be read, configuration, versions, environment, doctor, and what is missing with the reason."""
    file = tmp_path / "problem.tar.gz"
    bundle(agent, file)
    inside = members(file)
    wanted = {"phm.yaml", "versions.json", "environment.json", "doctor.txt", "REMOVED.txt", "MISSING.txt"}
    assert wanted | {"logs/phm.jsonl", "logs/phm.jsonl.1", "logs/phm.log"} == set(inside)
    texts = [json.loads(line).get("text") for line in inside["logs/phm.jsonl"].splitlines()]
    assert "an ordinary line" in texts and len(texts) == 7
    assert json.loads(inside["versions.json"])["phm"] and b"engine: " in inside["doctor.txt"]
    assert b"status.json" in inside["MISSING.txt"] and b"logs/phm.jsonl.1: the rest of it" in inside["MISSING.txt"]
    assert stat.S_IMODE(file.stat().st_mode) == 0o600


def test_a_key_that_cannot_be_read_is_listed(agent: Path, tmp_path: Path) -> None:
    """Where it appears it cannot be removed, so the reader of the bundle must know."""
    (tmp_path / "delivery.key").unlink()
    file = tmp_path / "problem.tar.gz"
    bundle(agent, file)
    assert b"delivery key: " in members(file)["MISSING.txt"]


def test_an_existing_file_is_not_replaced(agent: Path, tmp_path: Path) -> None:
    """And nothing is left behind."""
    file = tmp_path / "problem.tar.gz"
    file.write_text("mine")
    result = bundle(agent, file)
    assert result.exit_code == 1 and "exists already" in result.output and file.read_text() == "mine"
    assert not list(tmp_path.glob(".phm-bundle*"))


def test_a_configuration_that_is_not_yaml_is_left_out(agent: Path, tmp_path: Path) -> None:
    """Its secrets cannot be found; the rest is written."""
    agent.write_text('a: "\npassword: |\n  block-l1ne-one')
    file = tmp_path / "problem.tar.gz"
    assert bundle(agent, file).exit_code == 0
    inside = members(file)
    assert "phm.yaml" not in inside and b"phm.yaml: " in inside["MISSING.txt"]


def test_logs_are_capped_the_newest_first(agent: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not fit is listed."""
    monkeypatch.setattr(bundles, "MOST_LOG_BYTES", 600)
    file = tmp_path / "problem.tar.gz"
    bundle(agent, file)
    inside = members(file)
    assert "logs/phm.jsonl" in inside and "logs/phm.jsonl.1" not in inside and b"phm.jsonl.1" in inside["MISSING.txt"]


def test_links_and_pipes_are_not_read(tmp_path: Path) -> None:
    """A program that can write in the folder could put a link to a file of another user there, or a pipe that never ends."""
    (tmp_path / "shadow").write_text("root:secret-of-others\n")
    folder = tmp_path / "log"
    folder.mkdir()
    (folder / "phm.log").symlink_to(tmp_path / "shadow")
    (folder / "phm.jsonl.1.gz").symlink_to(tmp_path / "shadow")
    os.mkfifo(folder / "phm.jsonl")
    with tarfile.open(fileobj=io.BytesIO(), mode="w") as archive:
        made = bundles.Bundle(archive, Secrets())
        made.logs(folder)
    assert not made.written
    assert dict(made.missing) == {
        "logs/phm.log": "a symbolic link, which is not followed",
        "logs/phm.jsonl.1": "a symbolic link, which is not followed",
        "logs/phm.jsonl": "not a regular file",
    }


def test_a_log_that_was_cut_says_so(agent: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also if what was removed from it makes it shorter than the limit; one that fits does not say it."""
    log = tmp_path / "cut" / "phm.jsonl"
    log.parent.mkdir()
    log.write_text(json.dumps({"event": "note", "token": "x" * 100}) + "\n" + '{"event": "note", "text": "last"}\n')
    for limit, said in ((130, True), (log.stat().st_size, False)):
        monkeypatch.setattr(bundles, "MOST_LOG_BYTES", limit)
        with tarfile.open(fileobj=io.BytesIO(), mode="w") as archive:
            made = bundles.Bundle(archive, Secrets())
            made.logs(log.parent)
        assert (("logs/phm.jsonl", "the rest of it: too long") in made.missing) is said, made.missing


@pytest.mark.parametrize(
    ("name", "secret"),
    [
        *(
            ("API_KEY", True),
            ("dbPassword", True),
            ("GITHUB_TOKEN", True),
            ("x-auth", True),
            ("AWS_SECRET_ACCESS_KEY", True),
        ),
        *(("MONKEY", False), ("PATH", False), ("ROS_DOMAIN_ID", False), ("keyboard", False), ("author", False)),
    ],
)
def test_names_of_secrets_are_recognized(name: str, secret: bool) -> None:
    """By the parts of the name."""
    assert is_secret(name) is secret


@pytest.mark.parametrize("name", ["PWD", "OLDPWD"])
def test_the_current_directory_of_a_shell_is_not_a_secret(name: str) -> None:
    """Its path is in most lines of a log."""
    secrets = Secrets()
    secrets.learn_environment([f"{name}=/home/pi/phm"], "x")
    secrets.learn_tree({"environment": {name: "/home/pi/phm"}}, "x")
    assert secrets.clean(f"read /home/pi/phm/phm.yaml, {name}=/home/pi", "x").endswith(f"phm.yaml, {name}=/home/pi")
    tree = {"Env": [f"{name}=/home/pi/phm"], "environment": {name: "/home/pi/phm"}}
    assert secrets.clean_json(tree, "x") == tree and not secrets.removed


@pytest.mark.parametrize("entry", ["DB_PWD=/s3cret/value", "pwd=/s3cret/value", "PWD=s3cret/value"])
def test_other_values_of_such_names_are_removed(entry: str) -> None:
    """PWD is also the password of a database in ODBC, which is not a path."""
    name, _, value = entry.partition("=")
    secrets = Secrets()
    assert secrets.clean_json([entry, {name: value}], "x") == [f"{name}=<removed>", {name: "<removed>"}]
    secrets.learn_environment([entry], "x")
    assert "s3cret" not in secrets.clean(f"{entry} and {value}", "x")


def test_inspect_output_is_cleaned_by_its_structure() -> None:
    """Variables, options with their own value, labels, and keys of several lines."""
    tree = {
        "Config": {"Env": ["DB_PASSWORD=a b", "PATH=/bin"], "Cmd": ["run", "--token", "xyz", "--port", "1"]},
        "Labels": {
            "api.key": "abc",
            "note": "-----BEGIN RSA PRIVATE KEY-----\nMIIB\n-----END RSA PRIVATE KEY-----\nafter",
        },
    }
    cleaned = Secrets().clean_json(tree, "x")
    assert cleaned["Config"]["Env"] == ["DB_PASSWORD=<removed>", "PATH=/bin"]
    assert cleaned["Config"]["Cmd"] == ["run", "--token", "<removed>", "--port", "1"]
    assert cleaned["Labels"] == {"api.key": "<removed>", "note": "<removed>\nafter"}


@given(st.text(), st.text("ab./:@?=&", min_size=8), st.text())
def test_a_known_value_never_remains(before: str, value: str, after: str) -> None:
    """Whatever is around it."""
    secrets = Secrets()
    secrets.learn(value, "x")
    assert value not in secrets.clean(f"{before}{value}{after}", "y")


def test_a_cut_line_has_no_part_of_a_secret() -> None:
    """The cut goes through the known value: its first part is cut off, too."""
    secrets = Secrets()
    secrets.learn("s3cret" * 100, "x")
    assert "s3cret" not in secrets.clean("x" * (MOST_LINE - 300) + "s3cret" * 100, "y")


@pytest.mark.parametrize(
    "piece", ["a", "token", "key=", "://", "token_", "-----BEGIN ", "auth: ", "x.", "-token", '\\"']
)
def test_a_hostile_line_takes_bounded_steps(piece: str) -> None:
    """No pattern is quadratic: the longest line is done (a quadratic one would take minutes, and the test its limit)."""
    assert Secrets().clean("token " + piece * (MOST_LINE // len(piece)), "x")
