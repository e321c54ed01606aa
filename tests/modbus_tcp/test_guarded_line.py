"""Rights on a simulated line in virtual time: whose stop stops a running motor, and whose does not."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gateway.config import ModbusTcpSection
from gateway.metrics import Stats
from gateway.modbus_tcp.server import ModbusTcpServer
from tests.modbus_tcp.plant import Master, Place, Plant, mirror, play, several

RUN, STOP, FREQUENCY_PRIORITY = 0xC400, 0x8000, 0x4000
FREQUENCY = mirror(Place.FREQUENCY)
RIGHTS: list[dict[str, Any]] = [
    {"addresses": ["10.0.0.7"], "functions": ["read", "write"]},
    {"addresses": ["10.0.0.8"], "functions": ["read"]},
    {"addresses": ["10.0.0.9"], "functions": ["read", "write"], "units": [1], "registers": [0xFA01]},
    {"addresses": ["10.0.0.10"], "functions": ["read", "write"], "units": [255], "registers": [FREQUENCY]},
]


def guarded(plant: Plant, peer: str) -> Master:
    """Connect to a server with rights, in front of the same drives."""
    section = ModbusTcpSection.model_validate({"right": RIGHTS})
    clock = plant.door.clock
    server = ModbusTcpServer(section, plant.bench.image, Stats(clock.wall()), clock, door=plant.door)
    return Master(server._connection(), peer)


async def run(plant: Plant) -> Master:
    """Let a master with every right run the motor, and keep it running."""
    master = guarded(plant, "10.0.0.7")
    assert await master.order("take") == 0
    assert await master.order("arm") == 0
    assert await master.write_words(1, 0xFA00, RUN, 3000) == 0
    assert plant.is_running()
    return master


@pytest.mark.hazard("H04")
@pytest.mark.parametrize(
    ("peer", "unit", "pdu", "is_stopped"),
    [
        ("10.0.0.8", 1, several(0xFA00, STOP), False),
        ("10.0.0.8", 255, several(mirror(Place.COMMAND), 4), False),
        ("10.0.0.9", 1, several(0xFA00, STOP), True),
        ("10.0.0.9", 1, several(0xFA00, STOP, 6000), True),
        ("10.0.0.9", 1, several(0xFA00, 0), True),
        ("10.0.0.9", 255, several(mirror(Place.COMMAND), 4), False),
        ("10.0.0.10", 255, several(mirror(Place.COMMAND), 4, 1, 6000), True),
        ("10.0.0.10", 1, several(0xFA00, STOP), False),
        ("10.0.0.11", 1, several(0xFA00, STOP), False),
    ],
)
def test_who_may_write_to_a_drive_stops_its_motor_and_who_may_only_read_does_not(
    peer: str, unit: int, pdu: bytes, *, is_stopped: bool
) -> None:
    """Whoever has the lease; what stands beside the stop is not written, and the answer is that of the stop."""

    async def script(plant: Plant) -> None:
        await run(plant)
        before = len(plant.written)
        told = await guarded(plant, peer).ask(unit, pdu)
        assert told == (pdu[:5] if is_stopped else b"\x90\x01")
        assert plant.is_running() is not is_stopped
        written = [(address, word & ~FREQUENCY_PRIORITY) for _, address, word in plant.written[before:]]
        assert written == ([(0xFA00, STOP)] if is_stopped else [])
        assert plant.word("frequency_command") == 3000

    play(script)


@pytest.mark.hazard("H28")
def test_rights_take_away_and_give_nothing() -> None:
    """Who may write by rights needs the lease, as everybody does."""

    async def script(plant: Plant) -> None:
        other = guarded(plant, "10.0.0.9")
        assert await other.write_words(1, 0xFA01, 3000) == 6
        await run(plant)
        assert await other.write_words(1, 0xFA01, 3000) == 6
        await asyncio.sleep(3.0)
        assert not plant.is_running()

    play(script)
