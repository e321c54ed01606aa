"""What a turn does between reading and writing: answers keep their order, whatever becomes of their client."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest

from gateway.modbus_tcp import turns
from gateway.modbus_tcp.sockets import ClientSocket
from gateway.modbus_tcp.turns import Answering, Turns

pytestmark = pytest.mark.skipif(not turns.HAS_EPOLL, reason="turns are made with epoll")

LIMIT = 10.0  # seconds for anything to happen


class Asked(Answering):
    """A protocol that answers at once, in a way that a test sets."""

    def __init__(self) -> None:
        self.transport: ClientSocket
        self.client: socket.socket
        self.moments: list[float] = []
        self.told: list[str] = []
        self.lost: list[Exception | None] = []
        self.answer: Callable[[bytes], bytes | None] = lambda data: b"<" + data + b">"
        self.on_pause: Callable[[], None] = lambda: None
        self.on_resume: Callable[[], None] = lambda: None

    def answer_now(self, data: bytes, now: float) -> bytes | None:
        """Return the answer."""
        self.moments.append(now)
        return self.answer(data)

    def data_received(self, data: bytes) -> None:
        """Write the answer, as where something waits in front of it."""
        self.told.append("ordinary")
        self.transport.write(self.answer(data) or b"")

    def eof_received(self) -> bool:
        """Take that no more comes."""
        return False

    def pause_writing(self) -> None:
        """Take that enough is written."""
        self.told.append("pause")
        self.on_pause()

    def resume_writing(self) -> None:
        """Take that more may be written."""
        self.told.append("resume")
        self.on_resume()

    def connection_lost(self, exc: Exception | None) -> None:
        """Take that it is over."""
        self.lost.append(exc)

    @property
    def got(self) -> bytes:
        """Return what the client finds now."""
        with contextlib.suppress(BlockingIOError):
            return self.client.recv(1 << 20)
        return b""


class Hall:
    """Clients at the ends of socket pairs, served in turns that a test makes."""

    def __init__(self, now: Callable[[], float], next_alarm: Callable[[], float]) -> None:
        self.turns = Turns(asyncio.get_running_loop(), now, next_alarm)
        asyncio.get_running_loop().remove_reader(self.turns._epoll.fileno())
        self.open: list[Asked] = []

    def enter(self) -> Asked:
        """Let a client come."""
        asked = Asked()
        served, asked.client = socket.socketpair()
        for end in (served, asked.client):
            end.setblocking(False)
        asked.transport = ClientSocket(served, "a client", asked, self.turns)
        self.open.append(asked)
        return asked

    def turn(self, *asking: Asked) -> None:
        """Let clients ask, each of them "?", and make one turn."""
        for each in asking:
            each.client.send(b"?")
        self.turns._turn()


@contextlib.asynccontextmanager
async def hall(
    now: Callable[[], float] = time.monotonic, next_alarm: Callable[[], float] = lambda: float("inf")
) -> AsyncIterator[Hall]:
    """Serve clients; in the end all are gone."""
    made = Hall(now, next_alarm)
    async with asyncio.timeout(LIMIT):
        yield made
        for each in made.open:
            each.transport.abort()
            each.client.close()
        while not all(len(each.lost) == 1 for each in made.open):
            await asyncio.sleep(0)
        made.turns.close()


@pytest.fixture(autouse=True)
def long_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a turn reach all clients, whatever the machine does meanwhile."""
    monkeypatch.setattr(turns, "TURN", LIMIT)
    monkeypatch.setattr(turns, "ALONE", float("inf"))


def between(first: Asked, second: Asked, happens: Callable[[], None]) -> list[Asked]:
    """Let something happen when whichever is asked last is asked; return both in the order of their turn."""
    order: list[Asked] = []

    def ask(which: Asked) -> Callable[[bytes], bytes]:
        def answer(data: bytes) -> bytes:
            order.append(which)
            if len(order) == 2:
                happens()
            return b"<" + data + b">"

        return answer

    first.answer, second.answer = ask(first), ask(second)
    return order


@contextlib.contextmanager
def taking(monkeypatch: pytest.MonkeyPatch, fd: int, size: int) -> Iterator[None]:
    """Let the system take only so many bytes for a descriptor, and then none; without any it says EAGAIN."""
    write, left = os.write, [size]

    def short(to: int, data: bytes) -> int:
        if to != fd:
            return write(to, data)
        if not left[0]:
            raise BlockingIOError
        sent = write(to, data[: left[0]])
        left[0] -= sent
        return sent

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", short)
        yield


