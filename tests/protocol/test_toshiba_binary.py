"""The TOSHIBA protocol in binary mode: commands, blocks and their write status, broadcast, trips."""

from __future__ import annotations

import pytest

from gateway.errors import Refusal
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Exchanged,
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
from gateway.protocol.toshiba_binary import ToshibaBinary
from tests.protocol.drive_side import Denied, Heard, heard

CODEC = ToshibaBinary()
BY_G = ToshibaBinary(reads_by_g=True)
FAULT_RESET = WriteRam(1, 0xFA00, 0xA000, is_answered=False)
EXCHANGE = Exchange(1, 0, 2, 0, (0xC400, 6000))


def summed(printed: str) -> bytes:
    """Return a frame from its bytes without the sum."""
    body = bytes.fromhex(printed)
    return body + bytes((sum(body) % 256,))


def hear(request: Request, *frames: bytes, codec: ToshibaBinary = CODEC) -> list[Heard]:
    """Return what frames and the silence behind them say to a request."""
    return heard(codec.decoder(request), [*frames, b""])


def test_what_the_protocol_has() -> None:
    """Numbers 00H to 3FH, blocks written and read in one frame, writes that spare the EEPROM, S."""
    assert CODEC.forms == Forms(
        range(0x40), has_block=True, has_exchange=True, has_ram_write=True, has_proportional=True, says_tripped=True
    )
    assert PROTOCOLS[CODEC.name] == CODEC


@pytest.mark.parametrize(
    ("request_", "printed", "sizes"),
    [
        (ReadWords(1, 0xFD00), "2F 01 52 FD 00", (8, 6)),
        (ReadWords(None, 0xFD00), "2F 52 FD 00", (7, 5)),
        (WriteRam(0x3F, 0xFA01, 6000), "2F 3F 50 FA 01 17 70", (8, 6)),
        (WriteStored(0, 0x0010, 100), "2F 00 57 00 10 00 64", (8, 6)),
        (ReadBlock(1, 0x1875, 5), "2F 01 58 00 05", (16, 6)),
        (ReadBlock(None, 0x1875, 1), "2F 58 00 01", (7, 5)),
        (WriteBlock(1, 0x1870, (0xC400,)), "2F 01 58 01 00 C4 00", (6, 6)),
        (WriteBlock(1, 0x1870, (0xC400, 6000)), "2F 01 58 02 00 C4 00 17 70", (6, 6)),
        (EXCHANGE, "2F 01 58 02 02 C4 00 17 70", (10, 6)),
    ],
)
def test_requests_and_the_sizes_of_their_answers(request_: Request, printed: str, sizes: tuple[int, int]) -> None:
    """X with write groups, read groups or both; the number in front, or none (E6581657 4.1.2, 4.1.3)."""
    assert CODEC.encode(request_) == summed(printed)
    assert CODEC.answering(request_) is Answering.ALWAYS
    assert (CODEC.answer_size(request_), CODEC.least_answer(request_)) == sizes


def test_reads_by_g_carry_dummy_data() -> None:
    """For two-wire lines of older models (E6581657 4.2); R is not its answer."""
    request = ReadWords(1, 0xFE03)
    assert BY_G.encode(request) == summed("2F 01 47 FE 03 00 00")
    assert hear(request, summed("2F 01 67 FE 03 07 7B"), codec=BY_G) == [Words((1915,), True)]
    assert hear(request, summed("2F 01 52 FE 03 07 7B"), codec=BY_G) == []


@pytest.mark.parametrize(
    ("status", "failed"),
    [(0, ()), (1, (0,)), (2, (1,)), (3, (0, 1))],
)
def test_the_write_status_tells_which_words_were_not_written(status: int, failed: tuple[int, ...]) -> None:
    """Bit 0 for F870, bit 1 for F871 (E6581657 4.1.3); a bit for a word that was not sent says nothing."""
    exchanged = summed(f"2F 01 59 02 {status:02X} 40 00 00 05")
    assert hear(EXCHANGE, exchanged) == [Exchanged((0x4000, 5), failed, False)]
    written = summed(f"2F 01 79 00 {status:02X}")
    assert hear(WriteBlock(1, 0, (1, 2)), written) == [Written(failed, True)]
    assert hear(WriteBlock(1, 0, (1,)), written) == [Written(failed[:1] if status & 1 else (), True)]
    assert hear(ReadBlock(1, 0, 2), exchanged) == [Words((0x4000, 5), False)]


@pytest.mark.hazard("H17")
@pytest.mark.parametrize("status", [4, 0x80, 0xFF])
def test_no_other_write_status_is_one(status: int) -> None:
    """00H to 03H."""
    answer = summed(f"2F 01 59 02 {status:02X} 40 00 00 05")
    assert hear(EXCHANGE, answer) == hear(ReadBlock(1, 0, 2), answer) == []
    assert hear(WriteBlock(1, 0, (1, 2)), summed(f"2F 01 59 00 {status:02X}")) == []


