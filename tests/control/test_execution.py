"""One command, frame by frame: what is sent next, and which one end it comes to."""

from __future__ import annotations

import math
from decimal import Decimal

import pytest

from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.composing import compose
from gateway.control.execution import READING_LATER, SILENT_STOPS, VAIN_STOPS, Execution
from gateway.control.writes import Allowed, plan_write
from gateway.drives.catalogue import load
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import ReadWords, Words, WriteRam, WriteStored, Written
from gateway.protocol.registry import PROTOCOLS

NC3 = load()["vf-nc3"]
MODBUS = PROTOCOLS["modbus-rtu"]
NO = Refused("no", Refusal.RANGE)
BUSY = Refused("busy", Refusal.UNABLE)


class Played:
    """A command under way at time 0, with a deadline of 1 s."""

    def __init__(self, verb: Verb, value: str | None = None, name: str = "", *, is_stop: bool = False) -> None:
        number = None if value is None else Decimal(value)
        command = Command("d1", verb, Source(Channel.MQTT), 0.0, 1.0, value=number, name=name)
        steps = compose(command, NC3, {"command": 0})
        allowed = Allowed(stored=True)
        writes = [plan_write(NC3, MODBUS, 1, step.register, step.word, allowed) for step in steps]
        self.results: list[Result] = []
        self.execution = Execution(command, writes, self.results.append, is_stop=is_stop)

    def sent(self, now: float = 0.0) -> object:
        """Send the next frame."""
        request = self.execution.next(now)
        self.execution.sending()
        return request

    @property
    def end(self) -> tuple[Status, Reason]:
        """Return the one result."""
        (result,) = self.results
        return result.status, result.reason


def test_every_write_is_read_back_before_the_next_one() -> None:
    """Frequency, its read-back, run, its read-back, done."""
    played = Played(Verb.RUN, "30")
    assert played.sent() == WriteRam(1, 0xFA01, 3000)
    played.execution.on_reply(Written())
    assert played.sent() == ReadWords(1, 0xFA01)
    assert not played.results
    played.execution.on_reply(Words((3000,)))
    assert played.sent() == WriteRam(1, 0xFA00, 0xC400)
    played.execution.on_reply(Written())
    assert played.sent() == ReadWords(1, 0xFA00)
    played.execution.on_reply(Words((0xC400,)))
    assert played.end == (Status.DONE, Reason.NONE)
    assert played.results[0].read_back == {"frequency_command": 3000, "command": 0xC400}


def test_a_refusal_ends_it_in_the_drives_words() -> None:
    """What comes behind is not written."""
    played = Played(Verb.RUN, "30")
    played.sent()
    played.execution.on_refused(NO)
    assert played.end == (Status.FAILED, Reason.REFUSED_BY_DRIVE)
    assert played.results[0].text == "frequency_command: data range error"
    assert played.sent() is None


@pytest.mark.hazard("H15")
def test_an_echoed_write_that_does_not_read_back_is_no_success() -> None:
    """The acknowledgement of 06H is a copy of the request."""
    played = Played(Verb.FREQUENCY, "30")
    played.sent()
    played.execution.on_reply(Written())
    played.sent()
    played.execution.on_reply(Words((0,)))
    assert played.end == (Status.FAILED, Reason.NOT_READ_BACK)


@pytest.mark.hazard("H11")
def test_a_write_without_an_answer_is_read_back_and_never_repeated() -> None:
    """It was done, was not, or nobody can say."""
    for answer, end in ((3000, Status.DONE), (0, Status.FAILED), (None, Status.UNKNOWN)):
        played = Played(Verb.FREQUENCY, "30")
        played.sent()
        played.execution.on_silence("no answer")
        while (request := played.sent()) is not None:
            assert request == ReadWords(1, 0xFA01)
            if answer is None:
                played.execution.on_silence("no answer")
            else:
                played.execution.on_reply(Words((answer,)))
        assert played.end[0] is end


@pytest.mark.hazard("H11")
def test_nothing_is_written_after_the_deadline() -> None:
    """Neither the first word nor the second; what was sent is still read back for a while."""
    played = Played(Verb.FREQUENCY, "30")
    assert played.sent(1.01) is None
    assert played.end == (Status.REFUSED, Reason.EXPIRED)
    played = Played(Verb.RUN, "30")
    played.sent()
    played.execution.on_reply(Written())
    assert played.sent(1.01) == ReadWords(1, 0xFA01)
    played.execution.on_reply(Words((3000,)))
    assert played.sent(1.02) is None
    assert played.end == (Status.FAILED, Reason.EXPIRED)
    assert played.results[0].text == "too late for command; written: frequency_command"
    played = Played(Verb.FREQUENCY, "30")
    played.sent()
    played.execution.on_reply(Written())
    assert played.sent(1.01 + READING_LATER) is None
    assert played.end == (Status.UNKNOWN, Reason.EXPIRED)


@pytest.mark.hazard("H11")
def test_a_frame_that_did_not_leave_in_time_was_not_sent() -> None:
    """The first one is refused; behind one that was written the command has failed."""
    played = Played(Verb.FREQUENCY, "30")
    assert played.sent(0.99) == WriteRam(1, 0xFA01, 3000)
    assert played.execution.not_after == 1.0
    played.execution.undone(1.01)
    assert played.end == (Status.REFUSED, Reason.EXPIRED)
    played = Played(Verb.RUN, "30")
    for answer in (Written(), Words((3000,))):
        played.sent()
        played.execution.on_reply(answer)
    assert played.sent(0.99) == WriteRam(1, 0xFA00, 0xC400)
    played.execution.undone(1.01)
    assert played.end == (Status.FAILED, Reason.EXPIRED)


