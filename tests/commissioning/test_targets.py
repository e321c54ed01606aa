"""Whom a command is for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway.commissioning.targets import Chosen, target_of, whole_path
from gateway.errors import BadConfig

FILE = """
[gateway]
name = "g"
[[line]]
name = "a"
port = "/dev/ttyUSB0"
{drives}
[[line.group]]
name = "fans"
drives = ["fan-2", "fan-1"]
"""
FAN = '[[line.drive]]\nname = "fan-{0}"\nnumber = {0}\nmodel = "vf-nc3"\n'
SECOND = (
    '[[line]]\nname = "b"\nport = "/dev/ttyUSB1"\n'
    '[[line.drive]]\nname = "pump"\nnumber = 9\nmodel = "vf-mb1"\nprotocol = "toshiba-binary"\n'
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Return a configuration with one line."""
    path = tmp_path / "gateway.toml"
    path.write_text(FILE.format(drives="".join(FAN.format(number) for number in (1, 2, 3))))
    return path


@pytest.fixture
def two_lines(file: Path) -> Path:
    """Return a configuration with two lines."""
    file.write_text(file.read_text() + SECOND)
    return file


def names(**chosen: Any) -> tuple[str, list[str], bool]:
    """Return line, drives and whether they are a group."""
    target = target_of(Chosen(**chosen))
    return target.line.name, [drive.name for drive in target.drives], target.is_group


def test_a_drive_a_group_or_everyone_of_a_file(two_lines: Path) -> None:
    """Each with the line that they are on; a group in its own order."""
    assert names(config=two_lines, drive="pump") == ("b", ["pump"], False)
    assert names(config=two_lines, group="fans") == ("a", ["fan-2", "fan-1"], True)
    assert names(config=two_lines, everyone=True, line="a") == ("a", ["fan-1", "fan-2", "fan-3"], True)


def test_everyone_needs_no_line_where_there_is_one(file: Path) -> None:
    """And all drives of the line stay known, for the frames of groups."""
    assert names(config=file, everyone=True)[0] == "a"
    assert len(target_of(Chosen(config=file, drive="fan-1")).line.drives) == 3


def test_one_drive_without_a_file(tmp_path: Path) -> None:
    """Line and drive as a configuration would make them, further catalogue files too."""
    extra = tmp_path / "own.toml"
    extra.write_text(
        '[model]\nname = "own"\ntitle = "x"\nsource = "x"\n[[profile]]\nvalues = ["status"]\nevery = "1s"\n'
        '[[register]]\nname = "status"\naddress = 0xFD01\nkind = "status"\nsource = "x"\n'
    )
    target = target_of(
        Chosen(port="/dev/ttyUSB0", number=0, model="own", protocol="toshiba-ascii", catalogue=[extra],
               baud=9600, parity="none", wait_time="20ms")
    )  # fmt: skip
    (drive,) = target.drives
    assert (target.line.port, target.line.baud, target.line.parity) == ("/dev/ttyUSB0", 9600, "none")
    assert (drive.name, drive.number, drive.model.name, drive.wait_time) == ("number 0", 0, "own", 0.02)
    assert target.line.drives == target.drives


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ({}, "give --config FILE with --drive"),
        ({"config": Path("x"), "port": "/dev/x"}, "give --config FILE with --drive"),
        ({"port": "/dev/x"}, "--port needs --number and --model as well"),
        ({"port": "/dev/x", "number": 1, "model": "vf-nc3", "group": "g"}, "give --config too"),
        ({"port": "ttyUSB0", "number": 1, "model": "vf-nc3"}, '--port: give the whole path: "/dev/ttyUSB0"'),
        ({"port": "/dev/x", "number": 1, "model": "vf-x"}, "--model: no model 'vf-x'; known: vf-as3, vf-mb1, vf-nc3"),
        ({"port": "/dev/x", "number": 300, "model": "vf-nc3"}, "--number: Input should be less than or equal to 247"),
        ({"port": "/dev/x", "number": 0, "model": "vf-nc3"}, "--number: modbus-rtu has the numbers 1 to 247"),
        ({"port": "/dev/x", "number": 1, "model": "vf-nc3", "baud": 1200}, "--baud: Input should be 9600, 19200"),
        ({"port": "/dev/x", "number": 1, "model": "vf-nc3", "wait_time": "5"}, "--wait-time: a duration in quotes"),
        ({"port": "/dev/x", "number": 1, "model": "vf-nc3", "protocol": "p"}, "--protocol: Input should be 'modbus"),
    ],
)
def test_what_is_wrong_is_named_after_its_option(chosen: dict[str, Any], said: str) -> None:
    """With what would be right."""
    with pytest.raises(BadConfig) as caught:
        target_of(Chosen(**chosen))
    assert said in str(caught.value)
    assert "line[0]" not in str(caught.value)


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ({}, "give one of --drive NAME, --group NAME and --everyone"),
        ({"drive": "pump", "everyone": True}, "give one of --drive NAME, --group NAME and --everyone"),
        ({"drive": "pump", "number": 1}, "--number and --model stand in the file"),
        ({"drive": "x"}, "--drive x: no such drive; known: fan-1, fan-2, fan-3, pump"),
        ({"group": "x"}, "--group x: no such group; known: fans"),
        ({"everyone": True}, "there are several lines; give --line NAME; known: a, b"),
        ({"everyone": True, "line": "c"}, "--line c: no such line; known: a, b"),
    ],
)
def test_what_is_not_in_the_file_is_answered_by_what_is(two_lines: Path, chosen: dict[str, Any], said: str) -> None:
    """Names of drives, groups and lines."""
    with pytest.raises(BadConfig) as caught:
        target_of(Chosen(config=two_lines, **chosen))
    assert said in str(caught.value)


def test_a_port_may_be_given_from_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A link to a simulated line; a name that is not here is not guessed at."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "line").touch()
    assert whole_path("line") == whole_path("./line") == str(tmp_path / "line")
    assert whole_path("./none") == str(tmp_path / "none")
    for port in ("ttyUSB0", "/dev/x", "socket://host:1"):
        assert whole_path(port) == port
    target = target_of(Chosen(port="line", number=1, model="vf-nc3"))
    assert target.line.port == str(tmp_path / "line")