@pytest.mark.hazard("H16")
@pytest.mark.parametrize(
    "wrong",
    [
        "2F 02 59 02 00 40 00 00 05",
        "2F 01 58 02 00 40 00 00 05",
        "2F 01 59 01 00 40 00",
        "2F 01 59 00 00",
        "2F 01 59 03 00 40 00 00 05 00 00",
        "2F 59 02 00 40 00 00 05",
        "28 01 59 02 00 40 00 00 05",
    ],
)
def test_a_block_answer_has_the_number_and_the_count_asked_for(wrong: str) -> None:
    """A drive that was asked for too much answers with no data: that is no answer either (4.1.3)."""
    assert hear(EXCHANGE, summed(wrong)) == []


@pytest.mark.hazard("H16")
@pytest.mark.parametrize("wrong", ["2F 02 50 FA 01 17 70", "2F 01 57 FA 01 17 70", "2F 01 50 FA 00 17 70"])
def test_an_answer_to_a_write_repeats_all_of_it(wrong: str) -> None:
    """Number, command, communication number and word."""
    write = WriteRam(1, 0xFA01, 6000)
    assert hear(write, summed(wrong)) == []
    assert hear(write, summed("2F 01 50 FA 01 17 71")) == []
    assert hear(write, summed("2F 01 70 FA 01 17 70")) == [Written((), True)]


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (0, Refusal.UNABLE),
        (1, Refusal.RANGE),
        (2, Refusal.ADDRESS),
        (3, Refusal.COMMAND),
        (4, Refusal.CHECKSUM),
        (5, Refusal.OTHER),
        (0x0100, Refusal.OTHER),
    ],
)
def test_error_codes_are_refusals(code: int, reason: Refusal) -> None:
    """E6581657 4.3: N, or n while the drive is tripped."""
    for request in (ReadWords(1, 0), WriteRam(1, 0, 0), WriteBlock(1, 0, (0,)), EXCHANGE, FAULT_RESET):
        assert hear(request, summed(f"2F 01 4E {code:04X}")) == [Denied(reason, False)]
        assert hear(request, summed(f"2F 01 6E {code:04X}")) == [Denied(reason, True)]


@pytest.mark.parametrize(
    ("request_", "printed", "answer", "said"),
    [
        (WriteRam(EVERY_DRIVE, 0xFA01, 6000), "FF 50 FA 01 17 70", "00 50 FA 01 17 70", Written((), False)),
        (WriteStored(EVERY_DRIVE, 0x0010, 1), "FF 57 00 10 00 01", "00 77 00 10 00 01", Written((), True)),
        (ReadWords(EVERY_DRIVE, 0xFD00), "FF 52 FD 00", "00 52 FD 00 17 70", Words((6000,), False)),
        (WriteBlock(EVERY_DRIVE, 0, (1, 2)), "FF 58 02 00 00 01 00 02", "00 59 00 00", Written((), False)),
        (ReadBlock(EVERY_DRIVE, 0, 1), "FF 58 00 01", "00 59 01 00 40 00", Words((0x4000,), False)),
    ],
)
def test_every_drive_is_ffh_and_the_one_numbered_00_answers(
    request_: Request, printed: str, answer: str, said: Heard
) -> None:
    """E6581657 4.4; nobody else answers, and the echo is no answer."""
    frame = summed(f"2F {printed}")
    assert CODEC.encode(request_) == frame
    assert CODEC.answering(request_) is Answering.MAYBE
    assert hear(request_, frame) == []
    assert hear(request_, frame, summed(f"2F {answer}")) == [said]
    assert hear(request_, summed(f"2F 01{answer[2:]}")) == []


@pytest.mark.parametrize("target", [None, 5, EVERY_DRIVE])
def test_a_proportion_is_never_answered(target: int | Group | None) -> None:
    """S, or s where the master is tripped (VF-MB1 manual 4.2, 6.2), to all, to everybody or to one drive."""
    number = {None: "", 5: "05", EVERY_DRIVE: "FF"}[target]
    request = Proportional(target, 0xFA01, 10000)
    assert CODEC.encode(request) == summed(f"2F {number} 53 FA 01 27 10")
    assert CODEC.encode(Proportional(target, 0xFA01, 0, True)) == summed(f"2F {number} 73 FA 01 00 00")
    assert CODEC.answering(request) is Answering.NEVER
    assert (CODEC.answer_size(request), CODEC.least_answer(request)) == (0, 0)
    assert hear(request, CODEC.encode(request), summed("2F 05 4E 00 02")) == []


