"""Setting the selectors of a drive once, and knowing that they act only after a reset."""

from __future__ import annotations

import asyncio

import pytest

from gateway.image import LinkState
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import FIVE, Bench, bench, nc3, run

F875_TO_F879 = [0x0875, 0x0876, 0x0877, 0x0878, 0x0879]
PROVISION = {"provision": True}


def uses_block(stage: Bench) -> bool:
    """Say whether one answer brings all five values."""
    return any(set(FIVE) <= set(names) for _, names, _ in stage.applied[-40:])


def selectors(stage: Bench) -> list[int]:
    """Return F875-F879 as the drive keeps them."""
    return [stage.drive.inverter.memory.word(f"block_read_{place}") for place in range(1, 6)]


def test_a_drive_as_shipped_is_set_once_and_used_after_its_reset() -> None:
    """Five writes to the EEPROM; until the reset single reads and `reset needed`, afterwards the block."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert selectors(stage) == [1, 2, 3, 4, 5]
        assert stage.image.by_name["d1"].is_reset_needed
        assert not uses_block(stage)
        assert stage.value("d1", "output_frequency") == "40.00"
        await asyncio.sleep(60.0)
        assert stage.image.by_name["d1"].is_reset_needed
        stage.drive.inverter.reset(asyncio.get_running_loop().time())
        await asyncio.sleep(10.0)
        assert not stage.image.by_name["d1"].is_reset_needed
        stage.drive.inverter.run_by_panel(40.0)
        await asyncio.sleep(20.0)
        assert stage.value("d1", "output_frequency") == "40.00"
        assert uses_block(stage)
        writes = stage.drive.inverter.memory.eeprom_writes
        assert writes == dict.fromkeys(F875_TO_F879, 1)
        assert stage.drive_stats["d1"].eeprom_writes == dict.fromkeys(F875_TO_F879, 1)

    run(lambda: bench([{"number": 1, "model": "vf-nc3", "running_at": 40.0}], drive=PROVISION), play)


def test_the_reset_is_not_taken_for_granted_after_a_lost_cable() -> None:
    """Silence alone does not put selectors in force: FA87 still reads 1."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        stage.wire.faults.add(Fault(Kind.CUT, 1))
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.OFFLINE
        stage.wire.faults.clear()
        await asyncio.sleep(10.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert stage.image.by_name["d1"].is_reset_needed
        assert not uses_block(stage)

    run(lambda: bench([{"number": 1, "model": "vf-nc3", "running_at": 40.0}], drive=PROVISION), play)


def test_the_old_mapping_stays_in_use_until_the_reset() -> None:
    """Two of five were selected: the block brings those two meanwhile, under their right names."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.image.by_name["d1"].is_reset_needed
        assert any({"status", "output_frequency"} == set(names) for _, names, _ in stage.applied[-40:])
        assert stage.value("d1", "output_frequency") == "40.00"
        assert float(stage.value("d1", "output_voltage")) > 0

    first = {"number": 1, "model": "vf-nc3", "running_at": 40.0, "block_read": [2, 1]}
    run(lambda: bench([first], drive=PROVISION), play)


def test_what_is_set_already_in_any_order_is_not_written() -> None:
    """The block brings all that is wanted: nothing wears the EEPROM."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert selectors(stage) == [5, 4, 3, 2, 1]
        assert not stage.drive.inverter.memory.eeprom_writes
        assert not stage.image.by_name["d1"].is_reset_needed
        assert uses_block(stage)

    run(lambda: bench([nc3(running_at=40.0, block_read=[5, 4, 3, 2, 1])], drive=PROVISION), play)


def test_without_permission_nothing_is_written() -> None:
    """`provision` is off by default."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(70.0)
        assert not stage.drive.inverter.memory.eeprom_writes
        assert selectors(stage) == [0, 0, 0, 0, 0]

    run(lambda: bench([{"number": 1, "model": "vf-nc3", "running_at": 40.0}]), play)


def test_a_drive_that_refuses_is_asked_once() -> None:
    """F700 = 2: error 04; it is read by singles, and nothing is tried again."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        refusals = stage.drive_stats["d1"].refusals
        assert refusals >= 5
        await asyncio.sleep(125.0)
        assert stage.drive_stats["d1"].refusals == refusals
        assert stage.link("d1") is LinkState.ONLINE
        assert selectors(stage) == [0, 0, 0, 0, 0]
        assert not stage.image.by_name["d1"].is_reset_needed

    locked = {"number": 1, "model": "vf-nc3", "running_at": 40.0, "registers": {"write_protection": 2}}
    run(lambda: bench([locked], drive=PROVISION), play)


def test_somebody_who_sets_them_back_is_not_fought() -> None:
    """A selector is written once while the gateway runs, whatever is done at the panel afterwards."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        for place in range(1, 6):
            stage.drive.set_by_panel(f"block_read_{place}", 0)
        await asyncio.sleep(70.0)
        assert selectors(stage) == [0, 0, 0, 0, 0]
        assert stage.drive.inverter.memory.eeprom_writes == dict.fromkeys(F875_TO_F879, 1)

    run(lambda: bench([{"number": 1, "model": "vf-nc3", "running_at": 40.0}], drive=PROVISION), play)


@pytest.mark.unmeasured
@pytest.mark.parametrize("seed", range(8))
def test_lost_answers_do_not_wear_the_eeprom_twice(seed: int) -> None:
    """A write without an answer is read back before it is made again; at most two of one selector."""

    async def play(stage: Bench) -> None:
        stage.wire.faults.add(Fault(Kind.DROP, probability=0.2))
        await asyncio.sleep(30.0)
        stage.wire.faults.clear()
        await asyncio.sleep(10.0)
        writes = stage.drive.inverter.memory.eeprom_writes
        assert selectors(stage) == [1, 2, 3, 4, 5]
        assert set(writes.values()) == {1}

    shipped = {"number": 1, "model": "vf-nc3", "running_at": 40.0}
    run(lambda: bench([shipped], drive=PROVISION, seed=seed), play)
