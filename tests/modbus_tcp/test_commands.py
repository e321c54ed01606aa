"""Commands by MODBUS-TCP on a simulated line in virtual time: the drive's own numbers, and what is answered."""

from __future__ import annotations

import asyncio
import struct

import pytest

from gateway.control.command import Reason, Status
from gateway.modbus_tcp.gateway_unit import UNIT
from gateway.sim.condition import TripCode
from gateway.sim.faults import Fault, Kind
from tests.modbus_tcp.plant import Master, Place, Plant, code_of, exchange, play, several

COMMAND, FREQUENCY = 0xFA00, 0xFA01
RUN, STOP = 0xC400, 0x8000


async def armed(plant: Plant) -> Master:
    """Take and arm the first drive."""
    master = plant.connect()
    assert await master.order("take") == 0
    assert await master.order("arm") == 0
    return master


async def running(plant: Plant) -> Master:
    """Take, arm and run the first drive at 30 Hz by its own registers."""
    master = await armed(plant)
    assert await master.write_words(1, COMMAND, RUN, 3000) == 0
    return master


@pytest.mark.hazard("H22")
def test_a_motor_is_run_and_stopped_by_the_drives_own_registers() -> None:
    """10H of FA00 and FA01 in one: the frequency first, then the run bit; read back before the answer."""

    async def script(plant: Plant) -> None:
        await running(plant)
        assert plant.is_running()
        result = plant.results[-1]
        assert list(result.raw) == ["frequency_command", "command"]
        assert result.read_back == {"frequency_command": 3000, "command": RUN}
        master = plant.connect()
        assert await master.ask(1, struct.pack(">BHH", 6, COMMAND, STOP)) == struct.pack(">BHH", 6, COMMAND, STOP)
        assert not plant.is_running()

    play(script)


def test_the_answers_are_those_of_the_standard() -> None:
    """06H echoes the request, 10H tells where and how many."""

    async def script(plant: Plant) -> None:
        master = await armed(plant)
        pdu = struct.pack(">BHH", 6, FREQUENCY, 1234)
        assert await master.ask(1, pdu) == pdu
        assert await master.ask(1, several(COMMAND, STOP, 1234)) == struct.pack(">BHH", 16, COMMAND, 2)

    play(script)


def test_what_was_written_can_be_read_back() -> None:
    """FA00 and FA01 are not polled: for five seconds they are known from reading back, then 0BH; always mapped."""

    async def script(plant: Plant) -> None:
        master = await armed(plant)
        assert code_of(await master.ask(1, struct.pack(">BHH", 3, FREQUENCY, 1))) == 0x0B
        assert await master.write_words(1, COMMAND, STOP, 2500) == 0
        assert await master.read_words(1, COMMAND, 2) == [STOP, 2500]
        await asyncio.sleep(5.1)
        assert code_of(await master.ask(1, struct.pack(">BHH", 3, FREQUENCY, 1))) == 0x0B
        assert code_of(await master.ask(1, struct.pack(">BHH", 3, 0xFA02, 1))) == 0x02

    play(script)


def test_17h_writes_first_and_then_reads() -> None:
    """What it reads is what it wrote; a range that is not mapped is refused before anything is written."""

    async def script(plant: Plant) -> None:
        master = await armed(plant)
        assert await master.ask(1, exchange(FREQUENCY, 1, FREQUENCY, 4000)) == b"\x17\x02" + struct.pack(">H", 4000)
        told = await master.ask(1, exchange(0xFD00, 1, FREQUENCY, 4100))
        assert told == b"\x17\x02\0\0"
        before = len(plant.results)
        assert await master.ask(1, exchange(0xFD0A, 1, FREQUENCY, 4200)) == b"\x97\x02"
        assert len(plant.results) == before

    play(script)


REFUSED = [
    ("02: in no model", 0xFA02, [0], 2),
    ("02: a hole among several", COMMAND, [RUN, 0, 0], 2),
    ("02: read only", 0xFD00, [0], 2),
    ("02: forbidden, the number", 0x0802, [2], 2),
    ("02: stored, not allowed", 0x0009, [100], 2),
    ("02: beyond FFFFH", 0xFFFF, [0, 0], 2),
    ("03: beyond the frequency configured", FREQUENCY, [6001], 3),
    ("03: out of range behind a good one", COMMAND, [RUN, 6001], 3),
    ("03: a reset with the run bit", COMMAND, [0xA400], 3),
    ("06: run, not armed", COMMAND, [RUN], 6),
]


