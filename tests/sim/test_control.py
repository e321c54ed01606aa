from __future__ import annotations

import json
import os
import select
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.errors import GatewayError
from gateway.sim.control import Control
from gateway.sim.lateness import Lateness
from gateway.sim.loop import LineLoop
from gateway.sim.runner import describe, opened
from gateway.sim.settings import SimulatedLineConfig, from_options
from tests.sim.rig import framed

PATIENCE = 10.0  # seconds for what takes milliseconds


@pytest.fixture
def loop() -> Iterator[LineLoop]:
    """Open a line of two drives that nobody runs: the test looks at it between requests."""
    config = SimulatedLineConfig.model_validate(
        {"drive": [{"number": 1, "model": "vf-nc3", "running_at": 30}, {"number": 2, "model": "vf-mb1"}]}
    )
    with opened(config, None) as line:
        yield line


def result(loop: LineLoop, **request: Any) -> Any:
    """Do a control request that must work."""
    answer = Control(loop).do(request)
    assert answer["ok"], answer
    return answer["result"]


def trip_code(loop: LineLoop, number: int) -> int:
    """Ask the control for the trip of a drive."""
    code: int = result(loop, do="state", drive=number)["trip_code"]
    return code


def test_state_tells_what_a_drive_is_and_holds(loop: LineLoop) -> None:
    """Frequency, registers and wear, as the drive has them."""
    state = result(loop, do="state", drive=1)
    assert (state["model"], state["frequency"], state["is_running"]) == ("vf-nc3", 30.0, True)
    assert state["registers"]["panel_frequency"] == 3000
    assert state["eeprom_writes"] == {}


def test_what_an_operator_does_at_a_drive_can_be_done(loop: LineLoop) -> None:
    """Set, run, trip and power cycle act on the drive that is named."""
    result(loop, do="set", drive=2, register="free_notes", value=5)
    result(loop, do="run", drive=2, frequency=10, reverse=True)
    drive = loop.wire.drives[1].inverter
    assert (drive.memory.word("free_notes"), drive.operation.target) == (5, -10.0)
    result(loop, do="trip", drive=2, code=13)
    assert (trip_code(loop, 2), trip_code(loop, 1)) == (13, 0)
    result(loop, do="power_cycle", drive=2, seconds=3.0)
    assert trip_code(loop, 2) == 0
    assert drive.deaf_until == pytest.approx(drive.condition.time + 4.0, abs=1.0)


def test_a_drive_is_named_by_the_number_it_has_now(loop: LineLoop) -> None:
    """Renumbered at the panel, it goes by its new number."""
    result(loop, do="set", drive=2, register="number", value=7)
    assert result(loop, do="state", drive=7)["model"] == "vf-mb1"
    assert "no drive 2" in Control(loop).do({"do": "state", "drive": 2})["error"]


def test_faults_are_begun_and_ended(loop: LineLoop) -> None:
    """A fault of a drive, one of the line, and silence; clearing says how many there were."""
    result(loop, do="fault", drive=1, kind="late", value=0.2, count=3)
    result(loop, do="fault", kind="echo")
    result(loop, do="silence", drive=2)
    late, echo, cut = loop.wire.faults.all
    assert (late.drive, late.value, late.count) == (1, 0.2, 3)
    assert (echo.drive, cut.drive, cut.kind.value) == (None, 2, "cut")
    assert result(loop, do="clear_faults", kind="echo") == 1
    assert result(loop, do="clear_faults", drive=1) == 1
    result(loop, do="silence", drive=2, on=False)
    assert result(loop, do="clear_faults") == 0


def test_statistics_can_be_counted_anew(loop: LineLoop) -> None:
    """After a reset all counts are 0."""
    loop.wire.statistics.gap_violations = 3
    loop.lateness.add(0.5)
    result(loop, do="reset_stats")
    counted = result(loop, do="stats")
    assert (counted["gap_violations"], counted["lateness_maximum"], counted["drives"]) == (0, 0.0, {})
    json.dumps(counted)


def test_babble_and_plugging_are_for_the_line(loop: LineLoop) -> None:
    """Noise is under way until the adapter is pulled out; plugged in again it has a port."""
    result(loop, do="babble", bytes=3)
    assert loop.wire.next_event() is not None
    result(loop, do="unplug")
    assert loop.wire.next_event() is None
    assert loop.port.descriptor is None
    assert result(loop, do="plug") == loop.port.name
    assert Path(loop.port.name).exists()


@pytest.mark.parametrize("line", [b"", b"{", b"[]", b'"stats"', b'{"do": "set", "drive": 1}', b'{"do": "run"}'])
def test_no_line_is_fatal(loop: LineLoop, line: bytes) -> None:
    """Whatever comes is answered by one line that says what was wrong."""
    answer = json.loads(Control(loop).do_line(line))
    assert not answer["ok"]
    assert answer["error"]


def test_the_loop_moves_bytes_until_it_is_stopped(loop: LineLoop) -> None:
    """A request is answered over the port, the lateness of it measured, and stop ends the loop."""
    thread = threading.Thread(target=loop.run)
    thread.start()
    try:
        port = os.open(loop.port.name, os.O_RDWR | os.O_NOCTTY)
        os.write(port, framed("03 FD00 0001"))
        assert select.select([port], [], [], PATIENCE)[0]
        assert os.read(port, 64) == framed("03 02 0BB8")
        os.close(port)
    finally:
        loop.stop()
        thread.join(PATIENCE)
    assert not thread.is_alive()
    assert loop.lateness.maximum > 0


def test_a_control_socket_in_use_is_not_taken_over(tmp_path: Path) -> None:
    """A second line on the same socket says so; one left behind by a killed line is replaced."""
    config, path = from_options(["1:vf-nc3"]), tmp_path / "control"
    with opened(config, path):
        with pytest.raises(GatewayError, match="another simulated line"), opened(config, path):
            pass
        assert path.is_socket()
    assert not path.exists()


def test_a_line_is_described_to_its_user() -> None:
    """Port, speed, drives, and a note where numbers are doubled."""
    config = from_options(["3:vf-nc3", "3:vf-mb1"], baud=9600)
    assert list(describe(config, "/dev/pts/9", Path("/run/c"))) == [
        "port /dev/pts/9",
        "line 9600 8E1, answers after 5 ms",
        "drive 3 vf-nc3",
        "drive 3 vf-mb1",
        "note: 3 is the number of more than one drive: their answers collide",
        "control /run/c",
    ]


def test_the_percentile_of_lateness_is_what_that_share_stayed_below() -> None:
    """99 of 100 deliveries were on time to a millisecond."""
    late = Lateness()
    assert late.percentile(0.99) == 0.0
    for place in range(100):
        late.add(place / 1000)
    assert late.percentile(0.5) == 0.050
    assert (late.percentile(0.99), late.maximum) == (0.099, 0.099)
