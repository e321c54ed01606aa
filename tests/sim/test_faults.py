from __future__ import annotations

from typing import Any

import pytest

from gateway.sim.fault_section import whose
from gateway.sim.faults import Fault, Kind
from gateway.sim.modbus import is_whole
from gateway.sim.wire import Wire
from tests.sim.rig import framed
from tests.sim.test_wire import ANSWER, EXCHANGE, IN, OUT, READ, heard, line


def faulty(*faults: dict[str, Any], **settings: Any) -> Wire:
    """Build a line with two drives and faults of the first one."""
    return line({"number": 1, "fault": list(faults)}, {"number": 2}, **settings)


def asked(wire: Wire, begin: float = 0.0, number: int = 1) -> list[tuple[float, bytes]]:
    """Ask a drive, and return what is heard before a second is over."""
    wire.feed(framed("03 FD00 0001", number), begin)
    return [(when - begin, data) for when, data in heard(wire, begin + 1.0)]


class TestKinds:
    def test_a_dropped_answer_was_given_all_the_same(self) -> None:
        """The write is done, the master hears nothing."""
        wire = faulty({"kind": "drop"})
        wire.feed(framed("06 FA01 0064"), 0.0)
        assert list(heard(wire)) == []
        assert wire.drives[0].registers.read(0xFA01) == 100

    def test_a_cut_drive_hears_nothing(self) -> None:
        """The write is not done either."""
        wire = faulty({"kind": "cut"})
        wire.feed(framed("06 FA01 0064"), 0.0)
        assert list(heard(wire)) == []
        assert wire.drives[0].registers.read(0xFA01) == 0

    @pytest.mark.hazard("H16")
    def test_a_late_answer_comes_late(self) -> None:
        """By as much as it was told."""
        ((when, data),) = asked(faulty({"kind": "late", "value": 0.3}))
        assert when == pytest.approx(EXCHANGE + 0.3)
        assert data == ANSWER

    def test_a_duplicate_follows_its_answer(self) -> None:
        """The same bytes again, five milliseconds after the end."""
        (first, one), (second, two) = asked(faulty({"kind": "duplicate"}))
        assert one == two == ANSWER
        assert second - first == pytest.approx(0.005 + 7 * IN)

    @pytest.mark.parametrize("size", range(7))
    def test_an_answer_can_end_at_any_byte(self, size: int) -> None:
        """Truncation leaves the beginning, down to nothing."""
        data = b"".join(data for _, data in asked(faulty({"kind": "truncate", "value": size})))
        assert data == ANSWER[:size]

    @pytest.mark.hazard("H17")
    @pytest.mark.parametrize("bits", [1, 2, 5])
    def test_as_many_bits_flip_as_were_told(self, bits: int) -> None:
        """The answer keeps its length and loses its check."""
        ((_, data),) = asked(faulty({"kind": "flip", "value": bits}))
        difference = int.from_bytes(data, "big") ^ int.from_bytes(ANSWER, "big")
        assert difference.bit_count() == bits
        assert not is_whole(data)

    @pytest.mark.hazard("H15")
    def test_an_echo_hands_the_request_back(self) -> None:
        """The adapter's own bytes come at the end of the request, then the drive's."""
        wire = line(fault=[{"kind": "echo"}])
        (first, echo), (second, data) = asked(wire)
        assert (echo, data) == (READ, ANSWER)
        assert (first, second) == pytest.approx((8 * OUT, EXCHANGE))

    def test_babble_stands_before_the_answer(self) -> None:
        """Noise that the master must get past."""
        ((when, data),) = asked(faulty({"kind": "babble", "value": 4}))
        assert len(data) == 11
        assert data[4:] == ANSWER
        assert when == pytest.approx(EXCHANGE + 4 * IN)

    def test_babble_out_of_nowhere_is_heard_and_in_the_way(self) -> None:
        """Noise on a quiet line reaches the master, and a request under it is lost."""
        wire = line()
        wire.babble(5, 0.0)
        wire.feed(READ, 2 * IN)
        pieces = list(heard(wire))
        assert [len(data) for _, data in pieces] == [5]
        assert wire.statistics.lost == 1

    def test_a_split_answer_pauses(self) -> None:
        """It comes in two pieces, as from an adapter that sends packets, at every place by and by."""
        wire = faulty({"kind": "split", "value": 0.03})
        places = set()
        for begin in range(60):
            (first, head), (second, tail) = asked(wire, float(begin))
            assert head + tail == ANSWER
            assert second - first == pytest.approx(0.03 + len(tail) * IN)
            places.add(len(head))
        assert places == set(range(1, 7))

    def test_an_answer_can_end_at_a_byte_chosen_by_chance(self) -> None:
        """Two numbers stand for one between them, and no answer is cut behind its end."""
        wire = faulty({"kind": "truncate", "value": [0, 255]})
        sizes = [len(b"".join(data for _, data in asked(wire, float(begin)))) for begin in range(100)]
        assert set(sizes) == set(range(7))

    def test_delays_are_drawn_between_two(self) -> None:
        """Each late answer has its own."""
        wire = faulty({"kind": "late", "value": [0.1, 0.3]})
        delays = [when - EXCHANGE for begin in range(20) for when, _ in asked(wire, float(begin))]
        assert all(0.1 <= delay <= 0.3 for delay in delays)
        assert len({round(delay, 6) for delay in delays}) == 20