async def test_all_are_read_before_the_first_answer_is_written() -> None:
    """Three clients ask: as long as one is asked, none has its answer; behind the turn all have."""
    async with hall() as made:
        clients = [made.enter() for _ in range(3)]
        found: list[bytes] = []

        def answer(_data: bytes) -> bytes:
            found.extend(each.got for each in clients)
            return b"!"

        for each in clients:
            each.answer = answer
        made.turn(*clients)
        assert found == [b""] * 9
        assert [each.got for each in clients] == [b"!"] * 3


async def test_each_client_is_answered_as_of_a_moment_of_its_own() -> None:
    """A turn may take a while: what grows old in it is old for the last client."""
    moments = itertools.count(100.0)
    async with hall(lambda: next(moments)) as made:
        clients = [made.enter() for _ in range(3)]
        made.turn(*clients)
        asked = sorted(moment for each in clients for moment in each.moments)
        assert len(asked) == 3
        assert asked == [100.0, 101.0, 102.0]


async def test_what_is_written_in_the_turn_goes_behind_the_answer_that_is_held() -> None:
    """In one write: nothing overtakes an answer."""
    async with hall() as made:
        one, other = made.enter(), made.enter()
        order = between(one, other, lambda: order[0].transport.write(b"second"))
        made.turn(one, other)
        assert [each.got for each in order] == [b"<?>second", b"<?>"]


async def test_closing_in_the_turn_brings_the_answer_that_is_held() -> None:
    """Closing means behind the answers."""
    async with hall() as made:
        one, other = made.enter(), made.enter()
        order = between(one, other, lambda: order[0].transport.close())
        made.turn(one, other)
        assert [each.got for each in order] == [b"<?>"] * 2
        while not order[0].lost:
            await asyncio.sleep(0)
        assert order[0].client.recv(9) == b""


async def test_abort_in_the_turn_drops_the_answer_that_is_held() -> None:
    """And what came from this client is nobody's any more."""
    async with hall() as made:
        one, other = made.enter(), made.enter()
        order = between(one, other, lambda: order[0].transport.abort())
        made.turn(one, other)
        made.turn()
        assert [each.got for each in order] == [b"", b"<?>"]


async def test_pausing_in_the_turn_keeps_the_answer_and_ends_reading() -> None:
    """What is answered is answered; the next request waits."""
    async with hall() as made:
        one, other = made.enter(), made.enter()
        order = between(one, other, lambda: order[0].transport.pause_reading())
        made.turn(one, other)
        assert order[0].got == b"<?>"
        made.turn(order[0])
        assert order[0].got == b""
        order[0].transport.resume_reading()
        made.turn()
        assert order[0].got == b"<?>"


async def test_who_is_paused_before_its_turn_comes_is_not_read() -> None:
    """Though epoll has named it already."""
    async with hall() as made:
        clients = [made.enter(), made.enter()]
        asked: list[Asked] = []

        def pausing(which: Asked) -> Callable[[bytes], bytes]:
            def answer(_data: bytes) -> bytes:
                asked.append(which)
                for each in clients:
                    each.transport.pause_reading()
                return b"!"

            return answer

        for each in clients:
            each.answer = pausing(each)
        made.turn(*clients)
        assert len(asked) == 1
        assert sorted(each.got for each in clients) == [b"", b"!"]


@pytest.mark.hazard("H25")
async def test_an_answer_does_not_overtake_what_a_client_has_not_read() -> None:
    """It goes the ordinary way, which counts it against the client."""
    async with hall() as made:
        one = made.enter()
        one.transport.write(bytes(1 << 20))
        left = one.transport.get_write_buffer_size()
        assert left > 0
        made.turn(one)
        assert one.transport.get_write_buffer_size() == left + 3
        got = b""
        while one.transport.get_write_buffer_size():
            got += one.got
            made.turn()
        assert got + one.got == bytes(1 << 20) + b"<?>"


async def test_a_client_that_vanishes_in_the_turn_is_lost_and_the_others_are_answered() -> None:
    """Its answer fails: that is told once, and takes nothing from anybody else."""
    async with hall() as made:
        clients = [made.enter() for _ in range(3)]
        order = between(clients[0], clients[1], lambda: order[0].client.close())
        made.turn(*clients)
        while not order[0].lost:
            await asyncio.sleep(0)
        assert isinstance(order[0].lost[0], ConnectionError)
        assert [each.got for each in (order[1], clients[2])] == [b"<?>"] * 2


