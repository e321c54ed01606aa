from __future__ import annotations

from random import Random

import pytest

from gateway.protocol.timing import LineTiming
from gateway.sim.drive import SimulatedDrive
from gateway.sim.faults import Faults
from gateway.sim.frames import is_whole
from gateway.sim.options import DriveOptions
from gateway.sim.wire import Wire
from tests.sim.rig import binary, framed, models
from tests.sim.test_wire import BAUD, GAP, IN, OUT, PROCESSING, heard

Described = tuple[int, str, str]

ALL = [(number, "vf-nc3", "toshiba") for number in (0, 1, 10, 40, 47)]
ALL += [(number, "vf-mb1", "modbus-rtu") for number in (1, 40, 47, 58)]
ALL += [(2, "vf-as3", "toshiba"), (3, "vf-as3", "modbus-rtu")]


def line(*drives: Described) -> Wire:
    """Build a wire of drives with number, model and protocol."""
    made = []
    for place, (number, model, protocol) in enumerate(drives):
        options = DriveOptions(number, protocol, stable_bits=True)  # type: ignore[arg-type]
        made.append(SimulatedDrive(models()[model], options, Random(place)))
    return Wire(LineTiming(BAUD), made, Faults(Random(1)))


def ask(wire: Wire, frame: bytes, begin: float = 0.0) -> list[bytes]:
    """Send a frame; return what is heard within a second."""
    wire.feed(frame, begin)
    return [data for _, data in heard(wire, begin + 1.0)]


class TestProtocolsSideBySide:
    def test_each_frame_reaches_the_drives_of_its_protocol_only(self) -> None:
        """Number 1 is on the line in both protocols, as are 40 and 47, the codes of "(" and "/"."""
        wire = line(*ALL)
        answers = []
        for place, number in enumerate((1, 40, 47)):
            begin = 10.0 * place
            answers += ask(wire, f"({number:02d}RFD00)\r".encode(), begin)
            answers += ask(wire, binary(f"{number:02X} 52 FD00"), begin + 2)
            answers += ask(wire, framed("03 FD00 0001", number), begin + 4)
        expected = [
            (f"({n:02d}RFD000000)\r".encode(), binary(f"{n:02X} 52 FD00 0000"), framed("03 02 0000", n))
            for n in (1, 40, 47)
        ]
        assert answers == [answer for answers_ in expected for answer in answers_]
        assert (wire.statistics.broken, wire.statistics.collisions, wire.statistics.unanswered) == (0, 0, 0)

    def test_the_model_answers_as_it_is(self) -> None:
        """Two drives of one protocol and two models: only one has S, and each its own holes."""
        wire = line((1, "vf-nc3", "toshiba"), (2, "vf-mb1", "toshiba"))
        assert ask(wire, b"(01R0131)\r") == [b"(01N0002)\r"]
        assert ask(wire, b"(02R0131)\r", 2.0) == [b"(02R01310000)\r"]
        assert ask(wire, binary("53 FA01 1388"), 4.0) == []
        assert [drive.inverter.memory.word("frequency_command") for drive in wire.drives] == [0, 4000]

    def test_a_broadcast_is_for_the_drives_of_its_protocol(self) -> None:
        """Each protocol has its own, and none of the other's drives obeys it."""
        wire = line(*ALL)
        answers = [
            ask(wire, b"(**PFA010001)\r"),
            ask(wire, framed("06 FA01 0002", 0), 2.0),
            ask(wire, binary("FF 50 FA01 0003"), 4.0),
        ]
        assert answers == [[b"(00PFA010001)\r"], [], [binary("00 50 FA01 0003")]]
        words = {
            (drive.number, drive.model.name): drive.inverter.memory.word("frequency_command") for drive in wire.drives
        }
        assert {words[n, "vf-nc3"] for n in (0, 1, 10, 40, 47)} == {3}
        assert {words[n, "vf-mb1"] for n in (1, 40, 47, 58)} == {2}

    def test_the_line_counts_a_frame_as_broken_that_is_whole_in_no_protocol(self) -> None:
        """One of each that is whole, and one of each that is not; a wrong checksum is answered none the less."""
        wire = line((1, "vf-nc3", "toshiba"), (1, "vf-nc3", "modbus-rtu"))
        whole = [b"(05RFD00)\r", binary("05 52 FD00"), framed("03 FD00 0001", 5)]
        broken = [b"(05RFD00\n", binary("05 52 FD00")[:-1] + b"\x00", framed("03 FD00 0001", 5)[:-1] + b"\x00"]
        for place, frame in enumerate(whole + broken):
            assert ask(wire, frame, 2.0 * place) == []
        assert (wire.statistics.unanswered, wire.statistics.broken, wire.statistics.answers) == (3, 3, 0)
        assert ask(wire, b"(01RFD00&00)\r", 20.0) == [b"(01N0004&C1)\r"]
        assert (wire.statistics.unanswered, wire.statistics.broken, wire.statistics.answers) == (3, 4, 1)


