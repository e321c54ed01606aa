"""What a line tells its tap: every frame that went over it, with what was made of it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from gateway.bus.exchange import Exchanger
from gateway.errors import BadReply, GatewayError, LineDown, NoReply, Refused
from gateway.metrics import LineStats
from gateway.protocol.pdu import EVERY_DRIVE, ReadWords, Request, WriteRam
from gateway.protocol.registry import PROTOCOLS
from gateway.sim.faults import Fault, Kind
from gateway.sim.journal import Way as Whose
from gateway.trace.frames import Frame, Way, frames
from gateway.trace.meaning import Meaning
from gateway.trace.record import Told, Verdict
from tests import virtual
from tests.bus.rig import Bench, bench

PROCESSING = 0.015
READ = ReadWords(1, 0xFD00)
V = Verdict

every_protocol = pytest.mark.parametrize("protocol", sorted(PROTOCOLS))


class Stage:
    """One exchanger with a tap, on a simulated line of one drive."""

    def __init__(self, protocol: str = "modbus-rtu") -> None:
        spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
        simulated = [{"number": 1, "model": "vf-nc3", "protocol": spoken}]
        self.bench: Bench = bench(simulated, drive={"protocol": protocol})
        self.codec = PROTOCOLS[protocol]
        self.told: list[Told] = []
        self.stats = LineStats()

    async def open(self) -> Exchanger:
        """Open the line."""
        line = self.bench.configured.lines[0]
        port = await self.bench.open(line, virtual.VirtualClock())
        return Exchanger(port, line.timing, line.margin, virtual.VirtualClock(), self.stats, tap=self.told.append)

    def frames(self) -> list[Frame]:
        """Return every frame that was told."""
        return [frame for told in self.told for frame in frames("a", told, Meaning(), 0.0)]

    def verdicts(self) -> list[tuple[str, Verdict]]:
        """Return way and verdict of each."""
        return [(frame.way.value, frame.verdict) for frame in self.frames()]

    def on_the_wire(self) -> bytes:
        """Return every byte that the simulated line carried, as the master had it."""
        entries = self.bench.wire.journal.last(1000)
        return b"".join(entry.data for entry in entries if entry.way in (Whose.REQUEST, Whose.HEARD))


def play(stage: Callable[[], Stage], action: Callable[[Stage, Exchanger], Awaitable[None]]) -> Stage:
    """Let something be done with an exchanger, in virtual time."""

    async def main() -> Stage:
        made = stage()
        await action(made, await made.open())
        return made

    return virtual.run(main())


def asked(*requests: Request, fault: Fault | None = None, protocol: str = "modbus-rtu") -> Stage:
    """Return the stage after these requests, and one good one behind them that ends the tale."""

    async def ask(made: Stage, exchanger: Exchanger) -> None:
        if fault is not None:
            made.bench.wire.faults.add(fault)
        for request in requests:
            with contextlib.suppress(NoReply, BadReply, Refused):
                await exchanger.exchange(made.codec, request, PROCESSING)

    return play(lambda: Stage(protocol), ask)


@every_protocol
def test_every_byte_on_the_wire_is_told(protocol: str) -> None:
    """In its order, whatever the protocol."""
    made = asked(READ, ReadWords(1, 0xFD01), WriteRam(1, 0xFA01, 1000), ReadWords(1, 0x1234), protocol=protocol)
    assert b"".join(frame.data for frame in made.frames()) == made.on_the_wire()
    assert made.verdicts() == [("->", V.ANSWERED), ("<-", V.ANSWERED)] * 3 + [("->", V.REFUSED), ("<-", V.REFUSED)]


def test_times_are_those_of_the_wire() -> None:
    """The gap is never less than 3.5 characters; an answer takes the drive's time and its own."""
    made = asked(READ, READ, READ)
    timing = made.bench.configured.lines[0].timing
    asked_, answers = made.frames()[::2], made.frames()[1::2]
    for frame in asked_:
        assert frame.gap is not None
        assert frame.gap >= timing.gap
        assert frame.end - frame.begin == pytest.approx(timing.request(8))
    for frame in answers:
        assert frame.after == pytest.approx(timing.gap + 0.005 + timing.answer(7), abs=1e-3)
    assert [frame.gap for frame in asked_[1:]] == pytest.approx([timing.gap] * 2)


