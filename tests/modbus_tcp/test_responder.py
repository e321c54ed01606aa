"""Requests to answers: every exception of the table, and the words of the image."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.image import LinkState
from gateway.modbus_tcp.responder import CLOSE, GO_ON, READ_ON
from gateway.modbus_tcp.server import IDENTITY
from tests.modbus_tcp.rig import NOW, Rig, answer, answers, read, request

LIMIT = 16


def pdu(start: int, count: int, function: int = 3) -> bytes:
    """Make the PDU of a request to read."""
    return struct.pack(">BHH", function, start, count)


@pytest.mark.parametrize("function", [3, 4])
def test_a_drive_answers_under_its_unit_at_its_own_numbers(function: int) -> None:
    """FD00H is FD00, for holding and input registers alike; undefined bits are masked."""
    assert Rig().ask(1, pdu(0xFD00, 4, function)) == bytes([function, 8]) + struct.pack(">4H", 6000, 3, 5000, 0x1234)
    assert Rig().ask(1, pdu(0xFFFF, 1, function)) == bytes([function, 2]) + b"\xbe\xef"


EXCEPTIONS = [
    ("unknown unit", 99, pdu(0xFD00, 1), 0x0A),
    ("unit 0", 0, pdu(0xFD00, 1), 0x0A),
    ("unit 0, write", 0, bytes([6, 0xFA, 0, 0, 1]), 0x0A),
    ("unit 254", 254, pdu(0xFD00, 1), 0x0A),
    ("unknown unit before a wrong count", 99, pdu(0xFD00, 0), 0x0A),
    ("count 0", 1, pdu(0xFD00, 0), 0x03),
    ("count 126", 1, pdu(0xFD00, 126), 0x03),
    ("count 65535", 1, pdu(0xFD00, 0xFFFF), 0x03),
    ("one byte too few", 1, pdu(0xFD00, 1)[:-1], 0x03),
    ("one byte too many", 1, pdu(0xFD00, 1) + b"\0", 0x03),
    ("function code alone", 1, b"\x04", 0x03),
    ("beyond FFFFH", 1, pdu(0xFFFF, 2), 0x02),
    ("not polled", 1, pdu(0xFD30, 1), 0x02),
    ("in front of a run", 1, pdu(0xFCFF, 2), 0x02),
    ("over the end of a run", 1, pdu(0xFD00, 5), 0x02),
    ("silent drive", 2, pdu(0xFD00, 1), 0x0B),
    ("silent drive, not polled", 2, pdu(0xFD30, 1), 0x02),
    ("line down", 3, pdu(0xFD00, 1), 0x0A),
    ("never read", 4, pdu(0xFD00, 1), 0x0B),
    ("compact map of a fifth drive", 255, pdu(64, 1), 0x02),
    ("over the end of the compact map", 255, pdu(63, 2), 0x02),
    ("between map and counters", 255, pdu(0xEFFF, 1), 0x02),
    ("over the end of the counters", 255, pdu(0xF000, 25), 0x02),
    ("gateway, count 126", 255, pdu(0, 126), 0x03),
    ("coils", 1, pdu(0, 1, 1), 0x01),
    ("write single register", 1, bytes([6, 0xFA, 0, 0x84, 0]), 0x01),
    ("write several registers", 1, bytes([16, 0xFA, 0, 0, 1, 2, 0x84, 0]), 0x01),
    ("read and write", 1, bytes([23, 0x18, 0x75, 0, 2, 0x18, 0x70, 0, 2, 4, 0, 0, 0, 0]), 0x01),
    ("write to the gateway", 255, bytes([6, 0, 0, 0, 0]), 0x01),
    ("function 0", 1, b"\0", 0x01),
    ("function 83H", 1, b"\x83\x02", 0x01),
    ("function FFH", 1, b"\xff", 0x01),
    ("another MEI type", 1, bytes([0x2B, 0x0D, 1, 0]), 0x01),
    ("no MEI type", 1, bytes([0x2B]), 0x01),
    ("identification, too short", 1, bytes([0x2B, 0x0E, 1]), 0x03),
    ("identification, too long", 1, bytes([0x2B, 0x0E, 1, 0, 0]), 0x03),
    ("read code 0", 1, bytes([0x2B, 0x0E, 0, 0]), 0x03),
    ("read code 5", 1, bytes([0x2B, 0x0E, 5, 0]), 0x03),
    ("object 3 alone", 1, bytes([0x2B, 0x0E, 4, 3]), 0x02),
    ("identification of a silent drive", 2, bytes([0x2B, 0x0E, 1, 0]), 0x0B),
    ("identification, line down", 3, bytes([0x2B, 0x0E, 1, 0]), 0x0A),
    ("identification not known yet", 4, bytes([0x2B, 0x0E, 1, 0]), 0x0B),
    ("identification of nobody", 99, bytes([0x2B, 0x0E, 1, 0]), 0x0A),
]


@pytest.mark.hazard("H27")
@pytest.mark.hazard("H28")
@pytest.mark.parametrize(("unit", "asked", "code"), [row[1:] for row in EXCEPTIONS], ids=[r[0] for r in EXCEPTIONS])
def test_the_table_of_exceptions(unit: int, asked: bytes, code: int) -> None:
    """Who is not there is 0AH, who is silent 0BH, what is not shown 02; nothing can be written."""
    rig = Rig()
    assert rig.ask(unit, asked) == bytes([asked[0] | 0x80, code])
    assert rig.stats.tcp.exceptions == {code: 1}
    assert rig.stats.tcp.requests == {asked[0]: 1}


@pytest.mark.hazard("H27")
@pytest.mark.hazard("H28")
def test_every_other_function_is_refused_under_every_unit() -> None:
    """256 functions, 256 units: who is not there is 0AH, and all that is neither read nor identification 01."""
    rig = Rig()
    present, silent, down = (1, 4, 255), 2, 3
    for unit in range(256):
        for function in range(256):
            told = rig.ask(unit, bytes([function, 0xFD, 0x00, 0, 1]))
            if unit not in (*present, silent, down):
                assert told == bytes([function | 0x80, 0x0A])
            elif function not in (3, 4, 0x2B):
                assert told == bytes([function | 0x80, 0x01])
    assert sum(rig.stats.tcp.requests.values()) == 256 * 256
    assert rig.ask(1, bytes([3, 0xFD, 0x00, 0, 1])) == b"\x03\x02\x17\x70"


@pytest.mark.hazard("H19")
def test_a_value_is_answered_until_its_maximum_age_and_not_a_moment_longer() -> None:
    """0BH for the old one, also where a fresh one stands beside it; the fresh one alone is answered."""
    rig = Rig()
    rig.clock.moment = NOW + 1.0
    assert rig.ask(1, pdu(0xFD00, 4))[0] == 3
    rig.clock.moment = NOW + 1.001
    assert rig.ask(1, pdu(0xFD00, 4)) == b"\x83\x0b"
    answer(rig.image.by_unit[1], rig.clock.moment, output_frequency=5900)
    assert rig.ask(1, pdu(0xFD00, 4)) == b"\x83\x0b"
    assert rig.ask(1, pdu(0xFD00, 1)) == b"\x03\x02" + struct.pack(">H", 5900)


@pytest.mark.hazard("H19")
def test_after_silence_nothing_old_comes_back() -> None:
    """A drive that answers again is read again before its values are answered."""
    rig = Rig()
    drive = rig.image.by_unit[1]
    drive.set_link(LinkState.OFFLINE, "no answer")
    assert rig.ask(1, pdu(0xFD00, 1)) == b"\x83\x0b"
    drive.set_link(LinkState.ONLINE)
    assert rig.ask(1, pdu(0xFD00, 1)) == b"\x83\x0b"
    answer(drive, output_frequency=1)
    assert rig.ask(1, pdu(0xFD00, 1)) == b"\x03\x02\x00\x01"


class TestIdentification:
    """Function 43, MEI type 14."""

    @pytest.mark.parametrize("read_code", [1, 2, 3])
    def test_a_drive_tells_what_it_told_the_gateway(self, read_code: int) -> None:
        """Vendor, device reference, version; the higher levels get the basic objects too."""
        told = Rig().ask(1, bytes([0x2B, 0x0E, read_code, 0]))
        assert told[:7] == bytes([0x2B, 0x0E, read_code, 0x81, 0, 0, 3])
        assert told[7:] == b"\x00\x07TOSHIBA\x01\x0bVFNC3-2007P\x02\x040102"

    def test_one_object_can_be_asked_for(self) -> None:
        """Read code 4."""
        told = Rig().ask(1, bytes([0x2B, 0x0E, 4, 1]))
        assert told == bytes([0x2B, 0x0E, 4, 0x81, 0, 0, 1]) + b"\x01\x0bVFNC3-2007P"

    def test_a_stream_goes_on_from_an_object_and_begins_anew_at_an_unknown_one(self) -> None:
        """MODBUS Application Protocol V1.1b3, 6.21."""
        assert Rig().ask(1, bytes([0x2B, 0x0E, 1, 2]))[7:] == b"\x02\x040102"
        assert Rig().ask(1, bytes([0x2B, 0x0E, 1, 9]))[6] == 3

    def test_the_gateway_tells_its_own(self) -> None:
        """Unit 255."""
        told = Rig().ask(255, bytes([0x2B, 0x0E, 4, 2]))
        assert told[9:] == IDENTITY["version"].encode()

    def test_a_drive_without_2bh_tells_its_type_form_and_version(self) -> None:
        """As in the TOSHIBA protocols: FB05 and FE08 were read; of a drive that told nothing nothing is told."""
        rig = Rig()
        rig.image.by_unit[1].identity = {"type_form": "VFnC3-2007P", "cpu_version": "102"}
        assert rig.ask(1, bytes([0x2B, 0x0E, 1, 0]))[7:] == b"\x00\x07TOSHIBA\x01\x0bVFnC3-2007P\x02\x03102"
        rig.image.by_unit[1].identity = {"cpu_version": "102"}
        assert rig.ask(1, bytes([0x2B, 0x0E, 4, 1])) == b"\xab\x02"

    def test_long_and_strange_texts_fit_an_answer(self) -> None:
        """Cut to 64 bytes of ASCII each."""
        rig = Rig()
        rig.image.by_unit[1].identity = {"vendor": "\u00e9" * 300, "device": "d" * 300, "version": "v" * 300}
        told = rig.ask(1, bytes([0x2B, 0x0E, 1, 0]))
        assert len(told) == 7 + 3 * 66
        assert told[9:73] == b"?" * 64


@pytest.mark.hazard("H26")
@pytest.mark.parametrize(
    "header",
    [
        pytest.param(struct.pack(">HHH", 1, 1, 6), id="protocol 1"),
        pytest.param(struct.pack(">HHH", 1, 0xFFFF, 6), id="protocol FFFFH"),
        pytest.param(struct.pack(">HHH", 1, 0, 0), id="length 0"),
        pytest.param(struct.pack(">HHH", 1, 0, 1), id="length 1"),
        pytest.param(struct.pack(">HHH", 1, 0, 255), id="length 255"),
        pytest.param(struct.pack(">HHH", 1, 0, 0xFFFF), id="length FFFFH"),
    ],
)
@pytest.mark.parametrize("behind", [b"", bytes(6), bytes(300)], ids=["header alone", "short", "long"])
def test_a_wrong_header_ends_the_stream_behind_what_was_right(header: bytes, behind: bytes) -> None:
    """The answers in front of it are given; nothing behind it is looked at."""
    rig = Rig()
    good = read(5, 1, 0xFD00, 1)
    stream, used, then = rig.responder.respond(good + header + behind, 0, LIMIT, NOW)
    assert [transaction for transaction, _, _ in answers(stream)] == [5]
    assert used == len(good)
    assert then is CLOSE


def test_the_limit_leaves_the_rest_for_the_next_turn() -> None:
    """17 requests: 16 answers, and word that more waits."""
    rig = Rig()
    data = b"".join(read(i, 1, 0xFD00, 1) for i in range(17))
    stream, used, then = rig.responder.respond(data, 0, LIMIT, NOW)
    assert [transaction for transaction, _, _ in answers(stream)] == list(range(16))
    assert then is GO_ON
    stream, used, then = rig.responder.respond(data, used, LIMIT, NOW)
    assert [transaction for transaction, _, _ in answers(stream)] == [16]
    assert (used, then) == (len(data), READ_ON)


@given(st.integers(0, 255), st.binary(min_size=1, max_size=253), st.integers(0, 0xFFFF))
def test_any_pdu_gets_exactly_one_answer(unit: int, asked: bytes, transaction: int) -> None:
    """With its transaction, unit and function; an exception has one of the five codes."""
    rig = Rig()
    stream, used, then = rig.responder.respond(request(transaction, unit, asked), 0, LIMIT, NOW)
    ((told_transaction, told_unit, told),) = answers(stream)
    assert (told_transaction, told_unit) == (transaction, unit)
    assert (used, then) == (7 + len(asked), READ_ON)
    assert told[0] & 0x7F == asked[0] & 0x7F
    if told[0] & 0x80:
        assert told[0] == asked[0] | 0x80
        assert len(told) == 2
        assert told[1] in (1, 2, 3, 0x0A, 0x0B)
    else:
        assert asked[0] in (3, 4, 0x2B)
    assert sum(rig.stats.tcp.requests.values()) == 1


@given(st.integers(0, 255), st.integers(0, 0xFFFF), st.integers(0, 200), st.sampled_from([3, 4]))
def test_any_read_has_as_many_words_as_asked_or_is_refused(unit: int, start: int, count: int, function: int) -> None:
    """No answer is longer or shorter than its count."""
    told = Rig().ask(unit, pdu(start, count, function))
    if told[0] == function:
        assert told[1] == 2 * count
        assert len(told) == 2 + 2 * count
    else:
        assert told[0] == function | 0x80
