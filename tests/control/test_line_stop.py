"""An emergency stop of a whole line: one broadcast first, then every drive by itself (SAFETY.md H29)."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from gateway.bus.worker import LineWorker
from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.control.door import Door, LineBell
from gateway.sim.faults import Fault, Kind
from tests import virtual
from tests.bus.rig import Bench, bench, nc3
from tests.control.test_control_line import CONTROL

PLC = Source(Channel.MODBUS_TCP, "10.0.0.7")
RUNNING = {"command": 0xC400, "frequency_command": 3000}


def play(script: Callable[[Bench, Door], Awaitable[None]], protocol: str = "modbus-rtu") -> None:
    """Run a script against three VF-nC3 that run at 30 Hz."""

    async def main() -> None:
        spoken: dict[str, Any] = {} if protocol == "modbus-rtu" else {"protocol": "toshiba"}
        drives = [nc3(number, registers=RUNNING, **spoken) for number in (1, 2, 3)]
        made = bench(drives, drive={**CONTROL, "control": "direct", "protocol": protocol})
        line = made.configured.lines[0]
        door = Door.of(made.configured, virtual.VirtualClock())
        worker = LineWorker(
            line,
            made.image.by_name,
            made.line_stats,
            made.drive_stats,
            virtual.VirtualClock(),
            made.open,
            door.controls,
        )
        door.connect(LineBell("a", tuple(d.name for d in line.drives), worker.ring, worker.announce))
        task = asyncio.create_task(worker.run())
        try:
            await asyncio.sleep(4.0)
            await script(made, door)
            assert not task.done() or task.exception() is None
            assert made.wire.statistics.gap_violations == 0
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    virtual.run(main())


async def stopped(door: Door, verb: Verb, count: int) -> list[Result]:
    """Stop the line and wait for a result of every drive."""
    results: list[Result] = []
    is_all = asyncio.get_running_loop().create_future()

    def take(result: Result) -> None:
        results.append(result)
        if len(results) == count and not is_all.done():
            is_all.set_result(None)

    door.stop_line("a", verb, PLC, take)
    await asyncio.wait_for(is_all, 5.0)
    return results


@pytest.mark.hazard("H29")
@pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])
def test_an_emergency_stop_reaches_every_drive_by_one_broadcast(protocol: str) -> None:
    """Within the exchange in flight and one frame; then each is read back."""

    async def script(made: Bench, door: Door) -> None:
        drives = made.wire.drives
        asked = asyncio.get_running_loop().time()
        waiting = asyncio.create_task(stopped(door, Verb.EMERGENCY_STOP, len(drives)))
        await asyncio.sleep(0.12)
        for drive in drives:
            drive.tick(asyncio.get_running_loop().time())
            assert drive.inverter.condition.is_tripped or not drive.inverter.operation.is_running
        results = await waiting
        assert {result.status for result in results} == {Status.DONE}
        assert asyncio.get_running_loop().time() - asked < 1.0

    play(script, protocol=protocol)


def test_a_line_with_a_drive_that_is_read_only_gets_no_broadcast() -> None:
    """It would be stopped as well: every other drive is told by itself."""

    async def script(made: Bench, door: Door) -> None:
        door.controls.pop("d2")
        results = await stopped(door, Verb.EMERGENCY_STOP, 2)
        assert {result.status for result in results} == {Status.DONE}
        made.wire.drives[1].tick(asyncio.get_running_loop().time())
        assert made.wire.drives[1].inverter.operation.is_running

    play(script)


def test_a_stop_of_one_drive_does_not_wait_for_a_dead_neighbour() -> None:
    """A drive that does not answer its stop takes turns with those that do."""

    async def script(made: Bench, door: Door) -> None:
        made.wire.faults.add(Fault(Kind.CUT, 1))
        results = await stopped(door, Verb.STOP, 3)
        by_drive = {result.command.drive: result.status for result in results}
        assert by_drive == {"d1": Status.UNKNOWN, "d2": Status.DONE, "d3": Status.DONE}

    play(script)


def test_a_line_that_nobody_knows_is_refused() -> None:
    """One result says so."""

    async def script(_made: Bench, door: Door) -> None:
        answers: list[Result] = []
        now = asyncio.get_running_loop().time()
        door.stop_line("b", Verb.STOP, PLC, answers.append)
        assert [answer.status for answer in answers] == [Status.REFUSED]
        assert isinstance(answers[0].command, Command)
        assert now == asyncio.get_running_loop().time()

    play(script)
