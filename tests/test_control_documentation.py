"""docs/control.md is true: its sessions are played, its tables are asked of the door, and they leave nothing out."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.door import Door
from gateway.control.settings import OnLoss
from gateway.control.state import Standing
from gateway.modbus_tcp.mirror_map import ORDERS
from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig, from_options
from tests.controlled import DRIVE
from tests.mosquitto import Mosquitto, free_port, program
from tests.processes import gateway, until

PAGE = (Path(__file__).parents[1] / "docs" / "control.md").read_text(encoding="utf-8")
SHOWN = {"port": "/tmp/line", "mqtt": "1883", "tcp": "5020", "time": '"2026-03-01T12:00:00.000Z"'}  # noqa: S108
TIME = re.compile(r'"\d{4}-\d\d-\d\dT[\d:.]+Z"')
LOOKS = re.compile(r"mosquitto_sub |plc (?!.*127\.0\.0\.1 \d)")  # what may be looked at again until it has come
CLIENTS = ("mosquitto_pub", "mosquitto_sub", "mosquitto_rr")
F803 = 10.0  # seconds, and an answer may be late, on a machine that is busy with other tests
END = "@end of the answer@"


def blocks(language: str) -> list[str]:
    """Return the page's code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def rows(heading: str) -> list[list[str]]:
    """Return the cells of the first table behind a heading."""
    body = PAGE.split(f"# {heading}\n", 1)[1]
    found = re.search(r"^\|[^\n]*\n\|[-|]+\n((?:\|.*\n)+)", body, re.MULTILINE)
    assert found is not None
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in found[1].splitlines()]


def words(cell: str) -> list[str]:
    """Return what stands in backquotes."""
    return re.findall(r"`([a-z_]+)`", cell)


# ---- the sessions


@dataclass
class Shell:
    """A shell that is given one command after another; `exchanged` are texts of the page and what they are here."""

    process: subprocess.Popen[str]
    exchanged: dict[str, str]

    def run(self, command: str) -> str:
        """Run a command of the page and return what it prints, as the page would print it."""
        for shown, here in self.exchanged.items():
            command = command.replace(shown, here)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{command}\necho '{END}'\n")
        self.process.stdin.flush()
        lines = []
        while (line := self.process.stdout.readline().rstrip("\n")) != END:
            lines.append(f"{line}\n")
        return TIME.sub(SHOWN["time"], "".join(lines))

    def prints(self, command: str, expected: str) -> bool:
        """Run a command and say whether it prints that."""
        return self.run(command) == expected


