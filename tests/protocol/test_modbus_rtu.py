"""MODBUS-RTU: what it has and has not, whom it addresses, and what its answers must repeat."""

from __future__ import annotations

import pytest

from gateway.errors import Refusal
from gateway.protocol.codec import Answering, Forms, NoSuchForm
from gateway.protocol.modbus_rtu import LONGEST_IDENTITY, ModbusRtu
from gateway.protocol.pdu import (
    EVERY_DRIVE,
    Exchange,
    Exchanged,
    Group,
    Identify,
    Identity,
    Proportional,
    ReadBlock,
    ReadWords,
    Request,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)
from gateway.protocol.registry import PROTOCOLS
from tests.protocol.drive_side import Content, Denied, Heard, crc, heard
from tests.protocol.modbus_dialect import Rtu

CODEC = ModbusRtu()
BY_10H = ModbusRtu(writes_by_10h=True)
FAULT_RESET = WriteRam(1, 0xFA00, 0xA000, is_answered=False)
EXCHANGE = Exchange(1, 0x1875, 5, 0x1870, (0xC400, 6000))


def sealed(printed: str) -> bytes:
    """Return a frame from its bytes without CRC."""
    body = bytes.fromhex(printed)
    return body + crc(body)


def hear(request: Request, *frames: bytes, codec: ModbusRtu = CODEC) -> list[Heard]:
    """Return what frames and the silence behind them say to a request."""
    return heard(codec.decoder(request), [*frames, b""])


def test_what_the_protocol_has() -> None:
    """E6581657 5.1; no write that spares the EEPROM, and no word on a trip in an answer."""
    assert CODEC.forms == Forms(
        range(1, 248),
        has_direct_block=True,
        has_block=True,
        has_exchange=True,
        writes_all_or_none=True,
        has_identification=True,
    )
    assert PROTOCOLS[CODEC.name] == CODEC


def test_the_exchange_is_17_bytes_long() -> None:
    """17H: read from 1875H, write two words to 1870H, four bytes; no manual prints one."""
    assert CODEC.encode(EXCHANGE) == sealed("01 17 18 75 00 05 18 70 00 02 04 C4 00 17 70")
    assert len(CODEC.encode(EXCHANGE)) == 17
    answer = sealed("01 17 0A E4 04 17 70 00 00 26 FF 00 80")
    assert hear(EXCHANGE, answer) == [Exchanged((0xE404, 6000, 0, 0x26FF, 0x80))]
    assert hear(EXCHANGE, sealed("01 97 03")) == [Denied(Refusal.RANGE, None)]


@pytest.mark.parametrize("request_", [WriteRam(1, 0xFA01, 6000), WriteStored(1, 0xFA01, 6000)])
def test_a_single_write_is_06h_or_10h(request_: Request) -> None:
    """The two forms of E6581657 5.1.4."""
    assert CODEC.encode(request_) == sealed("01 06 FA 01 17 70")
    assert BY_10H.encode(request_) == sealed("01 10 FA 01 00 01 02 17 70")


@pytest.mark.hazard("H16")
@pytest.mark.parametrize(
    "wrong", ["02 06 FA 01 17 70", "01 06 FA 00 17 70", "01 06 FA 01 17 71", "01 86 FA 01 17 70"]
)
def test_an_answer_to_06h_repeats_number_address_and_word(wrong: str) -> None:
    """Any other word or address is not this write's."""
    assert hear(WriteRam(1, 0xFA01, 6000), sealed(wrong)) == []


@pytest.mark.hazard("H16")
@pytest.mark.parametrize(
    "wrong",
    ["02 10 18 70 00 02", "01 10 18 71 00 02", "01 10 18 70 00 01", "01 06 18 70 00 02"],
)
def test_an_answer_to_10h_repeats_number_address_and_count(wrong: str) -> None:
    """Any other address or count is not this write's."""
    request = WriteBlock(1, 0x1870, (1, 2))
    assert hear(request, sealed(wrong)) == []
    assert hear(request, sealed("01 10 18 70 00 02")) == [Written()]


@pytest.mark.hazard("H16")
@pytest.mark.parametrize(
    "wrong",
    ["02 03 04 00 01 00 02", "01 03 02 00 01", "01 17 04 00 01 00 02", "01 03 04 00 01 00"],
)
def test_an_answer_to_03h_repeats_number_and_count(wrong: str) -> None:
    """The byte count is twice the words asked for."""
    assert hear(ReadWords(1, 0xFD00, 2), sealed(wrong)) == []


