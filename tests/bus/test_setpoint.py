"""A controlled drive: command, frequency and five values in one frame, where the drive surely has it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gateway.bus.setpoint import Setpoint
from gateway.image import LinkState
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import SELECTED, Bench, bench, run

THIRTY = {"frequency_command": 3000, "command": 0xC400}
STOP = {"frequency_command": 0, "command": 0xC000}
BLOCKS = ("modbus-rtu", "toshiba-binary")


def control(stage: Bench, words: dict[str, int] | None) -> None:
    """Give the first drive a setpoint."""
    assert stage.worker is not None
    stage.worker.control("d1", None if words is None else Setpoint(words))


def is_carrying(stage: Bench) -> bool:
    """Say whether the first drive's block reads carry a setpoint."""
    return stage.worker is not None and stage.worker.is_carrying("d1")


def word(stage: Bench, name: str) -> int:
    """Return a register of the first drive."""
    return stage.drive.inverter.memory.word(name)


def hertz(stage: Bench) -> float:
    """Return how fast its motor turns."""
    return stage.drive.inverter.condition.motor.frequency


def one(protocol: str, block_write: list[int], **more: Any) -> Bench:
    """Return a line with one VF-nC3."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    drive = {"number": 1, "model": "vf-nc3", "block_read": SELECTED, "block_write": block_write, "protocol": spoken}
    return bench([drive | more], drive={"protocol": protocol})


@pytest.mark.parametrize("protocol", BLOCKS)
def test_the_setpoint_goes_with_the_block(protocol: str) -> None:
    """17H and X: no exchange more than for reading but the first read-back, and the motor turns and stops."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        before = stage.drive_stats["d1"].exchanges
        await asyncio.sleep(10.0)
        reading = stage.drive_stats["d1"].exchanges - before
        control(stage, THIRTY)
        await asyncio.sleep(10.0)
        controlling = stage.drive_stats["d1"].exchanges - before - reading
        assert controlling <= 1.3 * reading  # read-back, and values that left 0 are confirmed
        assert is_carrying(stage)
        assert hertz(stage) == 30.0
        control(stage, STOP)
        await asyncio.sleep(10.0)
        assert hertz(stage) == 0.0
        control(stage, None)
        await asyncio.sleep(1.0)  # the exchange in flight
        memory = stage.drive.inverter.memory
        memory.write_ram(memory.named("frequency_command"), 1234)
        await asyncio.sleep(3.0)
        assert word(stage, "frequency_command") == 1234  # nothing is written any more
        assert not memory.eeprom_writes

    run(lambda: one(protocol, [1, 3]), play)