@pytest.mark.hazard("H25")
@pytest.mark.parametrize("taken", [0, 2])
async def test_what_the_system_does_not_take_of_an_answer_is_sent_later_and_in_order(
    monkeypatch: pytest.MonkeyPatch, taken: int
) -> None:
    """Answers behind it go the ordinary way, and wait for it; then all is as before."""
    async with hall() as made:
        one = made.enter()
        with taking(monkeypatch, one.transport._fd, taken):
            made.turn(one)
            assert one.transport.get_write_buffer_size() == 3 - taken
            one.answer = lambda data: b"[" + data + b"]"
            made.turn(one)
        assert one.told == ["ordinary"]
        assert one.got == b"<?>"[:taken]
        made.turn()
        assert one.transport.get_write_buffer_size() == 0
        assert one.got == b"<?>[?]"[taken:]
        made.turn(one)
        assert one.got == b"[?]"
        assert one.told == ["ordinary"]


@pytest.mark.hazard("H18")
@pytest.mark.parametrize("is_resumed", [False, True])
async def test_a_defect_behind_an_answer_costs_its_client_the_connection_and_nobody_else(
    monkeypatch: pytest.MonkeyPatch, is_resumed: bool
) -> None:
    """The protocol fails where it is told to pause, or to go on: reported, and the other one is answered."""
    reports: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: reports.append(context))
    error = ValueError("a defect")

    def fail() -> None:
        raise error

    async with hall() as made:
        one, other = made.enter(), made.enter()
        one.transport.set_write_buffer_limits(high=0)
        if is_resumed:
            one.on_resume = fail
        else:
            one.on_pause = fail
        with taking(monkeypatch, one.transport._fd, 0):
            made.turn(one, other)
        made.turn(other)
        while not one.lost:
            await asyncio.sleep(0)
        assert [report["exception"] for report in reports] == [error]
        assert other.got == b"<?><?>"
        assert one.got == (b"<?>" if is_resumed else b"")


@pytest.mark.hazard("H25")
async def test_a_turn_behind_something_else_takes_one_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time between two turns tells it, against the shortest one; the machine's pace is learnt anew."""
    monkeypatch.setattr(turns, "ALONE", 2.0)
    moment = [1000.0]

    def now() -> float:
        moment[0] += 0.001
        return moment[0]

    async with hall(now) as made:
        clients = [made.enter() for _ in range(3)]

        def takes_all(pause: float) -> bool:
            """Say whether a turn behind a pause takes all clients; those that are left have one of their own."""
            moment[0] += pause
            before = sum(len(each.moments) for each in clients)
            made.turn(*clients)
            taken = sum(len(each.moments) for each in clients) - before
            assert taken in (1, 3)
            while made.turns._left:
                moment[0] += pause
                made.turns._turn()
            assert [each.got for each in clients] == [b"<?>"] * 3
            return taken == 3

        assert takes_all(4.0)
        pauses = {4.1: True, 7.0: True, 20.0: False, 3.0: True, 7.1: False, 5.0: True}
        assert {pause: takes_all(pause) for pause in pauses} == pauses
        assert not takes_all(9.0)
        for _ in range(40):  # the machine is slower from now on
            takes_all(9.0)
        assert takes_all(9.0)


@pytest.mark.hazard("H25")
@pytest.mark.parametrize(("until_alarm", "taken"), [(0.2, 3), (0.15, 1), (0.0, 1), (-1.0, 1)])
async def test_a_turn_shortly_before_an_alarm_takes_one_client(
    monkeypatch: pytest.MonkeyPatch, until_alarm: float, taken: int
) -> None:
    """A line sends then; an alarm that is late already is waited for too."""
    monkeypatch.setattr(turns, "LASTS", 0.16)
    moment = itertools.count(1000.0, 0.001)
    async with hall(lambda: next(moment), lambda: 1000.0 + until_alarm) as made:
        clients = [made.enter() for _ in range(3)]
        made.turn(*clients)
        assert sum(len(each.moments) for each in clients) == taken


async def test_the_end_behind_a_request_costs_no_answer() -> None:
    """A client that asks and sends no more is answered, and then closed."""
    async with hall() as made:
        one = made.enter()
        one.client.send(b"?")
        one.client.shutdown(socket.SHUT_WR)
        made.turn()
        made.turn()
        while not one.lost:
            await asyncio.sleep(0)
        assert one.got == b"<?>"
        assert one.client.recv(9) == b""


async def test_another_protocol_cannot_take_over_what_is_lost() -> None:
    """It is told nothing of it, and nothing fails."""
    async with hall() as made:
        one = made.enter()
        one.transport.abort()
        one.transport.set_protocol(one)
        assert one.transport.is_closing()