@pytest.mark.hazard("H15")
def test_the_echo_of_10h_is_not_its_answer_even_where_its_beginning_is_one() -> None:
    """The first eight bytes of this very request are a sound answer; silence decides for the answer."""
    number, address, word = 1, *_write_that_begins_as_its_answer()
    request = WriteRam(number, address, word)
    echo = BY_10H.encode(request)
    answer = Rtu(writes_by_10h=True).frame(request, Content())
    assert echo.startswith(answer)
    assert hear(request, echo, codec=BY_10H) == []
    assert hear(request, echo, answer, codec=BY_10H) == [Written()]
    decoder = BY_10H.decoder(request)
    assert heard(decoder, [answer]) == []
    assert heard(decoder, [b""]) == [Written()]


def _write_that_begins_as_its_answer() -> tuple[int, int]:
    for address in range(0x10000):
        low, high = sealed(f"01 10 {address:04X} 00 01")[-2:]
        if low == 2:  # the byte count of the request stands there
            return address, high << 8
    raise AssertionError("one address in 256 has such an answer")


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        (1, Refusal.COMMAND),
        (2, Refusal.ADDRESS),
        (3, Refusal.RANGE),
        (4, Refusal.UNABLE),
        (0, Refusal.OTHER),
        (9, Refusal.OTHER),
    ],
)
@pytest.mark.parametrize(
    ("request_", "function"),
    [
        (ReadWords(1, 0xFD00), 0x83),
        (WriteRam(1, 0xFA00, 0), 0x86),
        (FAULT_RESET, 0x86),
        (WriteBlock(1, 0x1870, (0, 0)), 0x90),
        (EXCHANGE, 0x97),
        (Identify(1), 0xAB),
    ],
)
def test_error_codes_are_refusals(request_: Request, function: int, code: int, reason: Refusal) -> None:
    """E6581657 5.3: the function and 80H, error codes 01 to 04."""
    assert hear(request_, sealed(f"01 {function:02X} {code:02X}")) == [Denied(reason, None)]
    assert hear(request_, sealed(f"01 {function ^ 1:02X} {code:02X}")) == []


class TestEveryDrive:
    @pytest.mark.parametrize(
        ("request_", "printed"),
        [
            (WriteRam(EVERY_DRIVE, 0xFA01, 6000), "00 06 FA 01 17 70"),
            (WriteStored(EVERY_DRIVE, 0x0010, 100), "00 06 00 10 00 64"),
            (WriteBlock(EVERY_DRIVE, 0x1870, (0xC400, 6000)), "00 10 18 70 00 02 04 C4 00 17 70"),
        ],
    )
    def test_is_written_to_by_number_0_and_never_answers(self, request_: Request, printed: str) -> None:
        """E6581657 5: no response is returned by any inverter."""
        frame = CODEC.encode(request_)
        assert frame == sealed(printed)
        assert CODEC.answering(request_) is Answering.NEVER
        assert (CODEC.answer_size(request_), CODEC.least_answer(request_)) == (0, 0)
        assert hear(request_, frame, sealed("00 86 02")) == []

    @pytest.mark.parametrize(
        "request_",
        [
            ReadWords(EVERY_DRIVE, 0xFD00),
            ReadBlock(EVERY_DRIVE, 0x1875, 2),
            Exchange(EVERY_DRIVE, 0x1875, 2, 0x1870, (0, 0)),
            Identify(EVERY_DRIVE),
        ],
    )
    def test_is_not_read(self, request_: Request) -> None:
        """Nobody would answer."""
        with pytest.raises(NoSuchForm, match="number 0 is for writes only"):
            CODEC.encode(request_)


@pytest.mark.hazard("H09")
def test_a_fault_reset_is_only_refused() -> None:
    """What looks like its answer can only be the adapter's echo."""
    assert CODEC.answering(FAULT_RESET) is Answering.MAYBE
    assert (CODEC.answer_size(FAULT_RESET), CODEC.least_answer(FAULT_RESET)) == (0, 5)
    assert hear(FAULT_RESET, CODEC.encode(FAULT_RESET)) == []
    assert hear(FAULT_RESET, CODEC.encode(FAULT_RESET) + sealed("01 86 04")) == [Denied(Refusal.UNABLE, None)]


