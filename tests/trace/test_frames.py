"""An exchange is taken apart into its frames: every byte in one of them, each with what it was."""

from __future__ import annotations

import json

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from gateway.protocol.pdu import ReadWords, WriteRam, Written
from gateway.protocol.registry import PROTOCOLS
from gateway.trace.frames import MOST_STRAY, Cut, Frame, Way, cut, frames
from gateway.trace.meaning import Meaning
from gateway.trace.record import LONGEST, Hearing, Told, Unasked, Verdict
from tests.trace.plays import ANSWER, ASKED, GIVEN, MODBUS, READ, answered, record

OFFSET = 1_772_357_390.0  # of the wall clock
NOISE = bytes.fromhex("FF 00 7F")
REFUSAL = bytes.fromhex("01 83 02 C0 F1")
V = Verdict


def taken_apart(told: Told) -> list[Frame]:
    """Return the frames."""
    return list(frames("a", told, Meaning(), OFFSET))


def heard(told: Told) -> list[tuple[bytes, Verdict]]:
    """Return what came, and what it was."""
    return [(frame.data, frame.verdict) for frame in taken_apart(told) if frame.way is Way.ANSWER]


def test_a_good_exchange_is_a_request_and_an_answer_with_their_times() -> None:
    """Gap before the request; the answer's time from the end of the request; both on the wall clock."""
    request, answer = taken_apart(answered())
    assert (request.way, request.data, request.verdict) == (Way.REQUEST, READ, V.ANSWERED)
    assert (request.begin, request.end, request.gap) == (OFFSET + 10.0, OFFSET + 10.005, 0.0025)
    assert (answer.way, answer.data, answer.verdict) == (Way.ANSWER, ANSWER, V.ANSWERED)
    assert answer.protocol == "modbus-rtu"
    assert answer.after == pytest.approx(0.015)
    assert (answer.end, answer.gap) == (OFFSET + 10.02, None)


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        (record((10.01, ANSWER[:3]), (10.02, ANSWER[3:]), reply=GIVEN), [(ANSWER, V.ANSWERED)]),
        (record((10.005, READ + ANSWER), reply=GIVEN), [(READ, V.ECHO), (ANSWER, V.ANSWERED)]),
        (record((10.02, NOISE + ANSWER), reply=GIVEN), [(NOISE, V.NOISE), (ANSWER, V.ANSWERED)]),
        (record((10.02, ANSWER + NOISE), reply=GIVEN), [(ANSWER, V.ANSWERED), (NOISE, V.NOISE)]),
        (record((10.001, READ), (10.02, ANSWER), reply=GIVEN, early=1), [(READ, V.ECHO), (ANSWER, V.ANSWERED)]),
        (record((10.001, ANSWER), (10.02, ANSWER), reply=GIVEN, early=1), [(ANSWER, V.EARLY), (ANSWER, V.ANSWERED)]),
        (record((10.02, REFUSAL), verdict=V.REFUSED, note="no"), [(REFUSAL, V.REFUSED)]),
        (record(verdict=V.NO_REPLY), []),
        (record((10.005, READ), verdict=V.NO_REPLY, ended=1), [(READ, V.ECHO)]),
        (record((10.3, ANSWER), verdict=V.NO_REPLY, ended=0), [(ANSWER, V.LATE)]),
        (record((10.3, NOISE), verdict=V.NO_REPLY, ended=0), [(NOISE, V.NOISE)]),
        (
            record((10.01, ANSWER[:4]), (10.3, NOISE), verdict=V.BAD_REPLY, ended=1),
            [(ANSWER[:4], V.BAD_REPLY), (NOISE, V.NOISE)],
        ),
        (record((10.01, ANSWER[:4]), verdict=V.LINE_DOWN), [(ANSWER[:4], V.NOISE)]),
        (Unasked(10.0, ANSWER, (MODBUS, ASKED)), [(ANSWER, V.LATE)]),
        (Unasked(10.0, NOISE, (MODBUS, ASKED)), [(NOISE, V.NOISE)]),
        (Unasked(10.0, ANSWER), [(ANSWER, V.NOISE)]),
    ],
)  # fmt: skip
def test_what_comes_is_told_apart(told: Told, expected: list[tuple[bytes, Verdict]]) -> None:
    """Answers in pieces, echoes, noise in front and behind, early and late ones, and what is no answer."""
    assert heard(told) == expected


def test_the_answer_of_a_write_is_no_echo_though_it_is_the_same_bytes() -> None:
    """06H is answered by a copy of the request; behind an echo there are two of them."""
    write = WriteRam(1, 0xFA01, 1000)
    frame = MODBUS.encode(write)
    told = record((10.02, frame), request=write, reply=Written())
    assert heard(told) == [(frame, V.ANSWERED)]
    told = record((10.001, frame), (10.02, frame), request=write, reply=Written(), early=1)
    assert heard(told) == [(frame, V.ECHO), (frame, V.ANSWERED)]


