from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.sim.modbus import is_whole
from gateway.sim.settings import SimulatedLineConfig, build
from gateway.sim.wire import Wire
from tests.sim.rig import framed

BAUD = 19200
OUT, IN = 11 / BAUD, 12 / BAUD  # seconds a character
GAP = 3.5 * OUT
PROCESSING = 0.005
READ = framed("03 FD00 0001")  # 8 characters; the answer has 7
ANSWER = framed("03 02 0000")
EXCHANGE = 8 * OUT + GAP + PROCESSING + 7 * IN


def line(*drives: dict[str, Any], **settings_: Any) -> Wire:
    """Build a wire of VF-nC3s, one numbered 1 if nothing is said."""
    described = [{"model": "vf-nc3", "stable_bits": True, **drive} for drive in drives or ({"number": 1},)]
    return build(SimulatedLineConfig.model_validate({"drive": described, **settings_}))


def heard(wire: Wire, until: float = 10.0) -> Iterator[tuple[float, bytes]]:
    """Run the wire by its own events; yield what the master hears and when."""
    while (event := wire.next_event()) is not None and event <= until:
        for data in wire.due(event):
            yield event, data


class TestTiming:
    def test_an_answer_comes_when_its_last_character_has_ended(self) -> None:
        """8 characters of 11 bits, 3.5 of silence, 5 ms, 7 characters of 12 bits: 16.0 ms at 19200 baud."""
        wire = line()
        wire.feed(READ, 1.0)
        ((when, data),) = heard(wire)
        assert data == ANSWER
        assert when == pytest.approx(1.0 + EXCHANGE)
        assert pytest.approx(0.01596, abs=1e-5) == EXCHANGE

    def test_what_was_not_fetched_in_time_is_still_there(self) -> None:
        """A loop that is late, and is told of the next request first, loses nothing."""
        wire = line()
        wire.feed(READ, 0.0)
        wire.feed(READ, 1.0)
        assert wire.next_event() == pytest.approx(EXCHANGE)
        assert wire.due(1.0) == [ANSWER]

    def test_nothing_comes_before_its_time(self) -> None:
        """A microsecond before the end the master has heard nothing."""
        wire = line()
        wire.feed(READ, 1.0)
        assert wire.due(1.0 + EXCHANGE - 2e-6) == []
        assert wire.due(1.0 + EXCHANGE) == [ANSWER]

    def test_characters_come_one_by_one_where_that_is_wanted(self) -> None:
        """Each at its own end, 12 bits apart."""
        wire = line(delivery="character")
        wire.feed(READ, 0.0)
        pieces = list(heard(wire))
        assert b"".join(data for _, data in pieces) == ANSWER
        first = 8 * OUT + GAP + PROCESSING
        assert [when for when, _ in pieces] == pytest.approx([first + (place + 1) * IN for place in range(7)])

    @pytest.mark.parametrize("baud", [9600, 19200, 38400])
    def test_times_follow_the_baud_rate(self, baud: int) -> None:
        """All but the drive's own time goes by the bit."""
        wire = line(baud=baud)
        wire.feed(READ, 0.0)
        ((when, _),) = heard(wire)
        assert when - PROCESSING == pytest.approx((EXCHANGE - PROCESSING) * BAUD / baud)

    def test_bytes_written_at_once_leave_one_after_another(self) -> None:
        """A frame in pieces, all written within the first piece's time, is one frame."""
        wire = line()
        wire.feed(READ[:3], 0.0)
        wire.feed(READ[3:5], 0.0001)
        wire.feed(READ[5:], 0.0002)
        ((when, data),) = heard(wire)
        assert when == pytest.approx(EXCHANGE)
        assert data == ANSWER

    def test_busy_time_adds_up_what_no_master_can_save(self) -> None:
        """Each exchange counts its characters, both gaps and the drive's time."""
        wire = line()
        for begin in (0.0, 1.0, 2.0):
            wire.feed(READ, begin)
            list(heard(wire))
        assert wire.statistics.answers == 3
        assert wire.statistics.busy == pytest.approx(3 * (EXCHANGE + GAP))
        assert wire.statistics.drives[1].longest_interval == pytest.approx(1.0)

    def test_processing_and_wait_time_are_kept(self) -> None:
        """A drive of its own processing time, and F805 on another."""
        slow = {"number": 1, "processing_time": "15ms"}
        patient = {"number": 2, "registers": {"communication_wait_time": 3}}
        wire = line(slow, patient)
        wire.feed(READ, 0.0)
        ((first, _),) = heard(wire)
        wire.feed(framed("03 FD00 0001", 2), 1.0)
        ((second, _),) = heard(wire)
        assert first == pytest.approx(EXCHANGE + 0.010)
        assert second == pytest.approx(1.0 + EXCHANGE + 0.025)