class TestRequests:
    def test_a_request_can_be_lost_to_all(self) -> None:
        """A fault of the line, counted once however many drives there are: no drive does what it was asked."""
        wire = line({"number": 1}, {"number": 2}, fault=[{"kind": "cut", "count": 1}])
        for begin in (0.0, 1.0):
            wire.feed(framed("06 FA01 0064", 0), begin)
            list(heard(wire))
            expected = 0 if begin == 0.0 else 100
            assert [drive.registers.read(0xFA01) for drive in wire.drives] == [expected, expected]

    def test_a_damaged_request_is_silence_in_modbus(self) -> None:
        """Whichever bit it is: the check is wrong, and no drive obeys."""
        wire = line({"number": 1}, {"number": 2}, fault=[{"kind": "request_flip"}])
        for begin in range(60):
            wire.feed(framed("06 FA01 0064"), float(begin))
            assert list(heard(wire, begin + 0.5)) == []
        assert wire.drives[0].registers.read(0xFA01) == 0
        assert (wire.statistics.broken, wire.statistics.answers) == (60, 0)

    def test_a_damaged_request_is_a_checksum_error_in_toshiba(self) -> None:
        """Or silence, where the damage is to the form; and never obeyed."""
        toshiba = {"number": 1, "protocol": "toshiba"}
        wire = line(toshiba, fault=[{"kind": "request_flip"}])
        answers = set()
        for begin in range(200):
            wire.feed(bytes.fromhex("2F 50 FA 01 17 70 01"), float(begin))
            answers.add(b"".join(data for _, data in heard(wire, begin + 0.5)))
        assert answers == {b"", bytes.fromhex("2F 4E 00 04 81")}
        assert wire.drives[0].registers.read(0xFA01) == 0

    def test_a_request_can_be_damaged_for_one_drive_only(self) -> None:
        """The other one obeys the broadcast."""
        wire = line({"number": 1, "fault": [{"kind": "request_flip", "value": [1, 3]}]}, {"number": 2})
        wire.feed(framed("06 FA01 0064", 0), 0.0)
        list(heard(wire))
        assert [drive.registers.read(0xFA01) for drive in wire.drives] == [0, 100]
        assert wire.statistics.broken == 0

    def test_the_journal_says_what_became_of_a_frame(self) -> None:
        """What a fault did to a request and to an answer stands at it; how often each struck is counted."""
        wire = faulty(
            {"kind": "cut", "count": 1},
            {"kind": "drop", "count": 1},
            {"kind": "flip", "after": "2s", "count": 1},
            {"kind": "late", "value": 0.01, "after": "2s", "count": 1},
        )
        wire.faults.add(Fault(Kind.CUT, after=3.0))
        for begin in range(4):
            asked(wire, float(begin))
        notes = [(entry.way.value, entry.note) for entry in wire.journal.last(100)]
        assert notes == [
            *[("request", ""), ("request", ""), ("answer", "drop")],
            *[("request", ""), ("answer", ""), ("heard", "flip late"), ("request", "cut")],
        ]
        assert wire.faults.struck == {"cut": 2, "drop": 1, "flip": 1, "late": 1}