@pytest.mark.parametrize("name", sorted(PROTOCOLS))
def test_the_reason_of_a_refusal_stands_with_both_frames(name: str) -> None:
    """And what is damaged or noise is marked as no frame, in every protocol."""
    codec = PROTOCOLS[name]
    assert cut(codec, ReadWords(1, 0xFD00), codec.encode(ReadWords(1, 0xFD00))) is None
    request, answer = taken_apart(record((10.02, REFUSAL), verdict=V.REFUSED, note="error 02"))
    assert (request.note, answer.note) == ("error 02", "error 02")
    assert answer.is_well_formed
    (_, bad) = taken_apart(record((10.02, ANSWER[:4]), verdict=V.BAD_REPLY))
    assert not bad.is_well_formed


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        (record((10.001, READ + ANSWER), early=1), [(READ, V.ECHO), (ANSWER, V.EARLY)]),
        (record((10.001, READ), (10.002, ANSWER), early=2), [(READ, V.ECHO), (ANSWER, V.EARLY)]),
        (record((10.001, ANSWER + NOISE), early=1), [(ANSWER, V.EARLY), (NOISE, V.NOISE)]),
        (
            record((10.001, NOISE + READ + ANSWER), early=1),
            [(NOISE, V.NOISE), (READ, V.ECHO), (ANSWER, V.EARLY)],
        ),
        (record((10.001, REFUSAL + ANSWER), early=1), [(REFUSAL, V.EARLY), (ANSWER, V.EARLY)]),
        (record((10.001, NOISE), early=1), [(NOISE, V.NOISE)]),
        (record((10.3, ANSWER + NOISE), ended=0), [(ANSWER, V.LATE), (NOISE, V.NOISE)]),
        (record((10.3, NOISE + ANSWER), ended=0), [(NOISE, V.NOISE), (ANSWER, V.LATE)]),
        (record((10.3, ANSWER), (10.4, ANSWER), ended=0), [(ANSWER, V.LATE), (ANSWER, V.LATE)]),
        (record((10.3, READ + ANSWER), ended=0), [(READ, V.ECHO), (ANSWER, V.LATE)]),
        (
            Unasked(10.0, NOISE + ANSWER + ANSWER, (MODBUS, ASKED)),
            [(NOISE, V.NOISE), (ANSWER, V.LATE), (ANSWER, V.LATE)],
        ),
        (
            Unasked(10.0, ANSWER * 6, (MODBUS, ASKED)),
            [*[(ANSWER, V.LATE)] * MOST_STRAY, (ANSWER * (6 - MOST_STRAY), V.NOISE)],
        ),
    ],
)  # fmt: skip
def test_what_nobody_waited_for_is_well_formed_only_by_itself(
    told: Told, expected: list[tuple[bytes, Verdict]]
) -> None:
    """Echoes, early and late answers, each is a frame of its own; junk with them is none of them."""
    assert heard(told) == expected
    for frame in taken_apart(told):
        assert frame.is_well_formed == (frame.data in (READ, ANSWER, REFUSAL))


def test_an_early_answer_of_a_write_is_told_from_the_echo_before_it() -> None:
    """Though both are the same bytes; each has the time of its own pieces."""
    write = WriteRam(1, 0xFA01, 1000)
    frame = MODBUS.encode(write)
    told = record((10.001, frame[:2]), (10.002, frame[2:]), (10.003, frame), request=write, early=3)
    assert heard(told) == [(frame, V.ECHO), (frame, V.EARLY)]
    assert [(f.begin, f.end) for f in taken_apart(told)[1:]] == [
        (OFFSET + 10.001, OFFSET + 10.002),
        (OFFSET + 10.003, OFFSET + 10.003),
    ]


PIECES = st.lists(st.binary(max_size=40), max_size=6)


@given(PIECES, st.integers(0, 6), st.integers(0, 6), st.sampled_from(list(Verdict)))
def test_every_byte_is_in_one_frame(pieces: list[bytes], early: int, ended: int, verdict: Verdict) -> None:
    """Whatever came and however it was judged: nothing is left out, nothing told twice, nothing fails."""
    early, ended = sorted((min(early, len(pieces)), min(ended, len(pieces))))
    told = record(*((10.0 + i, data) for i, data in enumerate(pieces)), verdict=verdict, early=early, ended=ended)
    assert b"".join(data for data, _ in heard(told)) == b"".join(pieces)


@given(st.integers(0, 3), st.binary(max_size=600), st.binary(max_size=30))
@example(0, b"", ANSWER[:1])
@example(0, ANSWER[-1:], b"")
def test_an_answer_between_anything_is_found_or_nothing_is(echoes: int, front: bytes, behind: bytes) -> None:
    """Where one is found it is whole, and what is around it is around it."""
    data = READ * echoes + front + ANSWER + behind
    found = cut(MODBUS, ASKED, data)
    if found is not None:
        assert found.front + found.answer + found.behind == data
        assert cut(MODBUS, ASKED, found.answer) == Cut(b"", found.answer, b"")


@given(st.lists(st.binary(max_size=3000), max_size=5))
def test_what_is_heard_is_bounded(pieces: list[bytes]) -> None:
    """A babbling line fills no memory."""
    heard = Hearing()
    for data in pieces:
        heard.take(0.0, data)
    assert b"".join(data for _, data in heard.pieces) == b"".join(pieces)[:LONGEST]


@pytest.mark.parametrize("told", [answered(), record(verdict=V.NO_REPLY, note="no answer"), Unasked(1.0, b"\xff")])
def test_a_frame_goes_through_json_and_back(told: Told) -> None:
    """As it does from the gateway to the command."""
    for frame in taken_apart(told):
        assert Frame.of_table(json.loads(json.dumps(frame.as_table()))) == frame


@given(st.dictionaries(st.text(max_size=10), st.integers() | st.text(max_size=5)))
def test_what_is_no_frame_is_refused(table: dict[str, int | str]) -> None:
    """By an error of those that are told."""
    with pytest.raises((ValueError, KeyError, TypeError)):
        Frame.of_table(table)
