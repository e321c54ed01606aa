"""The TOSHIBA protocol in ASCII mode: what may be left out, groups, trips, and what is no answer."""

from __future__ import annotations

import pytest

from gateway.errors import Refusal, Refused
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Group,
    Identify,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    Words,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.toshiba_ascii import ToshibaAscii
from tests.protocol.drive_side import Denied, Heard, heard

CODEC = ToshibaAscii()
BARE = ToshibaAscii(has_checksum=False, has_stop=False)
PLAIN = ToshibaAscii(has_checksum=False)
FAULT_RESET = WriteRam(1, 0xFA00, 0xA000, is_answered=False)


def hear(request: Request, *frames: bytes, codec: ToshibaAscii = PLAIN) -> list[Heard]:
    """Return what frames and the silence behind them say to a request."""
    return heard(codec.decoder(request), [*frames, b""])


def test_what_the_protocol_has() -> None:
    """R, W and P, numbers 00 to 99 and groups by a digit; no block, no identification, no S."""
    assert CODEC.forms == Forms(range(100), has_ram_write=True, has_digit_groups=True, says_tripped=True)
    assert PROTOCOLS[CODEC.name] == CODEC


def test_a_read_with_everything_has_13_characters_and_its_answer_17() -> None:
    """Number, checksum and stop code: the form that the gateway speaks."""
    request = ReadWords(1, 0xFD00)
    assert CODEC.encode(request) == b"(01RFD00&EB)\r"
    assert len(CODEC.encode(request)) == 13
    assert (CODEC.answer_size(request), CODEC.least_answer(request)) == (17, 13)


@pytest.mark.parametrize(
    ("codec", "number", "frame", "sizes"),
    [
        (ToshibaAscii(), 7, b"(07R0803&D2)\r", (17, 13)),
        (ToshibaAscii(has_stop=False), 7, b"(07R0803&D2\r", (16, 12)),
        (ToshibaAscii(has_checksum=False), 7, b"(07R0803)\r", (14, 10)),
        (BARE, 7, b"(07R0803\r", (13, 9)),
        (ToshibaAscii(), None, b"(R0803&6B)\r", (15, 11)),
        (BARE, None, b"(R0803\r", (11, 7)),
    ],
)
def test_number_checksum_and_stop_code_may_be_left_out(
    codec: ToshibaAscii, number: int | None, frame: bytes, sizes: tuple[int, int]
) -> None:
    """The answer has them exactly if the request had (E6581657 4.1.1)."""
    request = ReadWords(number, 0x0803)
    assert codec.encode(request) == frame
    assert (codec.answer_size(request), codec.least_answer(request)) == sizes


@pytest.mark.parametrize(
    "answer",
    [
        b"(07R08031770&A1)\r",
        b"(07R08031770&A1\r",
        b"(07R08031770)\r",
        b"(07R08031770\r",
        b"(R08031770)\r",
        b"(R08031770\r",
    ],
)
@pytest.mark.parametrize("codec", [ToshibaAscii(a, b) for a in (False, True) for b in (False, True)])
@pytest.mark.parametrize("number", [7, None])
def test_an_answer_in_another_form_than_its_request_is_none(
    codec: ToshibaAscii, number: int | None, answer: bytes
) -> None:
    """Number, sum and stop code are there or not as they were asked for."""
    is_form_right = (b"&" in answer, b")" in answer) == (codec.has_checksum, codec.has_stop)
    is_number_right = (answer[1:3] == b"07") is (number is not None)
    expected = [Words((6000,), False)] if is_form_right and is_number_right else []
    assert hear(ReadWords(number, 0x0803), answer, codec=codec) == expected


@pytest.mark.parametrize(
    ("group", "address", "answerer"),
    [(EVERY_DRIVE, b"**", b"00"), (Group(None, 9), b"*9", b"09"), (Group(2, None), b"2*", b"20")],
)
class TestGroups:
    def test_are_addressed_by_an_asterisk_and_perhaps_answered(
        self, group: Group, address: bytes, answerer: bytes
    ) -> None:
        """The drive with 0 in the place of the asterisk answers, with its own number (E6581657 4.4)."""
        write = WriteRam(group, 0xFA01, 6000)
        assert PLAIN.encode(write) == b"(" + address + b"PFA011770)\r"
        assert PLAIN.answering(write) is Answering.MAYBE
        assert hear(write, b"(" + answerer + b"PFA011770)\r") == [Written((), False)]
        assert hear(write, b"(" + answerer + b"n0000)\r") == [Denied(Refusal.UNABLE, True)]
        assert hear(ReadWords(group, 0), b"(" + answerer + b"R00000001)\r") == [Words((1,), False)]

    @pytest.mark.hazard("H15")
    def test_their_echo_is_no_answer(self, group: Group, address: bytes, answerer: bytes) -> None:
        """An asterisk is in no answer, and nobody else answers for them."""
        write = WriteStored(group, 0x0010, 100)
        assert hear(write, PLAIN.encode(write)) == []
        assert hear(write, b"(39W00100064)\r") == []


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("0000", Refusal.UNABLE),
        ("0001", Refusal.RANGE),
        ("0002", Refusal.ADDRESS),
        ("0003", Refusal.COMMAND),
        ("0004", Refusal.CHECKSUM),
        ("0005", Refusal.OTHER),
        ("FFFF", Refusal.OTHER),
    ],
)
def test_error_codes_are_refusals(code: str, reason: Refusal) -> None:
    """E6581657 4.3: N, or n while the drive is tripped."""
    for request in (ReadWords(1, 0), WriteRam(1, 0, 0), WriteStored(1, 0, 0), FAULT_RESET):
        assert hear(request, f"(01N{code})\r".encode()) == [Denied(reason, False)]
        assert hear(request, f"(01n{code})\r".encode()) == [Denied(reason, True)]