class TestWhenAndWhom:
    def test_a_fault_stays_with_its_drive(self) -> None:
        """Whatever number the drive has now, and whoever has its old one."""
        wire = faulty({"kind": "drop"})
        first, second = wire.drives
        first.set_by_panel("number", 2)
        second.set_by_panel("number", 1)
        assert asked(wire, 0.0, number=2) == []
        assert len(asked(wire, 1.0, number=1)) == 1

    def test_a_fault_may_go_by_a_number(self) -> None:
        """Then it hits whoever has it."""
        wire = faulty()
        wire.faults.add(Fault(Kind.DROP, 2))
        wire.drives[0].set_by_panel("number", 2)
        wire.drives[1].set_by_panel("number", 1)
        assert asked(wire, 0.0, number=2) == []
        assert len(asked(wire, 1.0, number=1)) == 1

    def test_a_drive_s_fault_leaves_the_others_alone(self) -> None:
        """Drive 2 answers as if nothing were."""
        wire = faulty({"kind": "drop"})
        assert asked(wire, 0.0) == []
        assert len(asked(wire, 1.0, number=2)) == 1

    def test_a_line_s_fault_strikes_all(self) -> None:
        """A fault of the line has no number."""
        wire = line({"number": 1}, {"number": 2}, fault=[{"kind": "drop"}])
        assert asked(wire, 0.0) == asked(wire, 1.0, number=2) == []

    def test_a_fault_strikes_as_often_as_it_counts(self) -> None:
        """Twice, then never again."""
        wire = faulty({"kind": "drop", "count": 2})
        assert [len(asked(wire, float(time))) for time in range(4)] == [0, 0, 1, 1]

    def test_a_fault_has_its_time(self) -> None:
        """From one second after the start until three."""
        wire = faulty({"kind": "drop", "after": "1s", "until": "3s"})
        assert [len(asked(wire, time + 0.5)) for time in range(5)] == [1, 0, 0, 1, 1]

    def test_chance_has_a_seed(self) -> None:
        """The same seed loses the same answers, another one others; about as many as were told."""

        def lost(seed: int) -> list[int]:
            wire = faulty({"kind": "drop", "probability": 0.3}, seed=seed)
            return [time for time in range(300) if not asked(wire, float(time))]

        assert lost(1) == lost(1) != lost(2)
        assert 60 < len(lost(1)) < 120

    def test_faults_can_be_ended(self) -> None:
        """By drive, by kind, or all of them."""
        wire = faulty({"kind": "drop"}, {"kind": "late"})
        first, second = wire.drives
        assert wire.faults.clear(whose(second)) == wire.faults.clear(whose(None)) == 0
        assert wire.faults.clear(kind=next(fault.kind for fault in wire.faults.all)) == 1
        assert wire.faults.clear(whose(first)) == 1
        ((when, data),) = asked(wire)
        assert when == pytest.approx(EXCHANGE)
        assert data == ANSWER

    @pytest.mark.parametrize("characters", [-2.0, 4.0, 7.5, 8.5, 11.0])
    def test_a_request_that_a_late_answer_meets_is_lost(self, characters: float) -> None:
        """Drive 1 begins to talk during drive 2's request, or in the silence that should end it."""
        wire = faulty({"kind": "late", "value": 0.030, "count": 1})
        wire.feed(READ, 0.0)
        begin = EXCHANGE - 7 * IN + 0.030 - characters * OUT
        list(heard(wire, begin))
        wire.feed(framed("03 FD00 0001", 2), begin)
        data = b"".join(data for _, data in heard(wire))
        assert wire.statistics.lost == 1
        assert (len(data), data == ANSWER) == (7, characters > 8)

    def test_a_late_answer_on_top_of_another_spoils_both(self) -> None:
        """Drive 1's late answer meets drive 2's."""
        wire = faulty({"kind": "late", "value": 0.030, "count": 1})
        wire.feed(READ, 0.0)
        begin = 0.030 + 1.5 * IN  # so that the second answer begins in the first one's second character
        list(heard(wire, begin))
        wire.feed(framed("03 FD00 0001", 2), begin)
        data = b"".join(data for _, data in heard(wire))
        assert wire.statistics.collisions == 1
        assert data[0] == 1
        assert not is_whole(data[:7])
