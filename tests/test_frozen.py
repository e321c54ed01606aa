"""Whatever dies while the motor runs, it is stopped: the gateway, its controller, the broker, each really lost.

The simulated drive is the judge, by its own clock. `pytest -s` prints what was measured.
"""

from __future__ import annotations

import json
import resource
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.sim.condition import TripCode
from gateway.sim.process import SimulatedLine
from tests.controlled import BEAT, COMMAND_TIMEOUT, CONTROL, F803, LEASE, POLL, Heartbeat, Stage, plant, staged
from tests.mosquitto import Mosquitto
from tests.processes import LIMIT, until

pytestmark = pytest.mark.e2e

EXCHANGES = 0.1  # seconds that the exchanges may take which a stop waits for or consists of
RAMP = 0.5  # seconds from full speed to standstill at the most (F010)
BUSY = 0.4  # seconds by which a busy machine may be late with what it measures
BY_F803 = (F803 - POLL - BUSY, F803 + BUSY)
STOP_BY_LEASE = (LEASE - 2 * BEAT - BUSY, LEASE + EXCHANGES + BUSY)
STANDSTILL_BY_LEASE = (LEASE - 2 * BEAT - BUSY, LEASE + EXCHANGES + RAMP + BUSY)
FA00 = bytes.fromhex("01 06 FA 00")
READ_FA00 = bytes.fromhex("01 03 FA 00")
FD01_TOO = (bytes.fromhex("01 03 FD 01"), bytes.fromhex("01 03 FD 00"))


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[SimulatedLine, Mosquitto]]:
    """Start one line and one broker for all tests."""
    with plant(tmp_path_factory.mktemp("frozen")) as made:
        yield made


@pytest.fixture
def stage(parts: tuple[SimulatedLine, Mosquitto], tmp_path: Path) -> Iterator[Stage]:
    """Start the gateway with a drive that was switched off and on."""
    line, broker = parts
    line.do({"do": "power_cycle", "drive": 1})
    with staged(line, broker, tmp_path) as made:
        yield made


def tell(what: str, seconds: float, least: float, most: float) -> None:
    """Print a figure and hold it against its bounds."""
    print(f"{what}: {seconds:.2f} s (allowed {least:.2f} to {most:.2f} s)")  # noqa: T201
    assert least <= seconds <= most, what


def waits_for_trip(stage: Stage) -> float:
    """Wait until the drive has tripped by its own F803, and return the line's time then."""
    until(lambda: stage.drive["timeout"]["is_timed_out"], "the drive's own time-out")
    now = stage.now
    until(lambda: not stage.is_running, "the motor to stand still")
    assert stage.drive["trip_code"] == TripCode.COMMUNICATION
    return now


@pytest.mark.hazard("H13")
def test_a_killed_gateway_is_followed_by_the_drives_own_time_out(stage: Stage) -> None:
    """By kill -9: nobody reads any more, and F803 trips the drive."""
    with Heartbeat(stage.broker.port):
        stage.run_motor(30.0)
        killed = stage.now
        stage.process.kill()
        tell("kill -9 of the gateway to the drive's trip", waits_for_trip(stage) - killed, *BY_F803)


@pytest.mark.hazard("H13")
@pytest.mark.hazard("H23")
def test_a_gateway_frozen_for_long_is_followed_by_the_drives_own_time_out(stage: Stage) -> None:
    """SIGSTOP beyond F803: tripped by itself; thawed, the gateway finds that and runs nothing."""
    with Heartbeat(stage.broker.port):
        stage.run_motor(30.0)
        frozen = stage.now
        stage.process.send_signal(signal.SIGSTOP)
        tell("SIGSTOP to the drive's trip", waits_for_trip(stage) - frozen, *BY_F803)
        stage.process.send_signal(signal.SIGCONT)
        stage.until_event("lease_lost")
        assert stage.ask("arm")["status"] == "refused"
    assert not stage.is_running


@pytest.mark.hazard("H23")
@pytest.mark.hazard("H05")
def test_heartbeats_that_lay_in_the_socket_of_a_frozen_gateway_keep_nothing_running(stage: Stage) -> None:
    """SIGSTOP beyond the lease, not beyond F803, while the controller dies: stopped at once on SIGCONT, no trip."""
    with Heartbeat(stage.broker.port) as controller:
        stage.run_motor(30.0)
        stage.process.send_signal(signal.SIGSTOP)
        time.sleep(LEASE + BEAT)  # real time must pass: nothing can be waited for while the gateway stands still
        controller.kill()
    thawed = stage.now
    stage.process.send_signal(signal.SIGCONT)
    until(lambda: not stage.is_running, "the stop")
    tell("SIGCONT to standstill", stage.now - thawed, 0.0, EXCHANGES + RAMP + BUSY)
    first = next(at for at, frame in stage.requests(thawed) if frame.startswith(FA00))
    tell("SIGCONT to the stop on the line", first - thawed, 0.0, EXCHANGES + BUSY)
    stage.until_event("lease_lost")
    assert stage.drive["trip_code"] == 0