@pytest.mark.hazard("H09")
def test_a_fault_reset_is_only_refused() -> None:
    """What looks like its answer can only be the adapter's echo."""
    echo = CODEC.encode(FAULT_RESET)
    assert CODEC.answering(FAULT_RESET) is Answering.MAYBE
    assert (CODEC.answer_size(FAULT_RESET), CODEC.least_answer(FAULT_RESET)) == (0, 6)
    assert hear(FAULT_RESET, echo) == []
    assert hear(FAULT_RESET, echo + summed("2F 01 4E 00 00")) == [Denied(Refusal.UNABLE, False)]


@pytest.mark.hazard("H15")
class TestEchoOfARead:
    """The echo of R has all that its answer begins with, and its sum may fit with what follows."""

    request = ReadWords(1, 0xFD6A)  # with the two bytes that follow, its echo has a fitting sum

    def test_and_the_beginning_of_the_answer_are_no_answer(self) -> None:
        """Eight bytes with a right sum: six of the echo, two of the answer, which comes."""
        echo, answer = CODEC.encode(self.request), summed("2F 01 52 FD 6A 17 70")
        assert sum((echo + answer)[:7]) % 256 == (echo + answer)[7]
        assert hear(self.request, echo + answer) == [Words((6000,), False)]
        assert hear(self.request, *(bytes((byte,)) for byte in echo + answer)) == [Words((6000,), False)]
        assert hear(self.request, echo + b"\xff" + answer) == [Words((6000,), False)]

    def test_is_an_answer_when_the_line_falls_silent_behind_it(self) -> None:
        """The same eight bytes are what a drive says whose word is E92FH."""
        answer = summed("2F 01 52 FD 6A E9 2F")
        assert answer == CODEC.encode(self.request) + b"\x2f\x01"
        decoder = CODEC.decoder(self.request)
        assert heard(decoder, [answer]) == []
        assert heard(decoder, [b""]) == [Words((0xE92F,), False)]

    def test_with_a_broken_answer_behind_it_is_none(self) -> None:
        """The echo's word must not be believed only because the answer was damaged."""
        echo, broken = CODEC.encode(self.request), b"\x2f\x01\x52\xfd\x6a\x17\x70\x00"
        assert hear(self.request, echo + broken) == []


@pytest.mark.hazard("H17")
def test_a_refusal_among_the_words_of_a_block_is_none() -> None:
    """Words that look like N: the block is waited for, however it is cut."""
    block = summed("2F 59 05 00 2F 4E 00 00 7D 00 00 00 00 00")
    expected = [Words((0x2F4E, 0, 0x7D00, 0, 0), False)]
    request = ReadBlock(None, 0, 5)
    assert hear(request, block) == hear(request, *(bytes((byte,)) for byte in block)) == expected


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (ReadWords(0x40, 0), "inverter number must be 0 to 63, not 64"),
        (ReadWords(-1, 0), "inverter number must be 0 to 63, not -1"),
        (ReadWords(0xFF, 0), "inverter number must be 0 to 63, not 255"),
        (WriteRam(Group(None, 2), 0xFA01, 0), r"group \*2: there is only the group of all drives"),
        (ReadWords(1, 0, 2), "count of a read must be 1, not 2"),
        (ReadWords(1, 0x10000), "communication number must be 0 to 65535"),
        (WriteRam(1, 0xFA01, 0x10000), r"word must be 0 to 65535 \(FFFFH\), not 65536"),
        (WriteStored(1, -1, 0), "communication number must be 0 to 65535"),
        (ReadBlock(1, 0, 0), "count of a block read must be 1 to 5, not 0"),
        (ReadBlock(1, 0, 6), "count of a block read must be 1 to 5, not 6"),
        (WriteBlock(1, 0, ()), "count of a block write must be 1 to 5, not 0"),
        (WriteBlock(1, 0, (0,) * 6), "count of a block write must be 1 to 5, not 6"),
        (WriteBlock(1, 0, (0x10000,)), "word must be 0 to 65535"),
        (Exchange(1, 0, 0, 0, (1,)), "count of a block read must be 1 to 5, not 0"),
        (Exchange(1, 0, 5, 0, ()), "count of a block write must be 1 to 5, not 0"),
        (Proportional(None, 0xFA01, 10001), "proportion in 0.01 % must be 0 to 10000, not 10001"),
        (Proportional(None, 0x10000, 0), "communication number must be 0 to 65535"),
        (Identify(1), "no identification: read the registers that tell the type"),
    ],
)
def test_what_the_protocol_has_not_is_refused_by_every_method(request_: Request, message: str) -> None:
    """The message says what is wrong and what would be right; nothing is sent."""
    for method in (CODEC.encode, CODEC.answering, CODEC.answer_size, CODEC.least_answer, CODEC.decoder):
        with pytest.raises(NoSuchForm, match=message):
            method(request_)