@pytest.mark.parametrize(("protocol", "block_write"), [("toshiba-ascii", [1, 3]), *((p, []) for p in BLOCKS)])
def test_where_no_exchange_carries_it_nothing_is_written(protocol: str, block_write: list[int]) -> None:
    """No block in ASCII, no selectors in the drive: whoever commands is told, and writes by itself."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        assert not is_carrying(stage)
        await asyncio.sleep(5.0)
        assert (word(stage, "command"), word(stage, "frequency_command")) == (0, 0)

    run(lambda: one(protocol, block_write), play)


@pytest.mark.parametrize("protocol", BLOCKS)
@pytest.mark.parametrize("in_force", [[3, 1], [5, 3], [1, 4], [2, 3], []])
def test_selectors_that_are_not_in_force_are_found_out_harmlessly(protocol: str, in_force: list[int]) -> None:
    """Set at the panel without a reset: no word of the setpoint arrives anywhere, and nothing moves or trips."""

    async def play(stage: Bench) -> None:
        stage.drive.set_by_panel("block_write_1", 1)
        stage.drive.set_by_panel("block_write_2", 3)
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(10.0)
        assert not is_carrying(stage)
        assert word(stage, "command") in (0, 1, 2)  # a preset speed without command priority
        assert word(stage, "frequency_command") in (0, 1, 2)
        assert hertz(stage) == 0.0
        assert not stage.drive.inverter.condition.is_tripped

    run(lambda: one(protocol, in_force), play)


@pytest.mark.parametrize("protocol", BLOCKS)
@pytest.mark.parametrize("in_force", [[3, 1], [2, 3]])
def test_setpoints_in_quick_succession_do_not_pass_by_the_proof(protocol: str, in_force: list[int]) -> None:
    """What was read back before the harmless words were sent proves nothing of them."""

    async def play(stage: Bench) -> None:
        stage.drive.set_by_panel("block_write_1", 1)
        stage.drive.set_by_panel("block_write_2", 3)
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        control(stage, THIRTY | {"frequency_command": 2999})
        for _ in range(100):
            await asyncio.sleep(0.02)
            assert word(stage, "command") in (0, 1, 2)
            assert word(stage, "frequency_command") in (0, 1, 2)
        assert not stage.drive.inverter.condition.is_tripped

    run(lambda: one(protocol, in_force), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_setpoints_in_quick_succession_are_carried(protocol: str) -> None:
    """A newer one takes the place of the older, also while the exchange is being proven."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        for frequency in range(2000, 3001, 10):
            control(stage, THIRTY | {"frequency_command": frequency})
            await asyncio.sleep(0.05)
        await asyncio.sleep(8.0)
        assert is_carrying(stage)
        assert hertz(stage) == 30.0

    run(lambda: one(protocol, [1, 3]), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_a_drive_that_is_commanded_already_is_not_tried_on(protocol: str) -> None:
    """FA00 is not 0: harmless words would not be harmless."""

    async def play(stage: Bench) -> None:
        memory = stage.drive.inverter.memory
        memory.write_ram(memory.named("command"), 0xC000)
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(3.0)
        assert not is_carrying(stage)
        assert word(stage, "command") == 0xC000

    run(lambda: one(protocol, [1, 3]), play)


@pytest.mark.parametrize("protocol", BLOCKS)
@pytest.mark.parametrize("kind", [Kind.DROP, Kind.CUT])
def test_lost_frames_change_nothing(protocol: str, kind: Kind) -> None:
    """The next block read carries the setpoint again, and a lost reading back is repeated."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        stage.wire.faults.add(Fault(kind, 1, probability=0.1))
        control(stage, THIRTY)
        await asyncio.sleep(30.0)
        stage.wire.faults.clear()
        await asyncio.sleep(5.0)
        assert hertz(stage) == (30.0 if is_carrying(stage) else 0.0)

    run(lambda: one(protocol, [1, 3]), play)


@pytest.mark.hazard("H12")
@pytest.mark.parametrize("protocol", BLOCKS)
def test_a_power_cycle_does_not_bring_the_motion_back(protocol: str) -> None:
    """A drive that was lost is only read again."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(8.0)
        assert hertz(stage) == 30.0
        stage.drive.inverter.reset(asyncio.get_running_loop().time())
        await asyncio.sleep(15.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert hertz(stage) == 0.0
        assert not is_carrying(stage)

    run(lambda: one(protocol, [1, 3]), play)


@pytest.mark.parametrize("protocol", BLOCKS)
def test_the_displays_block_mode_ends_it(protocol: str) -> None:
    """FA80 = 1: the words would be shown as text; whoever commands is told that they are not carried."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        control(stage, THIRTY)
        await asyncio.sleep(8.0)
        stage.drive.set_by_panel("block_mode", 1)
        await asyncio.sleep(1.0)
        assert not is_carrying(stage)

    run(lambda: one(protocol, [1, 3]), play)


@pytest.mark.hazard("H07")
def test_a_stranger_or_a_silent_drive_is_given_nothing_and_its_neighbour_goes_on() -> None:
    """Another model under the number, then nobody: no word is written, and the line is not kept busy."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.STRANGER
        control(stage, THIRTY)
        await asyncio.sleep(3.0)
        assert (word(stage, "command"), word(stage, "frequency_command")) == (0, 0)
        stage.wire.faults.add(Fault(Kind.CUT, 1))
        await asyncio.sleep(5.0)
        control(stage, THIRTY)
        before = stage.drive_stats["d2"].exchanges
        await asyncio.sleep(10.0)
        assert stage.drive_stats["d2"].exchanges - before > 90
        assert not is_carrying(stage)

    other = {"number": 1, "model": "vf-mb1", "configured": "vf-nc3"}
    run(lambda: bench([other, {"number": 2, "model": "vf-nc3", "block_read": SELECTED}]), play)