class TestGap:
    def test_a_request_right_after_the_gap_is_heard(self) -> None:
        """3.5 characters after the answer's end is soon enough."""
        wire = line()
        wire.feed(READ, 0.0)
        ((end, _),) = heard(wire)
        wire.feed(READ, end + GAP)
        assert len(list(heard(wire))) == 1
        assert wire.statistics.gap_violations == 0

    @pytest.mark.parametrize("pause", [0.0, 1.0 * OUT, 2.0 * OUT, 3.4 * OUT])
    def test_a_request_too_soon_after_an_answer_is_lost_and_counted(self, pause: float) -> None:
        """The drive takes answer and request for one frame."""
        wire = line()
        wire.feed(READ, 0.0)
        ((end, _),) = heard(wire)
        wire.feed(READ, end + pause)
        assert list(heard(wire)) == []
        assert (wire.statistics.gap_violations, wire.statistics.lost) == (1, 1)

    @pytest.mark.parametrize("pause", [0.0, 1.0 * OUT, 2.0 * OUT, 3.4 * OUT])
    def test_two_requests_without_a_gap_are_both_lost(self, pause: float) -> None:
        """Broadcasts are not answered, but the silence behind them is owed."""
        wire = line()
        command = framed("06 FA01 0064", 0)
        wire.feed(command, 0.0)
        wire.feed(command, 8 * OUT + pause)
        assert list(heard(wire)) == []
        assert (wire.statistics.gap_violations, wire.statistics.lost) == (1, 1)
        wire.feed(framed("03 FA01 0001"), 1.0)
        assert [data for _, data in heard(wire)] == [ANSWER]

    def test_the_next_frame_after_a_violation_is_heard(self) -> None:
        """Silence puts everything right."""
        wire = line()
        wire.feed(READ + READ[:4], 0.0)
        assert list(heard(wire)) == []
        wire.feed(READ, 1.0)
        assert len(list(heard(wire))) == 1

    def test_a_pause_of_more_than_a_character_and_a_half_breaks_a_frame(self) -> None:
        """1.4 characters are borne, 1.6 are not."""
        for pause, answers in ((1.4, 1), (1.6, 0)):
            wire = line()
            wire.feed(READ[:5], 0.0)
            wire.feed(READ[5:], (5 + pause) * OUT)
            assert len(list(heard(wire))) == answers
            assert wire.statistics.splits == 1 - answers

    def test_a_frame_in_two_with_a_long_pause_is_two_broken_frames(self) -> None:
        """Each half has a wrong check."""
        wire = line()
        wire.feed(READ[:5], 0.0)
        list(heard(wire))
        wire.feed(READ[5:], 1.0)
        assert list(heard(wire)) == []
        assert (wire.statistics.requests, wire.statistics.broken) == (2, 2)

    @given(st.integers(1, 7), st.floats(0.0, 10.0))
    @settings(max_examples=200)
    def test_a_frame_split_anywhere_is_answered_once_or_not_at_all(self, place: int, pause: float) -> None:
        """By 1.5 characters and less it is one frame; by more it is none."""
        wire = line()
        wire.feed(READ[:place], 0.0)
        early = list(heard(wire, (place + pause) * OUT))
        wire.feed(READ[place:], (place + pause) * OUT)
        answers = [data for _, data in early + list(heard(wire))]
        assert answers == ([ANSWER] if pause <= 1.5 else [])


