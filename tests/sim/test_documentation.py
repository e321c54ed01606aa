"""What docs/simulator.md shows is true: its files, its shell, its programs, and that its tables leave nothing out."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from gateway.sim.control import REQUEST
from gateway.sim.drive_section import SimulatedDriveSection
from gateway.sim.fault_section import FaultSection
from gateway.sim.faults import Kind
from gateway.sim.installation import Installation
from gateway.sim.journal import Way
from gateway.sim.questions import table
from gateway.sim.runner import opened
from gateway.sim.scenario import When
from gateway.sim.settings import SimulatedLineConfig, build, from_options, install, load
from tests.sim.test_port import keep_gap
from tests.sim.test_wire import READ, heard

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "simulator.md").read_text(encoding="utf-8")
EXAMPLES = sorted((ROOT / "config" / "simulated").glob("*.toml"))
PATIENCE = 20.0  # seconds for what takes milliseconds
HOUR = 3600.0

SCHEMA = REQUEST.json_schema(by_alias=True)
REQUESTS: dict[str, dict[str, Any]] = {
    do: SCHEMA["$defs"][path.rsplit("/", 1)[1]] for do, path in SCHEMA["discriminator"]["mapping"].items()
}


def blocks(language: str) -> list[str]:
    """Return the page's code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def rows(section: str, place: int = 0) -> dict[str, str]:
    """Return the rows of a section's table: the words of its first column, and the rest."""
    body = PAGE.split(f" {section}\n", 1)[1].split("\n#", 1)[0]
    tables = [paragraph.partition("|---")[2] for paragraph in body.split("\n\n") if "|---" in paragraph]
    found: dict[str, str] = {}
    for row in re.findall(r"^\| (`.*?) \|(.*)\|$", tables[place], re.MULTILINE):
        found |= dict.fromkeys(re.findall(r"`([a-z_0-9]+)`", row[0]), row[1])
    return found


def played(line: Installation, until: float = HOUR) -> list[str]:
    """Let a master ask number 1 every half second for so long; return what was done to the line."""
    notes: list[str] = []
    line.wire.journal.listen(lambda entry: notes.append(entry.note) if entry.way is Way.EVENT else None)
    begin = 0.0
    while begin < until:
        line.wire.feed(READ, begin)
        begin += 0.5
        list(heard(line.wire, begin))
    return notes


class TestFiles:
    def test_the_file_on_the_page_is_right(self, tmp_path: Path) -> None:
        """It loads, its drives can be built, and it shows every key but one of the line."""
        (tmp_path / "line.toml").write_text(blocks("toml")[0])
        config = load(tmp_path / "line.toml")
        assert len(build(config).drives) == 2
        assert config.model_fields_set | {"catalogue"} == set(SimulatedLineConfig.model_fields)
        assert config.drive[0].model_fields_set == set(SimulatedDriveSection.model_fields)

    @pytest.mark.parametrize("place", range(len(blocks("toml"))))
    def test_what_its_files_let_happen_happens(self, tmp_path: Path, place: int) -> None:
        """Every block is a whole file, and all its events come within an hour and can be done."""
        (tmp_path / "line.toml").write_text(blocks("toml")[place])
        config = load(tmp_path / "line.toml")
        line = install(config, 0.0)
        notes = played(line)
        assert line.counts()["failed"] == 0
        assert {note.split(" ")[0] for note in notes} == {event.doing.do for event in config.event}

    @pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
    def test_the_examples_are_right(self, path: Path) -> None:
        """They load, and all their events can be done but for the adapter, which a line in memory has not."""
        config = load(path)
        line = install(config, 0.0)
        played(line)
        adapters = sum(event.doing.do in ("plug", "unplug") for event in config.event)
        assert line.counts()["failed"] == adapters
        assert line.counts()["done"] >= len(config.event) - adapters

    def test_the_example_of_a_scenario_lets_a_drive_time_out(self) -> None:
        """The pump trips by its own F803 where its wire is cut: 18H in its history."""
        line = install(load(ROOT / "config" / "simulated" / "scenario.toml"), 0.0)
        played(line, 299.0)
        assert line.drive("pump", 299.0).inverter.condition.past_trips[0] == 0x18