def test_a_refusal_says_who_and_why() -> None:
    """The message is for the operator."""
    decoder = PLAIN.decoder(WriteRam(12, 0xFA01, 6000))
    decoder.feed(b"(12N0000)\r")
    with pytest.raises(Refused, match=r"number 12: error 0000 \(impossible to execute now\)"):
        decoder.next_reply()


def test_a_tripped_drive_answers_in_lower_case() -> None:
    """The command and 20H, the rest as always; hexadecimal digits stay in upper case."""
    assert hear(WriteRam(1, 0xFA01, 6000), b"(01pFA011770)\r") == [Written((), True)]
    assert hear(WriteStored(1, 0xFA01, 6000), b"(01wFA011770)\r") == [Written((), True)]
    assert hear(ReadWords(1, 0xFA01), b"(01rFA01077B)\r") == [Words((0x077B,), True)]


@pytest.mark.hazard("H16")
@pytest.mark.hazard("H17")
@pytest.mark.parametrize(
    "answer",
    [
        b"(02RFD001770)\r",
        b"(01WFD001770)\r",
        b"(01RFD011770)\r",
        b"(01RFD00177)\r",
        b"(01RFD0017700)\r",
        b"(01RFD00177G)\r",
        b"(01RFD00 770)\r",
        b"(01RFD00+770)\r",
        b"(01RFD00077b)\r",
        b"(01Rfd001770)\r",
        b"(01RFD001770)\n",
        b"(01RFD001770]\r",
        b"(1RFD001770)\r",
        b"(01N000)\r",
        b"(01N00000)\r",
    ],
)
def test_what_is_not_exact_is_no_answer(answer: bytes) -> None:
    """Number, command, communication number, four digits in upper case, stop code, carriage return."""
    assert hear(ReadWords(1, 0xFD00), answer) == []


@pytest.mark.hazard("H09")
def test_a_fault_reset_is_only_refused() -> None:
    """What looks like its answer can only be the adapter's echo."""
    echo = PLAIN.encode(FAULT_RESET)
    assert echo == b"(01PFA00A000)\r"
    assert PLAIN.answering(FAULT_RESET) is Answering.MAYBE
    assert (PLAIN.answer_size(FAULT_RESET), PLAIN.least_answer(FAULT_RESET)) == (0, 10)
    assert hear(FAULT_RESET, echo) == []
    assert hear(FAULT_RESET, echo + b"(01n0000)\r") == [Denied(Refusal.UNABLE, True)]


@pytest.mark.parametrize("request_", [ReadWords(0, 0), WriteRam(99, 0xFA01, 1), WriteStored(None, 0x0010, 1)])
def test_a_request_to_one_drive_is_always_answered(request_: Request) -> None:
    """00 to 99, or no number where there is one drive only."""
    assert CODEC.answering(request_) is Answering.ALWAYS


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (ReadWords(100, 0), "inverter number must be 0 to 99, not 100"),
        (ReadWords(-1, 0), "inverter number must be 0 to 99, not -1"),
        (ReadWords(Group(1, 2), 0), r"group 12: a group is \*\*, \*n or n\*"),
        (ReadWords(Group(10, None), 0), r"group 10\*: a group is \*\*, \*n or n\* with n from 0 to 9"),
        (ReadWords(1, 0, 2), "count of a read must be 1, not 2"),
        (ReadWords(1, 0x10000), "communication number must be 0 to 65535"),
        (WriteRam(1, 0x10000, 0), "communication number must be 0 to 65535"),
        (WriteRam(1, 0xFA01, 0x10000), r"word must be 0 to 65535 \(FFFFH\), not 65536"),
        (WriteStored(1, 0xFA01, -1), "word must be 0 to 65535"),
        (ReadBlock(1, 0x1875, 2), "has no block: read and write its words one by one"),
        (WriteBlock(1, 0x1870, (1, 2)), "has no block"),
        (Exchange(1, 0x1875, 2, 0x1870, (1, 2)), "has no block"),
        (Identify(1), "no identification: read the registers that tell the type"),
        (Proportional(1, 0xFA01, 5000), "no proportional command: write the frequency"),
    ],
)
def test_what_the_protocol_has_not_is_refused_by_every_method(request_: Request, message: str) -> None:
    """The message says what is wrong and what would be right; nothing is sent."""
    for method in (CODEC.encode, CODEC.answering, CODEC.answer_size, CODEC.least_answer, CODEC.decoder):
        with pytest.raises(NoSuchForm, match=message):
            method(request_)
