"""A controlled drive: command, frequency and five values in one frame, where the drive has it."""

from __future__ import annotations

import asyncio

from gateway.bus.setpoint import Setpoint
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import Bench, bench, nc3, run

RUN_FORWARD = 0xC400
THIRTY = {"frequency_command": 3000, "command": RUN_FORWARD}
STOP = {"frequency_command": 0, "command": 0xC000}


def control(stage: Bench, words: dict[str, int] | None) -> None:
    """Give the first drive a setpoint."""
    assert stage.worker is not None
    stage.worker.control("d1", None if words is None else Setpoint(words))


def test_the_setpoint_goes_with_the_block() -> None:
    """17H: no exchange more than for reading, and the motor turns."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        before = stage.drive_stats["d1"].exchanges
        await asyncio.sleep(10.0)
        reading = stage.drive_stats["d1"].exchanges - before
        control(stage, THIRTY)
        await asyncio.sleep(10.0)
        controlling = stage.drive_stats["d1"].exchanges - before - reading
        assert controlling <= 1.15 * reading  # read-back of the first one, and of values that left 0
        assert stage.value("d1", "output_frequency") == "30.00"
        control(stage, STOP)
        await asyncio.sleep(10.0)
        assert stage.value("d1", "output_frequency") == "0.00"
        control(stage, None)
        stage.drive.inverter.memory.write_ram(stage.drive.inverter.memory.named("frequency_command"), 1234)
        await asyncio.sleep(3.0)
        assert stage.drive.inverter.memory.word("frequency_command") == 1234  # nothing is written any more

    run(lambda: bench([nc3(block_write=[1, 3])]), play)


def test_without_selectors_it_is_written_by_itself() -> None:
    """F870 and F871 are 0: frequency, then command, once each."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(10.0)
        assert stage.value("d1", "output_frequency") == "30.00"
        assert not stage.drive.inverter.memory.eeprom_writes

    run(lambda: bench([nc3()]), play)


def test_selectors_that_are_set_but_not_in_force_are_found_out() -> None:
    """They were set without a reset: the exchange is refused (04), single writes take over."""

    async def play(stage: Bench) -> None:
        stage.drive.set_by_panel("block_write_1", 1)
        stage.drive.set_by_panel("block_write_2", 3)
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(10.0)
        assert stage.value("d1", "output_frequency") == "30.00"
        assert stage.drive_stats["d1"].refusals >= 1

    run(lambda: bench([nc3()]), play)


def test_selectors_in_force_that_were_changed_since_are_found_out() -> None:
    """In force: command 2 and frequency. What FA00 reads back shows that the command never arrived there."""

    async def play(stage: Bench) -> None:
        stage.drive.set_by_panel("block_write_1", 1)
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(10.0)
        assert stage.value("d1", "output_frequency") == "30.00"

    run(lambda: bench([nc3(block_write=[5, 3])]), play)


def test_lost_exchanges_change_nothing() -> None:
    """The next block read carries the setpoint again."""

    async def play(stage: Bench) -> None:
        stage.wire.faults.add(Fault(Kind.DROP, probability=0.1))
        await asyncio.sleep(5.0)
        control(stage, THIRTY)
        await asyncio.sleep(20.0)
        assert stage.drive.inverter.condition.motor.frequency == 30.0

    run(lambda: bench([nc3(block_write=[1, 3])]), play)