@pytest.mark.hazard("H11")
def test_only_writing_has_an_end() -> None:
    """What was written is read back later as well, and a stop is written for as long as it takes."""
    played = Played(Verb.FREQUENCY, "30")
    played.sent()
    played.execution.on_reply(Written())
    assert played.execution.not_after == math.inf
    assert Played(Verb.STOP, is_stop=True).execution.not_after == math.inf


@pytest.mark.hazard("H05", "H11")
def test_a_stop_without_an_answer_is_written_again_and_never_read() -> None:
    """However late; a read would start the drive's F803 anew."""
    played = Played(Verb.STOP, is_stop=True)
    for _ in range(SILENT_STOPS):
        assert played.sent(50.0) == WriteRam(1, 0xFA00, 0x8000)
        played.execution.on_silence("no answer")
    assert played.end == (Status.UNKNOWN, Reason.NO_ANSWER)


def test_a_stop_that_does_not_read_back_is_written_again_but_not_for_ever() -> None:
    """Nor one that the drive refuses for now."""
    played = Played(Verb.STOP, is_stop=True)
    for turn in range(VAIN_STOPS):
        assert isinstance(played.sent(), WriteRam)
        if turn % 2:
            played.execution.on_refused(BUSY)
        else:
            played.execution.on_reply(Written())
            played.sent()
            played.execution.on_reply(Words((0x8400,)))
    assert played.end[0] is Status.FAILED


def test_a_tripped_drive_has_obeyed_an_emergency_stop() -> None:
    """Whatever FA00 reads then."""
    played = Played(Verb.EMERGENCY_STOP, is_stop=True)
    played.execution.on_tripped()
    assert not played.results
    played.sent()
    played.execution.on_tripped()
    assert played.end == (Status.DONE, Reason.NONE)


@pytest.mark.hazard("H08")
def test_a_stored_parameter_is_compared_and_counted_before_it_is_written() -> None:
    """An equal value is not written; one that cannot be counted is refused."""
    for found, problem, end in ((75, "", Status.DONE), (100, "", None), (100, "disk full", Status.REFUSED)):
        played = Played(Verb.SET, "7.5", "acceleration_time_1")
        request = played.sent()
        assert isinstance(request, ReadWords)
        played.execution.on_reply(Words((found,)))
        if end is not Status.DONE:
            assert played.sent() is None
            assert played.execution.is_to_be_counted
            played.execution.reserved(problem)
        if end is None:
            assert isinstance(played.sent(), WriteStored)
        else:
            assert played.end[0] is end
            assert not played.execution.was_sent


def test_what_is_over_stays_over() -> None:
    """Late answers, silence and refusals change nothing, and there is one result."""
    played = Played(Verb.FREQUENCY, "30")
    played.execution.finish(Status.REFUSED, Reason.STOPPED)
    played.execution.on_reply(Written())
    played.execution.on_silence("no answer")
    played.execution.on_refused(NO)
    played.execution.finish(Status.DONE)
    assert played.end == (Status.REFUSED, Reason.STOPPED)
    assert played.sent() is None


def test_a_stop_that_was_never_sent_has_written_nothing() -> None:
    """The audit says "wrote" of words that were on the line, or announced to the whole line."""
    played = Played(Verb.STOP, is_stop=True)
    played.execution.finish(Status.REFUSED, Reason.OFFLINE, "gone")
    assert played.results[0].raw == {}
    played = Played(Verb.STOP, is_stop=True)
    played.execution.announced()
    played.execution.finish(Status.UNKNOWN, Reason.OFFLINE, "gone")
    assert played.results[0].raw == {"command": 0x8000}
    played = Played(Verb.STOP, is_stop=True)
    played.sent()
    played.execution.finish(Status.UNKNOWN, Reason.OFFLINE, "gone")
    assert played.results[0].raw == {"command": 0x8000}


@pytest.mark.hazard("H22")
def test_what_stood_beside_a_stop_is_told_when_the_stop_is_done() -> None:
    """As a failure where it was wrong, but not to who shares the stop; a stop that is not done has its own end."""
    for reason, end in ((Reason.RANGE, Status.FAILED), (Reason.NONE, Status.DONE)):
        played = Played(Verb.STOP, is_stop=True)
        played.execution.beside = (reason, "not written")
        joined: list[Result] = []
        other = Command("d1", Verb.STOP, Source(Channel.MODBUS_TCP), 0.0, 1.0)
        played.execution.joined.append((other, joined.append))
        played.sent()
        played.execution.on_reply(Written())
        played.sent()
        played.execution.on_reply(Words((0x8000,)))
        assert played.end == (end, reason)
        assert played.results[0].text == "not written"
        assert [(result.status, result.text) for result in joined] == [(Status.DONE, "")]
        assert played.execution.has_stopped
    played = Played(Verb.STOP, is_stop=True)
    played.execution.beside = (Reason.RANGE, "not written")
    played.execution.finish(Status.UNKNOWN, Reason.NO_ANSWER, "silence")
    assert played.end == (Status.UNKNOWN, Reason.NO_ANSWER)