class TestCollisions:
    def test_a_request_during_an_answer_spoils_both(self) -> None:
        """The answer is garbled where the master talks, and the request is not heard."""
        wire = line()
        wire.feed(READ, 0.0)
        wire.feed(READ, EXCHANGE - 3 * IN)
        answers = [data for _, data in heard(wire)]
        assert len(answers) == 1
        assert answers[0][:4] == ANSWER[:4]
        assert answers[0] != ANSWER
        assert wire.statistics.collisions == 1

    def test_a_busy_drive_does_not_hear_a_second_request(self) -> None:
        """While it analyses frame A it cannot receive frame B; the other drive can."""
        wire = line({"number": 1, "processing_time": "100ms"}, {"number": 2})
        wire.feed(READ, 0.0)
        begin = 8 * OUT + GAP + 0.001
        list(heard(wire, begin))
        wire.feed(READ, begin)
        list(heard(wire, begin + 0.02))
        wire.feed(framed("03 FD00 0001", 2), begin + 0.02)
        numbers = [data[0] for _, data in heard(wire)]
        assert numbers == [2, 1]

    def test_two_drives_with_one_number_answer_on_top_of_each_other(self) -> None:
        """What arrives is no frame."""
        wire = line({"number": 1}, {"number": 1})
        wire.feed(READ, 0.0)
        answers = [data for _, data in heard(wire)]
        assert len(answers) == 1
        assert len(answers[0]) == 7
        assert not is_whole(answers[0])

    def test_answers_that_overlap_in_part_are_garbled_in_part(self) -> None:
        """The first drive begins 2 ms before the second of the same number, and is heard alone until then."""
        wire = line({"number": 1}, {"number": 1, "processing_time": "7ms"})
        wire.feed(READ, 0.0)
        data = b"".join(data for _, data in heard(wire))
        assert data[:3] == ANSWER[:3]
        assert data[3:7] != ANSWER[3:7]
        assert data[-3:] == ANSWER[-3:]
        assert not is_whole(data)

    def test_a_pulled_adapter_leaves_a_quiet_line(self) -> None:
        """What was under way is gone."""
        wire = line()
        wire.feed(READ, 0.0)
        wire.clear()
        assert wire.next_event() is None


class TestWhoHears:
    def test_every_drive_answers_to_its_own_number(self) -> None:
        """Three drives on one line, each asked in turn."""
        wire = line(*({"number": number} for number in (1, 2, 30)))
        answers: list[bytes] = []
        for place, number in enumerate((30, 1, 2)):
            wire.feed(framed("03 FB07 0001", number), float(place))
            answers += [data for _, data in heard(wire)]
        assert [answer[0] for answer in answers] == [30, 1, 2]

    def test_a_drive_at_another_baud_rate_hears_nothing(self) -> None:
        """F800 = 5 is 38400 baud, on a line of 19200."""
        wire = line({"number": 1, "registers": {"baud_rate": 5}}, {"number": 2})
        wire.feed(READ, 0.0)
        wire.feed(framed("03 FD00 0001", 2), 1.0)
        assert [data[0] for _, data in heard(wire)] == [2]
        assert wire.statistics.unanswered == 1

    @given(st.binary(min_size=1, max_size=60), st.floats(0.0, 0.02))
    @settings(max_examples=300)
    def test_no_bytes_break_the_line(self, junk: bytes, pause: float) -> None:
        """After any junk and enough silence the line works as before."""
        wire = line()
        wire.feed(junk, 0.0)
        list(heard(wire, pause))
        wire.feed(junk, pause)
        list(heard(wire))
        wire.feed(READ, 5.0)
        assert [data for when, data in heard(wire) if when > 5.0] == [ANSWER]
