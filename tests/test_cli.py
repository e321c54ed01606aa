"""The command line, as far as it needs no port and no broker."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from unittest import mock

import pytest

from gateway.cli import run_command
from gateway.config import Config

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "config").glob("*.toml"))
TOLD = (  # of what is configured by a section, what `check` prints
    ("mqtt", "MQTT topics"),
    ("mqtt", "/availability"),
    ("sparkplug", "Sparkplug topics"),
    ("modbus_tcp", "MODBUS-TCP on"),
)
ALONE = """
[gateway]
name = "hall-3"
[[line]]
name = "a"
port = "/dev/ttyUSB0"
[[line.drive]]
name = "pump-1"
number = 1
model = "vf-nc3"
"""


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command as a user does."""
    return subprocess.run(
        [sys.executable, "-m", "gateway", *arguments], capture_output=True, text=True, check=False, cwd=ROOT
    )


def called(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in this process: all is imported already."""
    code: str | int | None = 0
    with (
        mock.patch.object(sys, "argv", ["tosvert-gateway", *arguments]),
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as errors,
        contextlib.chdir(ROOT),
    ):
        try:
            run_command()
        except SystemExit as end:
            code = end.code
    assert isinstance(code, int)
    return subprocess.CompletedProcess(arguments, code, out.getvalue(), errors.getvalue())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_check_prints_plan_topics_and_map_of_every_example(path: Path) -> None:
    """Topics and map of those that have them, and that nothing is wrong."""
    sections = tomllib.loads(path.read_text(encoding="utf-8"))
    done = called("check", str(path))
    assert done.returncode == 0, done.stderr
    for part in ("load with F875-F879", "no errors"):
        assert part in done.stdout
    for section, part in TOLD:
        assert (part in done.stdout) == (section in sections), part


def test_each_way_out_is_shown_by_an_example() -> None:
    """So that what `check` prints of it is seen above."""
    shown = {section for path in EXAMPLES for section in tomllib.loads(path.read_text(encoding="utf-8"))}
    assert shown >= {section for section, _ in TOLD}


def test_check_says_nothing_of_what_is_not_configured(tmp_path: Path) -> None:
    """A drive alone has a plan, and neither topics nor a map."""
    path = tmp_path / "gateway.toml"
    path.write_text(ALONE, encoding="utf-8")
    done = called("check", str(path))
    assert done.returncode == 0, done.stderr
    assert "load with F875-F879" in done.stdout
    assert not any(part in done.stdout for _, part in TOLD)


def test_the_schema_in_config_is_the_one_that_the_command_prints() -> None:
    """Generated: tosvert-gateway schema > config/schema.json."""
    printed = command("schema").stdout
    assert printed == (ROOT / "config" / "schema.json").read_text()
    assert json.loads(printed)["title"] == Config.__name__


def test_the_schema_knows_every_section_and_forbids_what_it_does_not_know() -> None:
    """An editor finds a misspelt key."""
    schema = json.loads(called("schema").stdout)
    assert set(schema["properties"]) == set(Config.model_fields)
    sections = [entry for entry in schema["$defs"].values() if "properties" in entry]
    assert all(section.get("additionalProperties") is False for section in sections)
    tomllib.loads((ROOT / "config" / "everything.toml").read_text())


def test_the_map_comes_as_markdown_csv_and_json() -> None:
    """The same registers in each; CSV with a heading and equal columns."""
    path = str(ROOT / "config" / "one-drive.toml")
    assert "FD00" in called("map", path).stdout
    rows = list(csv.reader(io.StringIO(called("map", path, "--format", "csv").stdout)))
    assert len(rows) > 20
    assert len({len(row) for row in rows}) == 1
    assert any("output_frequency" in row for row in rows)
    assert "output_frequency" in json.dumps(json.loads(called("map", path, "--format", "json").stdout))
    tags = list(csv.DictReader(io.StringIO(called("map", path, "--format", "tags").stdout)))
    assert "464769" in [tag["Address"] for tag in tags]


def test_a_strict_check_refuses_what_may_be_late(tmp_path: Path) -> None:
    """The plan is printed all the same; without --strict, and with more time, all is well."""
    example = (ROOT / "config" / "line-of-eight.toml").read_text(encoding="utf-8")
    late, kept = tmp_path / "late.toml", ROOT / "config" / "one-drive.toml"
    late.write_text(example.replace('"250ms"', '"20ms"'), encoding="utf-8")
    assert called("check", str(late)).returncode == 0
    refused = called("check", "--strict", str(late))
    assert (refused.returncode, "DOES NOT FIT" in refused.stdout) == (78, True)
    assert "line[0]" in refused.stderr
    assert "polls every 20 ms" in refused.stderr
    assert called("check", "--strict", str(kept)).returncode == 0


def test_registers_lists_what_a_model_has() -> None:
    """By number, with unit and access; derived values behind."""
    listed = called("registers", "vf-nc3").stdout
    assert "FD00  output_frequency" in listed
    assert "output_current_amps" in listed
    unknown = called("registers", "vf-s15")
    assert unknown.returncode == 78
    assert "known: vf-as3, vf-mb1, vf-nc3" in unknown.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("simulate",), "--drive NUMBER:MODEL"),
        (("simulate", "--drive", "1"), "1:vf-nc3"),
        (("simulate", "--drive", "1:vf-nc9"), "vf-nc9"),
        (("run", "nowhere.toml"), "nowhere.toml: cannot be read"),
        (("run", "config/one-drive.toml", "--loop", "trio"), "uvloop or asyncio"),
    ],
)
def test_what_is_wrong_with_a_call_is_said_in_a_line(arguments: tuple[str, ...], said: str) -> None:
    """Exit code 78, no traceback."""
    done = command(*arguments)
    assert done.returncode == 78
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_help_and_version() -> None:
    """Every command has a line of help; it says what this is not."""
    shown = command("--help").stdout
    daemon = ("run", "check", "map", "schema", "registers", "simulate", "demo")
    by_hand = ("scan", "read", "write", "display", "keys", "proportional")
    for name in (*daemon, *by_hand):
        assert name in shown
    assert "Not a safety" in shown
    assert command("--version").stdout.startswith("tosvert-gateway ")


def test_what_one_command_needs_no_other_waits_for() -> None:
    """Nobody who reads a value waits until the servers and the broker's client are imported."""
    program = "import sys, gateway.cli; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert "typer" in done.stdout.split()
    assert not {"aiohttp", "paho", "pymodbus", "uvloop"} & set(done.stdout.split())
