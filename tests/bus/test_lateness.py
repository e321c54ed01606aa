"""A drive that answers each time, too late, is told from one that is silent: F805 is set, and nobody was told."""

from __future__ import annotations

import asyncio

import pytest

from gateway.bus.exchange import Exchanger
from gateway.bus.lateness import LONGEST, LateAnswers
from gateway.errors import BadReply, NoReply, Refused
from gateway.image import LinkState
from gateway.metrics import LineStats
from gateway.protocol.codec import Codec
from gateway.protocol.pdu import ReadWords
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.faults import Fault, Kind
from tests import virtual
from tests.bus.rig import Bench, bench, nc3, run

FREQUENCY = 0xFD00
NOWHERE = 0x9999  # no such number
PROCESSING = 0.015  # seconds
LATE = 0.2  # seconds
REQUEST = ReadWords(1, FREQUENCY)

every_protocol = pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])


async def line_of(protocol: str, fault: Fault) -> tuple[Bench, Exchanger, Codec]:
    """Open the line of one drive that has a fault."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    made = bench([{"number": 1, "model": "vf-nc3", "protocol": spoken}], drive={"protocol": protocol})
    made.wire.faults.add(fault)
    clock, line = virtual.VirtualClock(), made.configured.lines[0]
    port = await made.open(line, clock)
    return made, Exchanger(port, line.timing, line.margin, clock, LineStats()), PROTOCOLS[protocol]


@every_protocol
def test_a_drive_that_was_late_before_is_asked_for_its_waiting_time(protocol: str) -> None:
    """The second time that nothing comes in time, the reason says how long the first answer took, and what to set."""

    async def main() -> None:
        _, exchanger, codec = await line_of(protocol, Fault(Kind.LATE, value=LATE))
        with pytest.raises(NoReply, match=r"no answer$"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)
        await asyncio.sleep(2 * LATE)
        with pytest.raises(NoReply, match=r"no answer in time; one came after 2\d\d ms: .*F805.*wait_time"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)

    virtual.run(main())


@every_protocol
def test_an_answer_in_time_clears_a_drive_of_lateness(protocol: str) -> None:
    """One late answer is soon forgotten: a silence afterwards is just a silence."""

    async def main() -> None:
        made, exchanger, codec = await line_of(protocol, Fault(Kind.LATE, value=LATE, count=1))
        with pytest.raises(NoReply):
            await exchanger.exchange(codec, REQUEST, PROCESSING)
        await asyncio.sleep(2 * LATE)
        await exchanger.exchange(codec, REQUEST, PROCESSING)
        made.wire.faults.add(Fault(Kind.CUT))
        with pytest.raises(NoReply, match=r"no answer$"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)

    virtual.run(main())


@every_protocol
def test_a_refusal_in_time_clears_a_drive_of_lateness(protocol: str) -> None:
    """A drive that says no is heard as well."""

    async def main() -> None:
        made, exchanger, codec = await line_of(protocol, Fault(Kind.LATE, value=LATE, count=1))
        with pytest.raises(NoReply):
            await exchanger.exchange(codec, REQUEST, PROCESSING)
        await asyncio.sleep(2 * LATE)
        with pytest.raises(Refused):
            await exchanger.exchange(codec, ReadWords(1, NOWHERE), PROCESSING)
        made.wire.faults.add(Fault(Kind.CUT))
        with pytest.raises(NoReply, match=r"no answer$"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)

    virtual.run(main())


@every_protocol
def test_a_late_answer_is_known_when_a_neighbour_is_asked_meanwhile(protocol: str) -> None:
    """What was missed is remembered while others are talked to."""

    async def main() -> None:
        spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
        drives = [{"number": number, "model": "vf-nc3", "protocol": spoken} for number in (1, 2)]
        made = bench(drives, drive={"protocol": protocol})
        made.wire.faults.add(Fault(Kind.LATE, 1, value=LATE))
        clock, line = virtual.VirtualClock(), made.configured.lines[0]
        port = await made.open(line, clock)
        exchanger, codec = Exchanger(port, line.timing, line.margin, clock, LineStats()), PROTOCOLS[protocol]
        with pytest.raises(NoReply, match=r"no answer$"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)
        await exchanger.exchange(codec, ReadWords(2, FREQUENCY), PROCESSING)
        await asyncio.sleep(2 * LATE)
        await exchanger.exchange(codec, ReadWords(2, FREQUENCY), PROCESSING)
        with pytest.raises(NoReply, match=r"number 1: no answer in time; one came after 2\d\d ms"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)

    virtual.run(main())


def test_a_late_answer_among_other_bytes_is_known() -> None:
    """In front of a neighbour's answer it is junk to whoever waits for that one, and tells as much."""

    async def main() -> None:
        drives = [{"number": number, "model": "vf-nc3", "protocol": "modbus-rtu"} for number in (1, 2)]
        made = bench(drives)
        made.wire.faults.add(Fault(Kind.LATE, 1, value=LATE))
        clock, line = virtual.VirtualClock(), made.configured.lines[0]
        port = await made.open(line, clock)
        exchanger, codec = Exchanger(port, line.timing, line.margin, clock, LineStats()), PROTOCOLS["modbus-rtu"]
        with pytest.raises(NoReply):
            await exchanger.exchange(codec, REQUEST, PROCESSING)
        made.wire.faults.add(Fault(Kind.CUT, 2))
        with pytest.raises(BadReply, match="number 2: 7 bytes that are no answer"):  # those of number 1
            await exchanger.exchange(codec, ReadWords(2, FREQUENCY), 2 * LATE)
        with pytest.raises(NoReply, match=r"number 1: no answer in time"):
            await exchanger.exchange(codec, REQUEST, PROCESSING)

    virtual.run(main())


def test_noise_between_two_exchanges_makes_no_drive_late() -> None:
    """Bytes that are no answer to what was missed say nothing, nor does what nobody missed, or missed long ago."""
    codec, answer = PROTOCOLS["modbus-rtu"], bytes.fromhex("01 03 02 17 70 B6 50")
    late = LateAnswers()
    late.unasked(answer, 1.0)
    assert late.said(1) == ""
    late.missed(codec, REQUEST, 1.0)
    late.unasked(answer[:-1] + b"\x00", 1.2)
    assert late.said(1) == ""
    late.unasked(answer, 1.1 + LONGEST)
    assert late.said(1) == ""
    late.missed(codec, REQUEST, 5.0)
    late.unasked(b"\xff" + answer, 5.25)
    assert "250 ms" in late.said(1)
    assert late.said(2) == ""


def test_the_reason_of_an_offline_drive_names_its_waiting_time() -> None:
    """What the log, MQTT and the status page say of a drive whose F805 nobody configured."""

    def made() -> Bench:
        stage = bench([nc3()])
        stage.wire.faults.add(Fault(Kind.LATE, value=LATE))
        return stage

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        assert stage.link("d1") is LinkState.OFFLINE
        assert "F805" in stage.image.by_name["d1"].reason

    run(made, play)