@contextmanager
def shell(folder: Path, broker: int, tcp: int) -> Iterator[Shell]:
    """Start a shell whose MQTT clients go to this broker."""
    for name in CLIENTS:
        client = folder / name
        client.write_text(f'#!/bin/sh\nexec {program(name)} -h 127.0.0.1 -p {broker} "$@"\n')
        client.chmod(0o755)
    process = subprocess.Popen(
        ["sh"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env={"PATH": f"{folder}:{os.environ['PATH']}"}, cwd=folder, start_new_session=True,
    )  # fmt: skip
    try:
        yield Shell(process, {f"-p {SHOWN['tcp']}": f"-p {tcp}"})
    finally:
        os.killpg(process.pid, signal.SIGKILL)  # what it left in the background, too
        process.communicate(timeout=20)


def simulated(link: Path) -> SimulatedLineConfig:
    """Return the line that the page begins with, its drive's ramps shortened."""
    found = re.search(r"tosvert-gateway simulate --drive (\S+) --link /tmp/line", PAGE)
    assert found is not None
    config = from_options([found[1]]).model_dump(by_alias=True, exclude_unset=True)
    config["drive"][0]["registers"] = DRIVE["registers"]
    return SimulatedLineConfig.model_validate(config | {"link": str(link)})


@pytest.mark.e2e
@pytest.mark.hazard("H05")
def test_the_sessions_are_true(tmp_path: Path) -> None:
    """Every command in turn with its output; what takes a drive some seconds is looked at until it is there."""
    tcp = free_port()
    with SimulatedLine(simulated(tmp_path / "line")) as line, Mosquitto() as broker:
        text = blocks("toml")[0].replace(SHOWN["port"], str(tmp_path / "line"))
        text = text.replace(f":{SHOWN['mqtt']}", f":{broker.port}").replace(f":{SHOWN['tcp']}", f":{tcp}")
        text = text.replace("\nport =", '\nanswer_margin = "300ms"\nport =').replace('"1.5s" ', f'"{F803}s" ')
        (tmp_path / "gateway.toml").write_text(text)
        log = tmp_path / "log"
        with gateway(tmp_path / "gateway.toml", log), shell(tmp_path, broker.port, tcp) as played:
            online = 'mosquitto_sub -t tosvert/hall-3/pump-1/availability -C 1 -W 2'
            until(partial(played.prints, online, "online\n"), "the drive")
            until(lambda: line.state(1)["timeout"]["period"] == F803, "F803")
            heard = line.state(1)["messages_acknowledged"]
            until(lambda: line.state(1)["messages_acknowledged"] > heard + 3, "F803 to be read back")
            for block in blocks("console"):
                for shown in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                    command, _, expected = shown.partition("\n")
                    printed = played.run(command)
                    if LOOKS.match(command) and printed != expected:
                        until(partial(played.prints, command, expected), f"{command}: {expected}")
                    else:
                        assert printed == expected, command
        assert not line.state(1)["is_running"]
        assert line.state(1)["trip_code"] == 0
        for audit in blocks("text"):
            assert audit in log.read_text()


# ---- the tables

LINE = '[[line]]\nname = "a"\nport = "/dev/null"\n'


@dataclass
class FixedClock:
    """A clock that stands still."""

    time: float = 1000.0

    def now(self) -> float:
        """Return the one moment."""
        return self.time

    def wall(self) -> float:
        """Return the one moment."""
        return self.time

    def alarm(self) -> Any:
        """Make no timer: nobody waits here."""
        raise NotImplementedError


@dataclass
class Desk:
    """The door of one configured drive that is online, and its results."""

    door: Door
    results: list[Result] = field(default_factory=list)

    @classmethod
    def of(cls, text: str, **more: Any) -> Desk:
        """Build it from a file of the page."""
        table = {"gateway": {"name": "t"}} | tomllib.loads(text if "[[line]]" in text else LINE + text)
        table["line"][0]["drive"][0] |= more
        door = Door.of(site.build(table, "page", Path()), FixedClock())
        if "pump-1" in door.controls:
            facts = {"communication_timeout": 15, "timeout_action": 2, "command": 0}
            door.controls["pump-1"].presence.on_online(facts, {}, door.clock.now())
        return cls(door)

    def own(self, source: Source, *, is_armed: bool) -> None:
        """Give the lease to a source, and arm the drive for it."""
        control = self.door.controls.get("pump-1")
        if control is not None:
            control.lease.end()
            control.lease.take(source, self.door.clock.now())
            control.state.standing = Standing.ARMED if is_armed else Standing.DISARMED

    def ask(self, verb: Verb, source: Source, **more: Any) -> str:
        """Ask for something; return "yes", or why it is refused."""
        now = self.door.clock.now()
        results: list[Result] = []
        more = {"value": VALUES.get(verb), "name": "frequency_command" if verb is Verb.SET else ""} | more
        self.door.submit(Command("pump-1", verb, source, now, now + 1.0, **more), results.append)
        return str(results[0].reason) if results and results[0].status is Status.REFUSED else "yes"


VALUES = {
    Verb.FREQUENCY: Decimal(30),
    Verb.SET: Decimal(30),
    Verb.PRESET: Decimal(1),
    Verb.ACCELERATION: Decimal(2),
}
OWNER, OTHER = Source(Channel.MQTT, "owner"), Source(Channel.MQTT, "other")
PLC = Source(Channel.MODBUS_TCP, "10.0.0.7")
COLUMNS: list[tuple[Source, dict[str, Any]]] = [
    (OWNER, {}),
    (OTHER, {}),
    (PLC, {"sources": ["mqtt"]}),
    (OTHER, {"control": "direct"}),
    (OTHER, {"control": "off"}),
]
WHO = [(row, column) for row in rows("Who may do what") for column in range(len(COLUMNS))]


@pytest.mark.hazard("H04")
@pytest.mark.hazard("H37")
@pytest.mark.parametrize(("row", "column"), WHO, ids=lambda value: value[0] if isinstance(value, list) else None)
def test_who_may_do_what(row: list[str], column: int) -> None:
    """Each cell, for each command of its row; "armed" means that it is refused while the drive is disarmed."""
    source, more = COLUMNS[column]
    said = row[1 + column].strip("`")
    for verb in map(Verb, words(row[0])):
        for is_armed in (True, False):
            desk = Desk.of(blocks("toml")[0], **more)
            desk.own(OWNER, is_armed=is_armed)
            expected = said if said != "armed" else "yes" if is_armed else "not_armed"
            assert desk.ask(verb, source) == expected, (verb, is_armed)


@pytest.mark.hazard("H28")
@pytest.mark.hazard("H37")
@pytest.mark.parametrize("row", rows("Rights"), ids=lambda row: f"{row[0]} {row[1]}")
def test_what_rights_permit(row: list[str]) -> None:
    """Each row, asked by the owner of the lease while the drive is armed."""
    channel, name = row[0].split()
    source = Source(Channel(channel), name)
    verb = Verb(words(row[1])[0])
    asked: dict[str, Any] = {}
    if (raw := re.search(r"([0-9A-F]{4}) = (\d+)", row[1])) is not None:
        asked = {"address": int(raw[1], 16), "words": (int(raw[2]),)}
    elif (hertz := re.search(r"(\d+) Hz", row[1])) is not None:
        asked = {"value": Decimal(hertz[1])}
    desk = Desk.of(blocks("toml")[1])
    desk.own(source, is_armed=True)
    assert desk.ask(verb, source, **asked) == row[2].strip("`")


def test_every_command_is_told() -> None:
    """With what it takes and what it writes."""
    told = PAGE.split("| command | with | writes |", 1)[1].split("\n\n", 1)[0]
    assert {word for row in told.splitlines()[2:] for word in words(row.split("|")[1])} == set(Verb)


def test_every_reason_and_every_status_is_told() -> None:
    """Nobody is refused without a word on what to do."""
    assert [word for row in rows("Reasons") for word in words(row[0])] != []
    assert {word for row in rows("Reasons") for word in words(row[0])} == set(Reason) - {Reason.NONE}
    assert {word for row in rows("Take, arm, run, heartbeat, release") for word in words(row[0])} == set(Status)


def test_every_way_of_dealing_with_a_loss_is_told() -> None:
    """As the configuration spells them."""
    told = PAGE.split("\n`on_loss` can be ", 1)[1].split("\n\n", 1)[0]
    spelled = {"{ frequency = 10.0 }" if loss is OnLoss.FREQUENCY else f'"{loss.value}"' for loss in OnLoss}
    assert {word for word in spelled if f"`{word}`" in told} == spelled


def test_the_codes_of_the_command_register_are_those_of_the_map() -> None:
    """By their words."""
    told = PAGE.split("Codes of the command register: ", 1)[1].split(". ", 1)[0].replace("\n", " ")
    found = re.findall(r"(\d+) ([a-z ]+)", told)
    codes = {int(code): text.replace(" in ", " ").replace(" ", "_") for code, text in found}
    assert codes == {code: order.word for code, order in ORDERS.items() if code in codes}
    assert set(codes) == set(range(1, 10))