class TestTables:
    def test_they_name_every_fault_and_every_key_of_one(self) -> None:
        """Kinds in their table, keys in the text."""
        assert set(rows("Faults")) == {kind.value for kind in Kind}
        assert set(FaultSection.model_fields) <= set(re.findall(r"`([a-z_]+)`", PAGE))

    def test_they_name_every_key_of_an_event(self) -> None:
        """When it comes, and what it does."""
        assert set(rows("Scenarios")) == {*When.model_fields, "do"}

    def test_they_name_every_request_with_its_keys(self) -> None:
        """Those that may be left out in brackets, and no others."""
        told = rows("What can be done") | rows("What can be asked")
        assert set(told) == set(REQUESTS)
        for do, schema in REQUESTS.items():
            required = set(schema.get("required", [])) - {"do"}
            optional = set(schema["properties"]) - required - {"do"}
            cell = told[do].split("|")[0]
            assert set(re.findall(r"\[`([a-z_]+)`\]", cell)) == optional, do
            assert set(re.findall(r"(?<!\[)`([a-z_]+)`(?!\])", cell)) == required, do

    def test_they_name_every_count(self) -> None:
        """All keys of the statistics."""
        with opened(from_options(["1:vf-nc3"]), None) as line:
            counted = line.control.do({"do": "stats"})["result"]
        assert set(rows("What is counted")) == set(counted)

    def test_they_name_every_key_of_the_state_and_of_the_log(self) -> None:
        """A judge finds what it is told."""
        with opened(from_options(["1:vf-nc3"]), None) as line:
            state = line.control.do({"do": "state", "drive": 1})["result"]
        words = set(re.findall(r"`([a-z_0-9]+)`", PAGE))
        assert set(rows("What can be asked", 1)) == set(state)
        assert set(state["timeout"]) | set(state["selectors"]) <= words
        in_memory = install(from_options(["1:vf-nc3"]), 0.0)
        played(in_memory, 1.0)
        for entry in in_memory.wire.journal.last(10):
            assert set(table(entry, 0.0)) | {entry.way.value} <= words


class TestShell:
    """The session of the page, played in its order."""

    @pytest.fixture
    def session(self, tmp_path: Path) -> Iterator[Sequence[tuple[str, str]]]:
        """Start the line of the first block; yield the commands of the others and what they print."""
        first, *others = (block.replace("/tmp/line", str(tmp_path / "line")) for block in blocks("console"))  # noqa: S108
        ((command, printed),) = steps(first)
        arguments = [sys.executable, "-m", "gateway", *command.split()[1:]]
        with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
            assert process.stdout is not None
            told = "".join(process.stdout.readline() for _ in printed.splitlines())
            yield [(numbered(printed), numbered(told)), *(step for block in others for step in steps(block))]
            process.send_signal(signal.SIGTERM)

    @pytest.mark.e2e
    def test_the_session_of_the_page_is_what_happens(self, session: Sequence[tuple[str, str]]) -> None:
        """First contact in both protocols, and the control: each command prints what the page says."""
        (printed, told), *commands = session
        assert told == printed
        assert len(commands) > 6
        for command, output in commands:
            shell = command.replace("python -m", f"{sys.executable} -m")
            keep_gap()  # two programs owe each other 3.5 characters; nobody types as fast as that
            done = subprocess.run(
                ["bash", "-c", shell], capture_output=True, text=True, timeout=PATIENCE, check=False
            )
            assert done.stdout == output, (command, done.stderr)


def steps(block: str) -> Sequence[tuple[str, str]]:
    """Return the commands of a block, and what each prints."""
    return [(command, output) for command, output in re.findall(r"^\$ (.*)\n((?:(?!\$ ).*\n)*)", block, re.MULTILINE)]


def numbered(text: str) -> str:
    """Take the number of the pseudo-terminal out of a text."""
    return re.sub(r"/dev/pts/\d+", "/dev/pts/N", text)


@pytest.mark.e2e
@pytest.mark.parametrize("program", blocks("python"))
def test_the_programs_on_the_page_run(program: str) -> None:
    """Each Python block is a whole program."""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout
