"""Unit 255 with commands: where its registers stand, what they show, and stops of whole lines."""

from __future__ import annotations

import asyncio
import struct

import pytest

from gateway.control.command import Channel, Reason, Result, Source, Status, Verb
from gateway.control.state import Standing
from gateway.image import LinkState
from gateway.modbus_tcp.connection import source_of
from gateway.modbus_tcp.mirror_map import LINES_AT, MIRROR_AT, PER_DRIVE, REASONS
from tests.modbus_tcp.plant import CODES, UNIT, Listening, Master, Place, code_of, exchange, mirror, several, stop_of

PLC = source_of(("10.0.0.7", "1"))
NO_VALUE = 0x8000
STOP_WORD = 0x8000


def told(master: Master, pdu: bytes) -> bytes:
    """Return the answer to a request that is answered at once."""
    answer = master.told(master.send(UNIT, pdu))
    assert answer is not None
    return answer


def words(master: Master, start: int, count: int) -> list[int]:
    """Read registers of unit 255."""
    return list(struct.unpack(f">{count}H", told(master, struct.pack(">BHH", 3, start, count))[2:]))


def shown(master: Master, index: int = 0) -> dict[Place, int]:
    """Read all registers of a drive."""
    return dict(zip(Place, words(master, MIRROR_AT + PER_DRIVE * index, PER_DRIVE), strict=True))


async def test_every_drive_has_sixteen_registers_in_the_order_of_the_file() -> None:
    """One that is not controlled too: it has no standing, and its values."""
    made = Listening({}, {"control": "off"}, {})
    made.image.by_name["d2"].apply([(0xFD00, 5000)], made.clock.now(), 0.0)
    master = made.connect()
    block = words(master, MIRROR_AT, 48)
    assert [block[PER_DRIVE * i + Place.STANDING] for i in range(3)] == [2, 0, 2]
    assert [block[PER_DRIVE * i + Place.OUTPUT_FREQUENCY] for i in range(3)] == [NO_VALUE, 5000, NO_VALUE]
    for start in range(MIRROR_AT, MIRROR_AT + 48):
        assert words(master, start, 1) == [block[start - MIRROR_AT]]
    assert words(master, MIRROR_AT + 15, 2) == block[15:17]


@pytest.mark.parametrize(
    ("start", "count"),
    [(MIRROR_AT - 1, 1), (MIRROR_AT - 1, 2), (MIRROR_AT + 32, 1), (MIRROR_AT + 31, 2), (LINES_AT - 1, 2),
     (LINES_AT + 1, 1), (0xFFFF, 1)],
)  # fmt: skip
async def test_beside_the_mirror_there_is_nothing(start: int, count: int) -> None:
    """02, for reads, for writes, and for the half of 17H that reads: which then writes nothing."""
    made = Listening({}, {})
    master = made.connect()
    assert told(master, struct.pack(">BHH", 3, start, count)) == b"\x83\x02"
    assert code_of(told(master, several(start, *[0] * count))) == 2
    assert told(master, exchange(start, count, mirror(Place.COMMAND), CODES["stop"])) == b"\x97\x02"
    assert made.door.asked == []


@pytest.mark.hazard("H22")
@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("address", "asked", "code"),
    [
        pytest.param(mirror(Place.ECHO), [0], 2, id="a register that is only read"),
        pytest.param(mirror(Place.SEQUENCE), [1, 0], 2, id="over the end of those that are written"),
        pytest.param(mirror(Place.TRIP_CODE), [0, 4], 2, id="over two drives"),
        pytest.param(mirror(Place.COMMAND), [4, 1, 0, 0, 0, 0], 2, id="one too many"),
        pytest.param(mirror(Place.COMMAND), [15], 3, id="an unknown code"),
        pytest.param(mirror(Place.COMMAND), [0xFFFF, 1, 3000], 3, id="an unknown code in an image"),
        pytest.param(mirror(Place.COMMAND, 1), [4], 1, id="a drive that is not controlled"),
        pytest.param(0, [0], 2, id="the compact map"),
        pytest.param(0xF000, [0], 2, id="the counters"),
        pytest.param(LINES_AT, [8], 3, id="run for a line"),
        pytest.param(LINES_AT, [6, 9], 3, id="a good code and a wrong one"),
        pytest.param(LINES_AT + 2, [6], 1, id="a line without a controlled drive"),
        pytest.param(LINES_AT, [6, 6, 6, 6], 2, id="more lines than there are"),
    ],
)
async def test_what_cannot_be_written_is_refused_whole(address: int, asked: list[int], code: int) -> None:
    """Not even the heartbeat in it is taken."""
    made = Listening({}, {"control": "off"}, {}, {"control": "off"}, {"control": "off"}, lines=3)
    master = made.connect()
    assert code_of(told(master, several(address, *asked))) == code
    assert (made.door.asked, made.door.line_stops, made.door.beats) == ([], [], [])


async def test_a_command_is_shown_with_its_sequence_from_under_way_to_its_end() -> None:
    """What a PLC waits for: its own number in `echo`, and a status that is not 5."""
    made = Listening()
    state = made.door.state("d1")
    state.standing = Standing.ARMED
    state.lease.take(PLC, made.clock.now())
    master = made.connect()
    master.send(UNIT, several(mirror(Place.COMMAND), CODES["run"], 7, 3000, 0, 41))
    found = shown(made.connect())
    assert [found[place] for place in Place][:5] == [CODES["run"], 7, 3000, 0, 41]
    assert (found[Place.ECHO], found[Place.RESULT], found[Place.REASON]) == (41, 5, 0)
    await made.end(Status.REFUSED, Reason.NOT_ARMED)
    found = shown(master)
    assert (found[Place.ECHO], found[Place.RESULT], found[Place.REASON]) == (41, 2, REASONS[Reason.NOT_ARMED])
    master.send(UNIT, several(mirror(Place.COMMAND), CODES["arm"], 8, 3000, 0, 42))
    await made.end()
    found = shown(master)
    assert (found[Place.ECHO], found[Place.RESULT], found[Place.REASON]) == (42, 1, 0)


@pytest.mark.hazard("H04")
async def test_who_does_not_own_a_drive_does_not_change_what_the_owner_reads() -> None:
    """Its refusal is its own; while nobody owns the drive, the last one is shown."""
    made = Listening()
    made.door.state("d1").lease.take(PLC, made.clock.now())
    master, other = made.connect(), made.connect("10.0.0.8")
    master.send(UNIT, several(mirror(Place.COMMAND), CODES["arm"], 1, 0, 0, 5))
    await made.end()
    other.send(UNIT, several(mirror(Place.COMMAND), CODES["take"], 1, 0, 0, 99))
    await made.end(Status.REFUSED, Reason.NOT_OWNER)
    assert shown(other)[Place.ECHO] == 5
    made.door.state("d1").lease.end()
    other.send(UNIT, several(mirror(Place.COMMAND), CODES["take"], 1, 0, 0, 100))
    await made.end()
    assert shown(master)[Place.ECHO] == 100


async def test_standing_owner_and_what_is_left_of_the_lease_are_shown() -> None:
    """Channel 2 and its address for a host, 1 and zeros for MQTT; nobody when it has run out."""
    made = Listening()
    state, master = made.door.state("d1"), made.connect()
    state.lease.take(PLC, made.clock.now())
    state.standing = Standing.ARMED
    made.clock.moment += 0.5
    found = shown(master)
    assert (found[Place.STANDING], found[Place.OWNER], found[Place.LEASE_LEFT]) == (1, 2, 1500)
    assert (found[Place.OWNER_HIGH], found[Place.OWNER_LOW]) == (10 << 8, 7)
    made.clock.moment += 1.5
    found = shown(master)
    assert (found[Place.OWNER], found[Place.OWNER_HIGH], found[Place.OWNER_LOW], found[Place.LEASE_LEFT]) == (0,) * 4
    state.lease.end()
    state.lease.take(Source(Channel.MQTT, "dashboard"), made.clock.now())
    found = shown(master)
    assert (found[Place.OWNER], found[Place.OWNER_HIGH], found[Place.OWNER_LOW]) == (1, 0, 0)


async def test_a_long_lease_saturates() -> None:
    """16 bits of milliseconds."""
    made = Listening()
    lease = made.door.state("d1").lease
    lease.duration = 100.0
    lease.take(PLC, made.clock.now())
    assert shown(made.connect())[Place.LEASE_LEFT] == 0xFFFF


CYCLE = 11  # registers from `echo` to the end of a drive


def cycle(master: Master, *outputs: int) -> dict[Place, int]:
    """Write the first registers of d1 and read the others, by one 17H that is answered at once."""
    answer = told(master, exchange(mirror(Place.ECHO), CYCLE, mirror(Place.COMMAND), *outputs))
    return dict(zip(list(Place)[5:], struct.unpack(f">{CYCLE}H", answer[2:]), strict=True))


async def test_17h_that_reads_the_status_is_answered_at_once_whatever_the_end() -> None:
    """Under way, then refused, done, and ended: never an exception that would hide the registers."""
    made = Listening()
    made.image.by_name["d1"].apply([(0xFD01, 0x0400), (0xFD00, 2990)], made.clock.now(), 0.0)
    state = made.door.state("d1")
    state.lease.take(PLC, made.clock.now())
    state.is_online, state.standing = True, Standing.ARMED
    master = made.connect()
    found = cycle(master, CODES["run"], 1, 3000, 0, 3)
    assert (found[Place.ECHO], found[Place.RESULT], found[Place.OUTPUT_FREQUENCY]) == (3, 5, 2990)
    assert found[Place.DRIVE_STATUS] == 0x0400
    assert cycle(master, CODES["run"], 2, 3000, 0, 3)[Place.RESULT] == 5
    await made.end(Status.REFUSED, Reason.RANGE)
    found = cycle(master, CODES["run"], 3, 3000, 0, 3)
    assert (found[Place.RESULT], found[Place.REASON]) == (2, REASONS[Reason.RANGE])
    cycle(master, CODES["run"], 4, 3000, 0, 4)
    await made.end()
    state.facts["command"] = 0xC400
    found = cycle(master, CODES["run"], 5, 3000, 0, 4)
    assert (found[Place.ECHO], found[Place.RESULT]) == (4, 1)
    state.facts["command"] = STOP_WORD
    found = cycle(master, CODES["run"], 6, 3000, 0, 4)
    assert (found[Place.ECHO], found[Place.RESULT]) == (4, 6)
    assert made.door.asked == []


async def test_17h_reads_the_end_of_its_own_command() -> None:
    """Not that of the owner."""
    made = Listening()
    made.door.state("d1").lease.take(PLC, made.clock.now())
    master, other = made.connect(), made.connect("10.0.0.8")
    cycle(master, CODES["arm"], 1, 0, 0, 5)
    await made.end()
    cycle(other, CODES["take"], 1, 0, 0, 99)
    await made.end(Status.REFUSED, Reason.NOT_OWNER)
    found = cycle(other, CODES["take"], 2, 0, 0, 99)
    assert (found[Place.ECHO], found[Place.REASON]) == (99, REASONS[Reason.NOT_OWNER])
    assert shown(other)[Place.ECHO] == 5


async def test_17h_that_reads_something_else_waits_for_the_end() -> None:
    """And is answered with its exception, as 10H is."""
    made = Listening()
    master = made.connect()
    asked = master.send(UNIT, exchange(mirror(Place.STANDING), 1, mirror(Place.COMMAND), CODES["arm"], 1))
    assert master.told(asked) is None
    await made.end()
    assert master.told(asked) == b"\x17\x02\x00\x02"
    asked = master.send(UNIT, exchange(mirror(Place.STANDING), 1, mirror(Place.COMMAND), CODES["take"], 1))
    await made.end(Status.REFUSED, Reason.NOT_OWNER)
    assert master.told(asked) == b"\x97\x06"
    assert told(master, exchange(mirror(Place.RESULT), 1, mirror(Place.COMMAND), 99)) == b"\x97\x03"


