"""One exchange and its times: what comes sooner than the wire allows is nobody's answer."""

from __future__ import annotations

from random import Random

import pytest

from gateway.bus.exchange import Exchanger
from gateway.errors import NoReply, TooLate
from gateway.metrics import LineStats
from gateway.protocol.pdu import ReadWords, WriteRam, Written
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.faults import Fault, Kind
from tests import virtual
from tests.bus.rig import Bench, bench

FREQUENCY_COMMAND = 0xFA01
PROCESSING = 0.05  # seconds, more than any drive takes for these
TOO_MANY = 5  # exchanges; a pseudo-terminal is believed after two, an adapter never

every_protocol = pytest.mark.parametrize("protocol", ["modbus-rtu", "toshiba-ascii", "toshiba-binary"])


async def line_of(protocol: str) -> tuple[Bench, Exchanger, LineStats]:
    """Open the line of one drive behind an adapter that echoes."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    made = bench([{"number": 1, "model": "vf-nc3", "protocol": spoken}], drive={"protocol": protocol})
    made.wire.faults.add(Fault(Kind.ECHO))
    clock, line, stats = virtual.VirtualClock(), made.configured.lines[0], LineStats()
    port = await made.open(line, clock)
    return made, Exchanger(port, line.timing, line.margin, clock, stats), stats


@pytest.mark.hazard("H15")
@every_protocol
def test_the_echo_of_a_write_to_a_dead_drive_acknowledges_nothing(protocol: str) -> None:
    """The same bytes as an acknowledgement, but at once: no reply, however often it is tried."""

    async def main() -> None:
        made, exchanger, stats = await line_of(protocol)
        made.wire.faults.add(Fault(Kind.CUT))
        for word in range(TOO_MANY):
            with pytest.raises(NoReply):
                await exchanger.exchange(PROTOCOLS[protocol], WriteRam(1, FREQUENCY_COMMAND, word), PROCESSING)
        assert stats.errors["early"] == TOO_MANY

    virtual.run(main())


@pytest.mark.hazard("H15")
@every_protocol
def test_behind_an_echo_the_drives_own_answer_is_found(protocol: str) -> None:
    """A write is acknowledged by the drive, a read brings the word, each at the time that a drive needs."""

    async def main() -> None:
        made, exchanger, _ = await line_of(protocol)
        codec = PROTOCOLS[protocol]
        for word in Random(15).sample(range(5000), 20):
            written = await exchanger.exchange(codec, WriteRam(1, FREQUENCY_COMMAND, word), PROCESSING)
            assert isinstance(written.reply, Written)
            assert written.done - written.sent >= made.configured.lines[0].timing.gap
            read = await exchanger.exchange(codec, ReadWords(1, FREQUENCY_COMMAND, 1), PROCESSING)
            assert getattr(read.reply, "words", None) == (word,)

    virtual.run(main())


@pytest.mark.hazard("H11")
def test_a_frame_whose_time_passes_while_the_line_is_busy_does_not_leave() -> None:
    """The gap behind the last answer ends after it: nothing is on the wire; without a limit it goes."""

    async def main() -> None:
        made, exchanger, _ = await line_of("modbus-rtu")
        codec, write = PROTOCOLS["modbus-rtu"], WriteRam(1, FREQUENCY_COMMAND, 3000)
        last = await exchanger.exchange(codec, ReadWords(1, FREQUENCY_COMMAND, 1), PROCESSING)
        with pytest.raises(TooLate):
            await exchanger.exchange(codec, write, PROCESSING, not_after=last.done)
        assert made.wire.statistics.requests == 1
        in_time = last.done + 2 * made.configured.lines[0].timing.gap
        await exchanger.exchange(codec, write, PROCESSING, not_after=in_time)
        assert made.wire.statistics.requests == 2

    virtual.run(main())
