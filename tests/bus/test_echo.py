"""The adapter's echo: told from an answer by its bytes, learnt from the first answers, and unlearnt."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.echo import ABSENT_AFTER, Hearing, Listening, LocalEcho

FRAME = bytes.fromhex("01 03 FD 00 00 01 B5 A6")
ANSWER = bytes.fromhex("01 03 02 64 00 92 84")


def never() -> bool:
    """Say that the answer is no copy of the request."""
    return False


def heard_of(
    data: bytes, *, is_expected: bool = True, is_demanded: bool = False, step: int = 1
) -> tuple[Listening, bytes]:
    """Let bytes come in pieces; return the listening, and what it passed on."""
    listening = Listening(FRAME, is_expected=is_expected, is_demanded=is_demanded)
    passed = b"".join(listening.take(data[place : place + step]) for place in range(0, len(data), step))
    return listening, passed


@given(st.binary(max_size=30), st.integers(1, 9))
def test_exactly_the_echo_is_kept_back_however_it_comes(behind: bytes, step: int) -> None:
    """What follows it is passed on whole, even where it looks like an echo too."""
    listening, passed = heard_of(FRAME + behind, step=step)
    assert listening.is_heard
    assert not listening.is_damaged
    assert passed == behind


@given(st.binary(min_size=1, max_size=30), st.integers(1, 9))
def test_what_is_no_echo_is_passed_on_whole(data: bytes, step: int) -> None:
    """Nothing is lost of an answer that comes without one; a beginning of the echo alone is kept."""
    listening, passed = heard_of(data, step=step)
    assert passed == (b"" if FRAME.startswith(data) else data) or data.startswith(FRAME)
    assert listening.is_damaged is not data.startswith(FRAME)


@pytest.mark.hazard("H15")
def test_an_answer_behind_a_damaged_echo_is_not_believed() -> None:
    """Drives have heard something else than what was sent."""
    listening, _ = heard_of(bytes([FRAME[0] ^ 1]) + FRAME[1:])
    assert not listening.may_answer(junk=FRAME)
    assert "the line is disturbed (00 03" in listening.said


@pytest.mark.hazard("H15")
def test_an_answer_without_an_echo_is_believed_only_where_the_echo_was_learnt() -> None:
    """An adapter may have been set otherwise; a configuration that demands the echo is taken at its word."""
    learnt, _ = heard_of(ANSWER)
    demanded, _ = heard_of(ANSWER, is_demanded=True)
    assert learnt.may_answer(junk=b"")
    assert not demanded.may_answer(junk=b"")
    assert 'local_echo = "on"' in demanded.said


def test_an_echo_is_learnt_from_an_answer_behind_it_and_from_silence_behind_it() -> None:
    """Of a request whose answer is no copy of it."""
    answered, _ = heard_of(FRAME + ANSWER, is_expected=False)
    answered.believe(FRAME)
    alone, _ = heard_of(FRAME, is_expected=False)
    for listening in (answered, alone):
        echo = LocalEcho()
        assert echo.learn(listening.heard(never))
        assert echo.is_present


@pytest.mark.hazard("H15")
def test_a_copy_that_may_be_an_answer_tells_nothing() -> None:
    """An acknowledged write, or the echo of an unheard one."""
    for is_answered in (True, False):
        listening, _ = heard_of(FRAME, is_expected=False)
        if is_answered:
            listening.believe(b"")
        assert listening.heard(lambda: True) is Hearing.UNCLEAR


def test_an_answer_that_begins_as_its_request_does_is_no_echo() -> None:
    """In TOSHIBA's binary mode the checksum of a request may be the first byte of a value."""
    listening, _ = heard_of(FRAME + b"\0\0", is_expected=False)
    listening.believe(b"")
    assert listening.heard(never) is Hearing.ANSWER


def test_an_echo_that_stays_away_is_unlearnt_after_some_answers() -> None:
    """One lost echo is no proof."""
    echo = LocalEcho()
    echo.learn(Hearing.ECHO)
    for _ in range(ABSENT_AFTER - 1):
        assert not echo.learn(Hearing.ANSWER)
    assert not echo.learn(Hearing.ECHO)  # and the count begins anew
    for _ in range(ABSENT_AFTER - 1):
        assert not echo.learn(Hearing.ANSWER)
    assert echo.learn(Hearing.ANSWER)
    assert echo.is_present is False


@pytest.mark.parametrize(("mode", "is_present"), [("on", True), ("off", False)])
def test_what_is_configured_is_not_learnt(mode: str, is_present: bool) -> None:
    """Whatever comes."""
    echo = LocalEcho(mode)
    for hearing in list(Hearing) * ABSENT_AFTER:
        assert not echo.learn(hearing)
        assert echo.is_present is is_present