class TestLineStops:
    """One register a line, from E000H."""

    @pytest.mark.parametrize("word", ["stop", "coast", "emergency_stop"])
    async def test_a_line_is_stopped_and_the_worst_end_is_told(self, word: str) -> None:
        """All done: good; one unknown: 0BH, though others were refused or failed."""
        made = Listening({}, {}, {}, {}, lines=2)
        master = made.connect()
        for ends, code in (
            ((Status.DONE, Status.DONE), 0),
            ((Status.REFUSED, Status.DONE), 6),
            ((Status.UNKNOWN, Status.REFUSED), 0x0B),
            ((Status.DONE, Status.FAILED), 4),
        ):
            asked = master.send(UNIT, struct.pack(">BHH", 6, LINES_AT + 1, CODES[word]))
            ((line, verb, source, answer),) = made.door.line_stops
            assert (line, verb, source) == ("b", Verb(word), PLC)
            made.door.line_stops.clear()
            for end in ends:
                assert master.told(asked) is None
                reason = Reason.NONE if end is Status.DONE else Reason.QUIESCED
                answer(Result(stop_of("d3"), end, reason))
            await asyncio.sleep(0)
            assert code_of(master.told(asked) or b"\xff\xff") == code
        assert words(master, LINES_AT, 2) == [0, CODES[word]]

    async def test_all_lines_in_one_request(self) -> None:
        """Each by its own word; 0 leaves a line alone."""
        made = Listening({}, {}, {}, lines=3)
        master = made.connect()
        asked = master.send(UNIT, several(LINES_AT, CODES["emergency_stop"], 0, CODES["stop"]))
        stops = made.door.line_stops
        assert [(line, verb) for line, verb, _, _ in stops] == [("a", Verb.EMERGENCY_STOP), ("c", Verb.STOP)]
        for (_, _, _, answer), drive in zip(stops, ("d1", "d3"), strict=True):
            answer(Result(stop_of(drive), Status.DONE))
        await asyncio.sleep(0)
        assert code_of(master.told(asked) or b"\xff\xff") == 0
        assert words(master, LINES_AT, 3) == [CODES["emergency_stop"], 0, CODES["stop"]]

    @pytest.mark.hazard("H29")
    async def test_the_same_word_stops_again_only_what_may_move(self) -> None:
        """A PLC may write it in every cycle."""
        made = Listening({}, {})
        master, states = made.connect(), [made.door.state(name) for name in ("d1", "d2")]
        for state in states:
            state.is_online = True
            state.facts["command"] = STOP_WORD

        def cycle() -> int:
            master.send(UNIT, struct.pack(">BHH", 6, LINES_AT, CODES["stop"]))
            count = len(made.door.line_stops)
            for _, _, _, answer in made.door.line_stops:
                for drive in ("d1", "d2"):
                    answer(Result(stop_of(drive), Status.DONE))
            made.door.line_stops.clear()
            return count

        assert [cycle(), cycle(), cycle()] == [1, 0, 0]
        states[1].facts["command"] = 0xC400
        assert [cycle(), cycle()] == [1, 1]
        states[1].facts["command"] = STOP_WORD
        assert cycle() == 0

    async def test_the_same_stop_is_not_begun_anew_while_it_is_under_way(self) -> None:
        """05, from the same host; another word, or another host's, is taken."""
        made = Listening({}, {})
        master, other = made.connect(), made.connect("10.0.0.8")
        first = master.send(UNIT, struct.pack(">BHH", 6, LINES_AT, CODES["stop"]))
        assert told(made.connect(), struct.pack(">BHH", 6, LINES_AT, CODES["stop"])) == b"\x86\x05"
        master.send(UNIT, struct.pack(">BHH", 6, LINES_AT, CODES["emergency_stop"]))
        other.send(UNIT, struct.pack(">BHH", 6, LINES_AT, CODES["emergency_stop"]))
        assert [verb for _, verb, _, _ in made.door.line_stops] == [
            Verb.STOP,
            Verb.EMERGENCY_STOP,
            Verb.EMERGENCY_STOP,
        ]
        for _, _, _, answer in made.door.line_stops:
            for drive in ("d1", "d2"):
                answer(Result(stop_of(drive), Status.UNKNOWN, Reason.NO_ANSWER))
        await asyncio.sleep(0)
        assert master.told(first) == b"\x86\x0b"
        made.door.line_stops.clear()
        master.send(UNIT, struct.pack(">BHH", 6, LINES_AT, CODES["emergency_stop"]))
        assert len(made.door.line_stops) == 1

    async def test_a_line_that_is_down_is_0ah(self) -> None:
        """As for one drive."""
        made = Listening()
        made.image.by_name["d1"].set_link(LinkState.LINE_DOWN, "unplugged")
        master = made.connect()
        asked = master.send(UNIT, struct.pack(">BHH", 6, LINES_AT, CODES["stop"]))
        made.door.line_stops[0][3](Result(stop_of("d1"), Status.REFUSED, Reason.OFFLINE))
        await asyncio.sleep(0)
        assert master.told(asked) == b"\x86\x0a"