@every_protocol
def test_an_echo_is_told_from_an_answer(protocol: str) -> None:
    """Of a read and of a write, which is answered by the same bytes."""
    made = asked(READ, WriteRam(1, 0xFA01, 1000), fault=Fault(Kind.ECHO), protocol=protocol)
    assert made.verdicts() == [("->", V.ANSWERED), ("<-", V.ECHO), ("<-", V.ANSWERED)] * 2


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (Fault(Kind.CUT), [("->", V.NO_REPLY)]),
        (Fault(Kind.TRUNCATE, value=4), [("->", V.BAD_REPLY), ("<-", V.BAD_REPLY)]),
        (Fault(Kind.BABBLE, value=3), [("->", V.ANSWERED), ("<-", V.NOISE), ("<-", V.ANSWERED)]),
    ],
)
def test_what_goes_wrong_is_told(fault: Fault, expected: list[tuple[str, Verdict]]) -> None:
    """Silence, damaged answers, noise."""

    async def ask(made: Stage, exchanger: Exchanger) -> None:
        made.bench.wire.faults.add(fault)
        with contextlib.suppress(NoReply, BadReply):
            await exchanger.exchange(made.codec, READ, PROCESSING)

    made = play(Stage, ask)
    assert made.verdicts() == expected
    assert b"".join(frame.data for frame in made.frames()) == made.on_the_wire()


def test_an_answer_after_all_patience_is_told_before_the_next_request() -> None:
    """It is thrown away, and yet seen."""

    async def ask(made: Stage, exchanger: Exchanger) -> None:
        made.bench.wire.faults.add(Fault(Kind.LATE, value=0.5, count=1))
        with pytest.raises(NoReply):
            await exchanger.exchange(made.codec, READ, PROCESSING)
        await virtual.VirtualClock().alarm().wait_until(virtual.VirtualClock().now() + 1.0)
        await exchanger.exchange(made.codec, READ, PROCESSING)

    made = play(Stage, ask)
    assert made.verdicts() == [("->", V.NO_REPLY), ("<-", V.LATE), ("->", V.ANSWERED), ("<-", V.ANSWERED)]
    assert [frame.end for frame in made.frames()] == sorted(frame.end for frame in made.frames())


def test_a_broadcast_is_told_as_what_nobody_answers() -> None:
    """No answer is no fault there."""
    assert asked(WriteRam(EVERY_DRIVE, 0xFA01, 1000)).verdicts() == [("->", V.NOT_AWAITED)]


def test_a_fault_reset_that_is_not_answered_is_no_silence() -> None:
    """FA00 bit 13 gets no answer (E6581657 7.1)."""
    assert asked(WriteRam(1, 0xFA00, 0x2000, is_answered=False)).verdicts()[0] == ("->", V.NOT_AWAITED)


def test_a_port_that_is_lost_in_the_middle_is_told() -> None:
    """With what was sent."""

    async def ask(made: Stage, exchanger: Exchanger) -> None:
        asyncio.get_running_loop().call_later(0.01, made.bench.unplug)
        with pytest.raises(LineDown):
            await exchanger.exchange(made.codec, READ, PROCESSING)

    assert play(Stage, ask).verdicts() == [("->", V.LINE_DOWN)]


def test_without_a_tap_nothing_else_goes_over_the_wire() -> None:
    """The same requests at the same times, and the same counts."""

    async def times(tap: Any) -> tuple[list[float], int]:
        made = Stage()
        line = made.bench.configured.lines[0]
        clock = virtual.VirtualClock()
        port = await made.bench.open(line, clock)
        exchanger = Exchanger(port, line.timing, line.margin, clock, made.stats, tap=tap)
        done = []
        for kind in (Kind.LATE, Kind.DROP, Kind.BABBLE, Kind.ECHO, Kind.FLIP) * 3:
            made.bench.wire.faults.add(Fault(kind, count=1))
            with contextlib.suppress(GatewayError):
                await exchanger.exchange(made.codec, READ, PROCESSING)
            done.append(clock.now())
        return done, made.stats.exchanges

    told: list[Told] = []
    assert virtual.run(times(None)) == virtual.run(times(told.append))
    assert len(told) >= 15
    assert {frame.way for one in told for frame in frames("a", one, Meaning(), 0.0)} == set(Way)