@pytest.mark.hazard("H23")
@pytest.mark.hazard("H11")
def test_commands_that_lay_in_the_socket_of_a_frozen_gateway_are_not_carried_out(
    parts: tuple[SimulatedLine, Mosquitto], tmp_path: Path
) -> None:
    """They are older than a command may be: each is refused as expired; the lease holds, and new ones are done."""
    line, broker = parts
    line.do({"do": "power_cycle", "drive": 1})
    control = CONTROL.replace(f'lease = "{LEASE}s"', 'lease = "10s"')
    with staged(line, broker, tmp_path, control) as stage:
        stage.run_motor(30.0)
        stage.process.send_signal(signal.SIGSTOP)
        for number in range(4):
            stage.send(json.dumps({"command": "acceleration", "number": 1 + number % 2, "id": f"old {number}"}))
        time.sleep(COMMAND_TIMEOUT + BUSY)  # real time must pass while the gateway stands still
        thawed = stage.now
        stage.process.send_signal(signal.SIGCONT)
        old = [stage.until_result(f"old {number}") for number in range(4)]
        assert [(result["status"], result["reason"]) for result in old] == [("refused", "expired")] * 4
        assert not [frame for _, frame in stage.requests(thawed) if frame.startswith(FA00)]
        time.sleep(BUSY)  # a standstill is remembered for a while, until every socket has been read
        stage.do(json.dumps({"command": "acceleration", "number": 2}))


@pytest.mark.hazard("H05")
def test_a_killed_controller_stops_the_motor_by_its_lease(stage: Stage) -> None:
    """The gateway goes on reading, and the broker lives: only the controller is gone."""
    with Heartbeat(stage.broker.port) as controller:
        stage.run_motor(30.0)
        time.sleep(2 * LEASE)  # that it lives must be seen to keep the lease: real time
        assert stage.is_running
        controller.kill()
        killed = stage.now
        until(lambda: not stage.is_running, "the stop")
        tell("kill of the controller to standstill", stage.now - killed, *STANDSTILL_BY_LEASE)
    stopped = next(at for at, frame in stage.requests(killed) if frame.startswith(FA00))
    tell("kill of the controller to the stop on the line", stopped - killed, *STOP_BY_LEASE)
    assert stage.until_event("on_loss")["reason"] == "stop: done"
    assert stage.drive["trip_code"] == 0
    assert stage.ask("take")["status"] == "done"


@pytest.mark.hazard("H05")
def test_a_killed_broker_stops_the_motor_by_the_lease(stage: Stage) -> None:
    """No heartbeat comes through any more; the gateway goes on reading the drive, and connects again."""
    with Heartbeat(stage.broker.port):
        stage.run_motor(30.0)
        killed = stage.now
        stage.broker.kill()
        try:
            until(lambda: not stage.is_running, "the stop")
            tell("kill of the broker to standstill", stage.now - killed, *STANDSTILL_BY_LEASE)
            assert stage.drive["trip_code"] == 0
            assert stage.process.poll() is None
        finally:
            stage.broker.start()


@pytest.mark.hazard("H13")
def test_sigterm_stops_the_motor_and_sees_it_stop_before_the_port_closes(stage: Stage) -> None:
    """on_exit = "stop": the stop is read back, and so is what the motor does; then the process ends with 0."""
    with Heartbeat(stage.broker.port):
        stage.run_motor(30.0)
        asked = stage.now
        stage.process.send_signal(signal.SIGTERM)
        assert stage.process.wait(LIMIT) == 0
    tell("SIGTERM to the end of the process", stage.now - asked, 0.0, EXCHANGES + RAMP + 2 * BUSY)
    frames = [frame for _, frame in stage.requests(asked)]
    stop = next(place for place, frame in enumerate(frames) if frame.startswith(FA00))
    assert frames[stop + 1].startswith(READ_FA00)
    assert any(frame.startswith(FD01_TOO) for frame in frames[stop + 2 :])
    assert not stage.is_running
    assert stage.drive["trip_code"] == 0
    assert stage.drive["timeout"]["left"] not in (None, 0.0)


@pytest.mark.hazard("H13")
def test_a_gateway_that_is_to_hold_leaves_the_motor_to_the_next_one_or_to_f803(
    parts: tuple[SimulatedLine, Mosquitto], tmp_path: Path
) -> None:
    """on_exit = "hold": nothing is sent at the end; nobody comes, and the drive stops by itself."""
    line, broker = parts
    line.do({"do": "power_cycle", "drive": 1})
    with staged(line, broker, tmp_path, CONTROL + 'on_exit = "hold"\n') as stage, Heartbeat(broker.port):
        stage.run_motor(30.0)
        asked = stage.now
        stage.process.send_signal(signal.SIGTERM)
        assert stage.process.wait(LIMIT) == 0
        assert stage.is_running
        assert not [frame for _, frame in stage.requests(asked) if frame.startswith(FA00)]
        waits_for_trip(stage)


@pytest.mark.hazard("H35")
def test_a_full_disk_stops_no_command_but_writes_to_the_eeprom(
    parts: tuple[SimulatedLine, Mosquitto], tmp_path: Path
) -> None:
    """The process may write to no file any more: the motor is still commanded, and no EEPROM is worn uncounted."""
    line, broker = parts
    line.do({"do": "power_cycle", "drive": 1})
    with staged(line, broker, tmp_path, CONTROL + "allow_stored = true\n") as stage, Heartbeat(broker.port):
        stage.run_motor(30.0)
        stage.do(json.dumps({"command": "set", "name": "free_notes", "value": 7}))
        worn = stage.drive["eeprom_writes"]
        resource.prlimit(stage.process.pid, resource.RLIMIT_FSIZE, (0, 0))
        result = stage.ask(json.dumps({"command": "set", "name": "free_notes", "value": 8}))
        assert (result["status"], result["reason"]) == ("refused", "no_store")
        stage.do(json.dumps({"command": "frequency", "frequency": 20}))
        until(lambda: stage.drive["frequency"] == 20.0, "20 Hz")
        stage.do("stop")
        until(lambda: not stage.is_running, "the stop")
        assert stage.drive["eeprom_writes"] == worn
        assert stage.process.poll() is None
