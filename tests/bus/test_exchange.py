"""One exchange and its times: what comes sooner than the wire allows is nobody's answer."""

from __future__ import annotations

from random import Random

import pytest

from gateway.bus.echo import ABSENT_AFTER, LocalEcho
from gateway.bus.exchange import Exchanger
from gateway.errors import BadReply, NoReply, TooLate
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


async def line_of(protocol: str, mode: str = "auto") -> tuple[Bench, Exchanger, LineStats]:
    """Open the line of one drive behind an adapter that echoes."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    made = bench([{"number": 1, "model": "vf-nc3", "protocol": spoken}], drive={"protocol": protocol})
    made.wire.faults.add(Fault(Kind.ECHO))
    clock, line, stats = virtual.VirtualClock(), made.configured.lines[0], LineStats()
    port = await made.open(line, clock)
    return made, Exchanger(port, line.timing, line.margin, clock, stats, LocalEcho(mode, "a")), stats


async def learn(exchanger: Exchanger, protocol: str) -> None:
    """Read once, so that the echo is known."""
    await exchanger.exchange(PROTOCOLS[protocol], ReadWords(1, FREQUENCY_COMMAND), PROCESSING)


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


@pytest.mark.hazard("H15")
@every_protocol
@pytest.mark.parametrize("mode", ["auto", "on"])
def test_a_known_echo_of_a_write_to_a_dead_drive_is_no_answer_whatever_its_time(
    protocol: str, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bytes tell, not the time: an adapter may hold its echo back until an answer would be due."""

    async def main() -> None:
        made, exchanger, stats = await line_of(protocol, mode)
        if mode == "auto":
            await learn(exchanger, protocol)
        assert stats.has_echo
        made.wire.faults.add(Fault(Kind.CUT))
        monkeypatch.setattr(Exchanger, "_is_credible", lambda *_: True)
        for word in range(TOO_MANY):
            with pytest.raises(NoReply, match="only the echo"):
                await exchanger.exchange(PROTOCOLS[protocol], WriteRam(1, FREQUENCY_COMMAND, word), PROCESSING)
        assert stats.errors["echo"] == TOO_MANY

    virtual.run(main())


@pytest.mark.hazard("H15")
@every_protocol
def test_a_known_echo_does_not_lengthen_the_wait_for_a_dead_drive(protocol: str) -> None:
    """The echo is no first character of an answer."""

    async def main() -> None:
        made, exchanger, _ = await line_of(protocol)
        await learn(exchanger, protocol)
        made.wire.faults.add(Fault(Kind.CUT))
        line, clock = made.configured.lines[0], virtual.VirtualClock()
        codec, request = PROTOCOLS[protocol], ReadWords(1, FREQUENCY_COMMAND)
        begun = clock.now()
        with pytest.raises(NoReply, match="only the echo"):
            await exchanger.exchange(codec, request, PROCESSING)
        sent = line.timing.request(len(codec.encode(request)))
        assert clock.now() - begun <= sent + PROCESSING + line.margin + 3 * line.timing.gap

    virtual.run(main())


@pytest.mark.hazard("H15")
@every_protocol
def test_a_damaged_echo_spoils_the_answer_behind_it_and_is_counted(protocol: str) -> None:
    """What the drives have heard is not what was sent; the next exchange is good again."""

    async def main() -> None:
        made, exchanger, stats = await line_of(protocol)
        await learn(exchanger, protocol)
        codec = PROTOCOLS[protocol]
        made.wire.faults.clear(kind=Kind.ECHO)
        made.wire.faults.add(Fault(Kind.BABBLE, value=8))
        with pytest.raises(BadReply, match="the line is disturbed"):
            await exchanger.exchange(codec, ReadWords(1, FREQUENCY_COMMAND), PROCESSING)
        assert stats.errors["collision"] == 1
        made.wire.faults.clear()
        made.wire.faults.add(Fault(Kind.ECHO))
        await learn(exchanger, protocol)

    virtual.run(main())


@every_protocol
def test_an_adapter_that_stops_echoing_is_understood(protocol: str) -> None:
    """Reads are answered without a pause; after a few a write is believed again."""

    async def main() -> None:
        made, exchanger, stats = await line_of(protocol)
        await learn(exchanger, protocol)
        made.wire.faults.clear()
        for _ in range(ABSENT_AFTER):
            assert stats.has_echo
            await learn(exchanger, protocol)
        assert stats.has_echo is False
        written = await exchanger.exchange(PROTOCOLS[protocol], WriteRam(1, FREQUENCY_COMMAND, 5), PROCESSING)
        assert isinstance(written.reply, Written)

    virtual.run(main())


@every_protocol
def test_a_configured_echo_that_does_not_come_is_named(protocol: str) -> None:
    """The adapter is not as it was said to be: no answer is believed, and the key is named."""

    async def main() -> None:
        made, exchanger, stats = await line_of(protocol, "on")
        made.wire.faults.clear()
        with pytest.raises(BadReply, match='local_echo = "on"'):
            await exchanger.exchange(PROTOCOLS[protocol], ReadWords(1, FREQUENCY_COMMAND), PROCESSING)
        assert stats.errors["collision"] == 1
        made.wire.faults.add(Fault(Kind.CUT))
        with pytest.raises(NoReply, match="not even the adapter's echo"):
            await exchanger.exchange(PROTOCOLS[protocol], ReadWords(1, FREQUENCY_COMMAND), PROCESSING)

    virtual.run(main())