class TestTiming:
    @pytest.mark.parametrize(
        ("request_", "answer"),
        [(b"(01RFD00)\r", b"(01RFD000000)\r"), (binary("01 52 FD00"), binary("01 52 FD00 0000"))],
    )
    def test_a_frame_is_looked_at_after_the_silence(self, request_: bytes, answer: bytes) -> None:
        """CR and the last byte alone do not end it: 3.5 characters do, in both modes (3.1)."""
        wire = line((1, "vf-nc3", "toshiba"))
        wire.feed(request_, 0.0)
        ((when, data),) = heard(wire)
        assert data == answer
        assert when == pytest.approx(len(request_) * OUT + GAP + PROCESSING + len(answer) * IN)

    @pytest.mark.parametrize("request_", [b"(01RFD00)\r", binary("01 52 FD00"), binary("01 58 00 00")])
    def test_a_frame_split_by_a_pause_is_broken_wherever_it_is_split(self, request_: bytes) -> None:
        """1.4 characters are borne, 1.6 and 2 seconds are not: the format's second (4.1.3) has nothing to add."""
        for place in range(1, len(request_)):
            for pause, answers in ((1.4 * OUT, 1), (1.6 * OUT, 0), (2.0, 0)):
                wire = line((1, "vf-nc3", "toshiba"))
                wire.feed(request_[:place], 0.0)
                begin = place * OUT + pause
                early = list(heard(wire, begin))
                wire.feed(request_[place:], begin)
                assert len(early) + len(list(heard(wire))) == answers
                assert wire.statistics.gap_violations == 0

    @pytest.mark.parametrize("request_", [b"(01RFD00)\r", b"(01RFD00\r", binary("01 52 FD00"), binary("01 58 00 00")])
    def test_a_request_right_behind_another_is_a_gap_violation(self, request_: bytes) -> None:
        """A whole frame was there: the gap behind it is owed, and both are lost."""
        wire = line((2, "vf-nc3", "toshiba"))
        wire.feed(request_, 0.0)
        wire.feed(request_, (len(request_) + 2) * OUT)
        assert list(heard(wire)) == []
        assert (wire.statistics.gap_violations, wire.statistics.splits) == (1, 0)

    def test_an_incomplete_frame_is_forgotten(self) -> None:
        """Nothing follows; the next frame is understood."""
        wire = line((1, "vf-nc3", "toshiba"))
        assert ask(wire, b"(01RFD0") == []
        assert ask(wire, b"(01RFD00)\r", 1.0) == [b"(01RFD000000)\r"]


class TestCollisions:
    @pytest.mark.parametrize("request_", [b"(01RFD00)\r", binary("01 52 FD00"), b"(**RFD00)\r", b"(RFD00)\r"])
    def test_two_drives_that_both_answer_do_so_on_top_of_each_other(self, request_: bytes) -> None:
        """One number twice, two representatives, or a request without a number on a line of two."""
        number = 0 if request_.startswith(b"(*") else 1
        wire = line((number, "vf-nc3", "toshiba"), (number, "vf-mb1", "toshiba"))
        answers = ask(wire, request_)
        assert len(answers) == 1
        assert not is_whole(answers[0])
        assert wire.statistics.collisions == 1

    def test_one_number_in_two_protocols_does_not_collide(self) -> None:
        """Each answers to its own frames."""
        wire = line((1, "vf-nc3", "toshiba"), (1, "vf-nc3", "modbus-rtu"))
        assert ask(wire, b"(01RFD00)\r") == [b"(01RFD000000)\r"]
        assert ask(wire, framed("03 FD00 0001"), 2.0) == [framed("03 02 0000")]
        assert wire.statistics.collisions == 0

    def test_renumbering_ends_a_collision(self) -> None:
        """Number 1 twice, one of them set to 2 at its panel: both answer, each to its own."""
        wire = line((1, "vf-nc3", "toshiba"), (1, "vf-mb1", "toshiba"))
        wire.drives[1].set_by_panel("number", 2)
        assert ask(wire, b"(01RFD00)\r") == [b"(01RFD000000)\r"]
        assert ask(wire, b"(02RFD00)\r", 2.0) == [b"(02RFD000000)\r"]


class TestBusyDrives:
    @pytest.mark.parametrize("frame", [b"(**W08800001)\r", binary("FF 57 0880 0001")])
    def test_who_obeys_a_group_s_write_is_deaf_while_it_works(self, frame: bytes) -> None:
        """50 ms for the EEPROM, though nobody answers: a request meanwhile is not heard, one afterwards is."""
        for pause, answers in ((0.049, []), (0.051, [b"(01RFD000000)\r"])):
            wire = line((1, "vf-nc3", "toshiba"))
            wire.feed(frame, 0.0)
            begin = len(frame) * OUT + GAP + pause
            assert list(heard(wire, begin)) == []
            assert ask(wire, b"(01RFD00)\r", begin) == answers

    def test_modbus_broadcasts_take_their_time_too(self) -> None:
        """06H to number 0: the processing time passes before the next frame is heard."""
        for pause, count in ((PROCESSING - 0.001, 0), (PROCESSING + 0.001, 1)):
            wire = line((1, "vf-nc3", "modbus-rtu"))
            wire.feed(framed("06 FA01 0064", 0), 0.0)
            begin = 8 * OUT + GAP + pause
            list(heard(wire, begin))
            assert len(ask(wire, framed("03 FD00 0001"), begin)) == count

    def test_frames_for_others_keep_nobody_busy(self) -> None:
        """Another number's write: the next frame is heard right behind the gap."""
        wire = line((1, "vf-nc3", "toshiba"))
        frame = b"(02W08800001)\r"
        wire.feed(frame, 0.0)
        begin = len(frame) * OUT + GAP
        list(heard(wire, begin))
        assert ask(wire, b"(01RFD00)\r", begin) == [b"(01RFD000000)\r"]