class TestIdentification:
    @pytest.mark.parametrize("code", range(4))
    def test_has_four_read_codes_and_answers_with_the_one_asked_for(self, code: int) -> None:
        """E6581657 5.1.7; the VF-MB1 manual prints the CRC of code 00."""
        assert CODEC.encode(Identify(1, code)) == sealed(f"01 2B 0E {code:02X} 00")
        answer = Rtu().frame(Identify(1, code), Content())
        assert hear(Identify(1, code), answer) == [Identity("TOSHIBA", "VFnC3-2007P", "0100")]
        assert hear(Identify(1, (code + 1) % 4), answer) == []

    @pytest.mark.parametrize(
        ("fixed", "what"),
        [
            ("00 00 00 03", "conformity"),
            ("01 FF 00 03", "more frames"),
            ("01 00 03 03", "next object"),
            ("01 00 00 02", "count"),
        ],
    )
    def test_must_have_its_fixed_bytes(self, fixed: str, what: str) -> None:
        """Conformity 01, no more frames, no next object, three objects."""
        assert hear(Identify(1), sealed(f"01 2B 0E 01 {fixed} 00 01 41 01 01 42 02 01 43")) == [], what
        assert hear(Identify(1), sealed("01 2B 0E 01 01 00 00 03 00 01 41 01 01 42 02 01 43")) != []

    @pytest.mark.parametrize(
        "objects", ["01 01 41 00 01 42 02 01 43", "00 01 41 01 01 42", "00 01 41 01 01 80 02 01 43"]
    )
    def test_must_have_three_objects_of_ascii_text_in_order(self, objects: str) -> None:
        """Vendor, device, version."""
        assert hear(Identify(1), sealed(f"01 2B 0E 01 01 00 00 03 {objects}")) == []

    def test_is_not_waited_for_when_it_says_that_it_is_too_long(self) -> None:
        """A broken length byte does not hold up the answer behind it."""
        answer = Rtu().frame(Identify(1), Content())
        assert heard(CODEC.decoder(Identify(1)), [answer[:9] + b"\xff" + answer]) != []
        device = b"A" * (LONGEST_IDENTITY - 27)
        longest = Rtu().frame(Identify(1), Content(texts=(b"TOSHIBA", device, b"0100")))
        assert len(longest) == LONGEST_IDENTITY == CODEC.answer_size(Identify(1))
        assert hear(Identify(1), longest) == [Identity("TOSHIBA", device.decode(), "0100")]
        longer = Rtu().frame(Identify(1), Content(texts=(b"TOSHIBA", device + b"A", b"0100")))
        assert hear(Identify(1), longer) == []


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (ReadWords(0, 0xFD00), "inverter number must be 1 to 247, not 0"),
        (ReadWords(248, 0xFD00), "inverter number must be 1 to 247, not 248"),
        (ReadWords(None, 0xFD00), "needs an inverter number"),
        (WriteRam(Group(None, 2), 0xFA01, 0), "there is only the group of all drives"),
        (ReadWords(1, 0xFD00, 0), "count of a direct read must be 1 to 8, not 0"),
        (ReadWords(1, 0xFD00, 9), "count of a direct read must be 1 to 8, not 9"),
        (ReadWords(1, 0xFFFF, 2), "last communication number of a read must be 0 to 65535, not 65536"),
        (ReadWords(1, -1), "last communication number of a read must be 0 to 65535, not -1"),
        (ReadBlock(1, 0x1875, 1), "count of a block read must be 2 to 5, not 1"),
        (ReadBlock(1, 0x1875, 6), "count of a block read must be 2 to 5, not 6"),
        (ReadBlock(1, 0x10000, 2), "communication number must be 0 to 65535"),
        (WriteRam(1, 0x10000, 0), "communication number must be 0 to 65535"),
        (WriteRam(1, 0xFA01, 0x10000), r"word must be 0 to 65535 \(FFFFH\), not 65536"),
        (WriteStored(1, 0xFA01, -1), "word must be 0 to 65535"),
        (WriteBlock(1, 0x1870, (1,)), "count of a block write must be 2, not 1"),
        (WriteBlock(1, 0x1870, (1, 2, 3)), "count of a block write must be 2, not 3"),
        (WriteBlock(1, 0x1870, (1, 0x10000)), "word must be 0 to 65535"),
        (Exchange(1, 0x1875, 6, 0x1870, (1, 2)), "count of a block read must be 2 to 5, not 6"),
        (Exchange(1, 0x1875, 5, 0x1870, (1,)), "count of a block write must be 2, not 1"),
        (Exchange(1, 0x1875, 5, 0x10000, (1, 2)), "communication number must be 0 to 65535"),
        (Identify(1, 4), "read code of an identification must be 0 to 3, not 4"),
        (Proportional(1, 0xFA01, 5000), "no proportional command: write the frequency"),
    ],
)
def test_what_the_protocol_has_not_is_refused_by_every_method(request_: Request, message: str) -> None:
    """The message says what is wrong and what would be right; nothing is sent."""
    for method in (CODEC.encode, CODEC.answering, CODEC.answer_size, CODEC.least_answer, CODEC.decoder):
        with pytest.raises(NoSuchForm, match=message):
            method(request_)