@pytest.mark.hazard("H22")
@pytest.mark.hazard("H28")
@pytest.mark.hazard("H31")
@pytest.mark.parametrize(("address", "words", "code"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_what_is_refused_sends_no_frame(address: int, words: list[int], code: int) -> None:
    """The request is judged whole: one word that is wrong, and none is written."""

    async def script(plant: Plant) -> None:
        master = plant.connect()
        assert await master.order("take") == 0
        plant.written.clear()
        assert await master.write_words(1, address, *words) == code
        await asyncio.sleep(1.0)
        assert plant.written == []
        assert (plant.word("command"), plant.word("frequency_command")) == (0, 0)

    play(script)


@pytest.mark.hazard("H04")
def test_only_the_owner_commands_but_everybody_may_stop() -> None:
    """06 for another host, for setpoints and for taking; its stop is obeyed; a second connection is the owner too."""

    async def script(plant: Plant) -> None:
        await running(plant)
        other = plant.connect("10.0.0.8")
        assert await other.write_one(1, FREQUENCY, 1000) == 6
        assert await other.order("take") == 6
        assert await plant.connect().write_one(1, FREQUENCY, 2000) == 0
        assert await other.write_one(1, COMMAND, STOP) == 0
        assert not plant.is_running()

    play(script)


@pytest.mark.hazard("H04")
@pytest.mark.parametrize("words", [[0x0000], [0x8C00], [0x9400], [STOP, 0], [STOP, 6001], [0, 0, 0]])
def test_every_raw_stop_of_another_host_is_obeyed(words: list[int]) -> None:
    """By 06H, 10H and 17H alike; nothing else of it is written, and the terminals do not take over."""

    async def script(plant: Plant) -> None:
        for ask in range(3 if len(words) == 1 else 2):
            await running(plant)
            other, before = plant.connect("10.0.0.8"), plant.word("frequency_command")
            one = struct.pack(">BHH", 6, COMMAND, words[0])
            pdu = (several(COMMAND, *words), exchange(0xFD00, 1, COMMAND, *words), one)[ask]
            plant.written.clear()
            assert code_of(await other.ask(1, pdu)) == 0
            assert not plant.is_running()
            assert [address for _, address, _ in plant.written] == [COMMAND]
            assert plant.word("command") & 0x8500 == 0x8000
            assert plant.word("frequency_command") == before
            if plant.bench.drive.inverter.condition.is_tripped:
                break

    play(script)


@pytest.mark.hazard("H04", "H28")
def test_a_raw_stop_needs_no_right_but_a_source() -> None:
    """Of the owner, and of a host without any right; a run word of it is 01 as ever."""

    async def script(plant: Plant) -> None:
        other = plant.connect("10.0.0.8")
        for host, words in ((other, [STOP]), (plant.connect(), [STOP]), (other, [STOP, 0])):
            await running_by_mirror(plant)
            assert await host.write_words(1, COMMAND, *words) == 0
            assert not plant.is_running()
        assert await other.write_one(1, COMMAND, RUN) == 1

    commands = ["take", "arm", "run", "frequency"]
    play(script, control={"right": [{"source": "modbus-tcp", "name": "10.0.0.7", "commands": commands}]})


async def running_by_mirror(plant: Plant) -> None:
    """Take, arm and run the first drive by the mirror."""
    master = await armed(plant)
    assert await master.order("run") == 0
    assert plant.is_running()


@pytest.mark.hazard("H04", "H22")
@pytest.mark.parametrize(("words", "code"), [([STOP, 7000], 3), ([STOP, 3000, 0], 2), ([0, 6001], 3)])
def test_a_stop_is_carried_out_although_something_wrong_stands_beside_it(words: list[int], code: int) -> None:
    """The motor stops; then the exception tells of the words that were not written, and the result of both."""

    async def script(plant: Plant) -> None:
        master = await running(plant)
        plant.written.clear()
        assert await master.write_words(1, COMMAND, *words) == code
        assert not plant.is_running()
        assert plant.written == [(1, COMMAND, words[0])]
        result = plant.results[-1]
        assert (result.status, result.raw) == (Status.FAILED, {"command": words[0]})
        assert result.text.startswith("stopped; not written: ")

    play(script)


@pytest.mark.hazard("H04")
def test_a_stop_is_carried_out_although_17h_cannot_read() -> None:
    """02 afterwards; anything else is not written at all."""

    async def script(plant: Plant) -> None:
        master = await running(plant)
        assert await master.ask(1, exchange(0xFD0A, 1, COMMAND, STOP)) == b"\x97\x02"
        assert not plant.is_running()

    play(script)


@pytest.mark.hazard("H10")
def test_a_stop_goes_first_although_the_lease_is_given_back_behind_it() -> None:
    """Stop with a setpoint, then release, in one segment: the stop is written until it is read back, nothing else."""

    async def script(plant: Plant) -> None:
        master = await running(plant)
        plant.written.clear()
        plant.bench.wire.faults.add(Fault(Kind.CUT, 1, count=2))
        stop = master.send(1, several(COMMAND, STOP, 1000))
        await master.order("release")
        await asyncio.sleep(2.0)
        assert not plant.is_running()
        assert {word for _, address, word in plant.written if address == COMMAND} == {STOP}
        assert plant.written[0] == (1, COMMAND, STOP)
        assert plant.written.count((1, COMMAND, STOP)) > 1
        assert (1, FREQUENCY, 1000) not in plant.written
        assert code_of(master.told(stop) or b"") == 0

    play(script)


@pytest.mark.hazard("H28")
def test_without_a_right_nothing_is_written() -> None:
    """01 for a register, a value, a host without a right, and for a channel that is no source of the drive."""

    async def rights(plant: Plant) -> None:
        master, other = await armed(plant), plant.connect("10.0.0.8")
        assert await master.write_one(1, FREQUENCY, 1000) == 0
        plant.written.clear()
        assert await master.write_one(1, FREQUENCY, 2001) == 1
        assert await master.write_one(1, 0xFA50, 1) == 1
        assert await other.order("take") == 1
        assert plant.written == []

    async def not_a_source(plant: Plant) -> None:
        master = plant.connect()
        assert await master.order("take") == 1
        assert await master.write_one(1, COMMAND, STOP) == 1
        assert plant.results[-1].raw == {}

    right = {"source": "modbus-tcp", "name": "10.0.0.7", "registers": ["command", "frequency_command"], "max": 20.0}
    play(rights, control={"right": [right]})
    play(not_a_source, control={"sources": ["mqtt"]})


@pytest.mark.hazard("H28")
def test_a_drive_that_is_not_controlled_takes_no_write() -> None:
    """01 under its unit; and without any controlled drive there is no mirror either."""

    async def script(plant: Plant) -> None:
        master = plant.connect()
        plant.written.clear()
        assert await master.write_one(1, COMMAND, STOP) == 1
        assert await master.ask(1, exchange(0xFD00, 1, FREQUENCY, 1)) == b"\x97\x01"
        assert await master.order("take") == 1
        assert code_of(await master.ask(UNIT, struct.pack(">BHH", 3, 0x8000, 1))) == 2
        assert plant.written == []

    play(script, control={"control": "off"})


@pytest.mark.hazard("H27")
def test_an_answer_that_is_lost_is_an_unknown_outcome_or_a_failure() -> None:
    """0BH: the frame, or its answer, did not arrive; the write that did arrive is read back and is done."""

    async def lost(plant: Plant) -> None:
        master = plant.connect()
        plant.bench.wire.faults.add(Fault(Kind.CUT, 1, count=1))
        assert await master.write_one(1, FREQUENCY, 1000) == 0x0B
        assert plant.word("frequency_command") == 0

    async def answer_lost(plant: Plant) -> None:
        master = plant.connect()
        plant.bench.wire.faults.add(Fault(Kind.DROP, 1, count=1))
        assert await master.write_one(1, FREQUENCY, 1000) == 0
        assert plant.word("frequency_command") == 1000

    play(lost, control={"control": "direct"})
    play(answer_lost, control={"control": "direct"})


@pytest.mark.hazard("H27")
def test_a_silent_drive_is_0bh_and_a_line_without_adapter_0ah() -> None:
    """A stop too; unit 0 and units that nobody has are 0AH at any time."""

    async def script(plant: Plant) -> None:
        master = plant.connect()
        for unit in (0, 9, 248, 254):
            assert await master.write_one(unit, COMMAND, STOP) == 0x0A
        plant.bench.wire.faults.add(Fault(Kind.CUT, 1))
        await asyncio.sleep(5.0)
        assert await master.write_one(1, FREQUENCY, 1000) == 0x0B
        assert await master.write_one(1, COMMAND, STOP) == 0x0B
        assert await master.order("stop") == 0x0B
        plant.bench.unplug()
        await asyncio.sleep(6.0)
        assert await master.write_one(1, FREQUENCY, 1000) == 0x0A
        assert await master.write_one(1, COMMAND, STOP) == 0x0A
        assert await master.order("stop") == 0x0A

    play(script, control={"control": "direct"})


def test_what_the_drive_refuses_is_04() -> None:
    """AU1 cannot be written while the motor runs."""

    async def script(plant: Plant) -> None:
        master = await running(plant)
        assert await master.write_one(1, 0x0000, 1) == 4
        assert plant.results[-1].reason is Reason.REFUSED_BY_DRIVE

    play(script, control={"allow_stored": True})


@pytest.mark.hazard("H05")
def test_a_connection_that_is_closed_does_not_end_the_lease_and_is_none() -> None:
    """A new connection of the same host goes on; without a sign of life the drive is stopped."""

    async def script(plant: Plant) -> None:
        master = await running(plant)
        master.abort()
        await asyncio.sleep(1.5)
        assert plant.is_running()
        assert await plant.connect().write_one(1, FREQUENCY, 2000) == 0
        await asyncio.sleep(2.5)
        assert not plant.is_running()
        assert any(event == "lease_lost" for _, event, _ in plant.events)

    play(script)


def test_a_connection_closed_while_its_write_is_under_way_changes_nothing() -> None:
    """The motor starts, the result goes nowhere, and nothing is written to the socket."""

    async def script(plant: Plant) -> None:
        master = await armed(plant)
        sent = master.sent
        master.send(1, several(COMMAND, RUN, 3000))
        master.abort()
        await asyncio.sleep(0.5)
        assert plant.is_running()
        assert master.sent == sent

    play(script)


def test_pipelined_writes_are_carried_out_and_answered_in_order() -> None:
    """Four writes and a read in one segment: the read sees the last of them."""

    async def script(plant: Plant) -> None:
        master = await armed(plant)
        numbers = [master.send(1, struct.pack(">BHH", 6, 0xFA50, word % 2)) for word in range(3)]
        numbers.append(master.send(1, struct.pack(">BHH", 6, FREQUENCY, 1500)))
        last = await master.ask(1, struct.pack(">BHH", 3, FREQUENCY, 1))
        assert last == b"\x03\x02" + struct.pack(">H", 1500)
        assert [code_of(master.told(number) or b"\x80\xff") for number in numbers] == [0, 0, 0, 0]

    play(script)


def test_a_fault_reset_is_acknowledged_and_told_by_the_mirror() -> None:
    """It takes longer than a client waits: 05, under way; then done, and the drive is to be armed again."""

    async def script(plant: Plant) -> None:
        master = await armed(plant)
        plant.bench.drive.inverter.trip(TripCode.EMERGENCY)
        await asyncio.sleep(1.0)
        assert await master.order("run") == 6
        assert await master.order("reset") == 5
        assert await master.shown(Place.RESULT) == 5
        for beat in range(20):
            await master.write_one(UNIT, 0x8001, beat)
            await asyncio.sleep(0.5)
            if await master.shown(Place.RESULT) != 5:
                break
        assert await master.shown(Place.RESULT) == 1
        assert await master.shown(Place.STANDING) == 2

    play(script)
