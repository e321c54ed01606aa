"""Damaged requests through a whole connection: never an exception, one answer for each frame that is whole."""

from __future__ import annotations

import asyncio
import random
import struct

import pytest

from gateway.control.command import Reason, Result, Status
from gateway.modbus_tcp.gateway_unit import UNIT
from gateway.modbus_tcp.mirror_map import LINES_AT, Place
from tests.modbus_tcp.plant import Listening, exchange, mirror, several, stop_of
from tests.modbus_tcp.rig import Rig, Wire, answers, read, request, write
from tests.soak import FACTOR

SEED = 20_260_101
REQUESTS = 100_000 * FACTOR
FRAMES = (
    read(1, 1, 0xFD00, 4),
    read(2, 1, 0xFD18, 1),
    read(3, 2, 0xFD00, 1, 4),
    read(4, 255, 0, 64),
    read(5, 255, 0xF000, 24),
    read(6, 0, 0, 1),
    request(7, 1, bytes([0x2B, 0x0E, 1, 0])),
    request(8, 1, bytes([16, 0xFA, 0, 0, 1, 2, 0, 0])),
)


@pytest.mark.unmeasured
@pytest.mark.hazard("H26")
async def test_a_hundred_thousand_damaged_requests() -> None:
    """Bits flipped, bytes lost, added and doubled, in pieces: what is whole is answered, what is no frame closes."""
    rng = random.Random(SEED)
    rig = Rig()
    closed = answered = 0
    for _ in range(REQUESTS):
        data = damaged(rng, rng.choice(FRAMES))
        wire = rig.connect()
        feed(rng, wire, data)
        whole, is_in_step = judge(data)
        assert len(answers(wire.sent)) == whole
        assert wire.is_closed is not is_in_step
        answered += whole
        closed += wire.is_closed
        wire.connection.connection_lost(None)
    assert not rig.places.taken
    assert answered == sum(rig.stats.tcp.requests.values()) > REQUESTS // 2
    assert closed > REQUESTS // 10


WRITES = (
    write(1, 1, 0xFA01, 3000),
    request(2, 1, several(0xFA00, 0xC400, 3000)),
    request(3, 1, exchange(0xFD00, 2, 0xFA00, 0xC400, 3000)),
    write(4, UNIT, mirror(Place.COMMAND), 8),
    request(5, UNIT, several(mirror(Place.COMMAND, 1), 4, 1, 3000, 2, 7)),
    request(6, UNIT, exchange(mirror(Place.ECHO), 11, mirror(Place.COMMAND), 8, 1, 3000, 2, 7)),
    request(7, UNIT, exchange(mirror(Place.STANDING), 4, mirror(Place.COMMAND), 8, 1, 3000, 2, 8)),
    request(8, UNIT, several(LINES_AT, 6)),
    write(9, 2, 0xFA00, 0x8000),
    write(10, 0, 0xFA00, 0x8000),
    read(11, UNIT, mirror(Place.COMMAND), 32),
    read(12, 1, 0xFA00, 2),
)


@pytest.mark.unmeasured
@pytest.mark.hazard("H22")
@pytest.mark.hazard("H26")
@pytest.mark.hazard("H28")
async def test_a_hundred_thousand_damaged_writes() -> None:
    """Whatever comes of them, at once or later: one answer for each whole frame, in order, and no exception here."""
    rng = random.Random(SEED)
    made = Listening({}, {}, {"control": "off"})
    ends = [Result(stop_of("d1"), status, reason, read_back={"command": 0}) for status in Status for reason in Reason]
    state = made.door.state("d1")
    asked = 0
    for _ in range(REQUESTS):
        data = damaged(rng, rng.choice(WRITES))
        state.facts["command"] = rng.choice((0, 0x8000, 0xC400))
        state.is_online = rng.random() < 0.5
        wire = Wire(rng.choice(("10.0.0.7", "10.0.0.8")))
        wire.connection = made.server._connection()
        wire.connection.connection_made(wire)
        feed(rng, wire, data)
        waiting = [answer for _, answer in made.door.asked] + [stop[3] for stop in made.door.line_stops for _ in "ab"]
        asked += len(waiting)
        made.door.asked.clear()
        made.door.line_stops.clear()
        rng.shuffle(waiting)
        for answer in waiting:
            answer(rng.choice(ends))
        if waiting:
            await asyncio.sleep(0)
        whole, is_in_step = judge(data)
        found = answers(wire.sent)
        assert wire.is_closed is not is_in_step
        assert len(found) == whole if is_in_step else len(found) <= whole
        wire.connection.connection_lost(None)
    assert asked > REQUESTS // 10
    assert not made.server._places.taken


def feed(rng: random.Random, wire: Wire, data: bytes) -> None:
    """Deliver the bytes in up to three pieces, until the connection closes."""
    cuts = sorted(rng.choices(range(len(data) + 1), k=rng.randrange(3)))
    for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True):
        if start < end and not wire.is_closed:
            wire.connection.data_received(data[start:end])


def damaged(rng: random.Random, frame: bytes) -> bytes:
    """Damage a frame in one to three places."""
    data = bytearray(frame)
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(data)) if data else 0
        match rng.randrange(5):
            case 0 if data:
                data[at] ^= 1 << rng.randrange(8)
            case 1 if data:
                data[at] = rng.choice((0, 1, 3, 0x7F, 0x80, 0xFF))
            case 2:
                del data[at : at + rng.randint(1, 4)]
            case 3:
                data[at:at] = rng.randbytes(rng.randint(1, 6))
            case _:
                data += frame
    return bytes(data)


def judge(data: bytes) -> tuple[int, bool]:
    """Count the frames in front of the first that is wrong or unfinished, and say whether none was wrong."""
    count = 0
    while len(data) >= 6:
        _, protocol, length = struct.unpack_from(">HHH", data)
        if protocol or not 2 <= length <= 254:
            return count, False
        if len(data) < 6 + length:
            break
        data, count = data[6 + length :], count + 1
    return count, True
