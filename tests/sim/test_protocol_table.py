"""Cases of docs/protocols.md that no other test shows: numbers, refusals and trips in every protocol alike."""

from __future__ import annotations

from typing import Any

import pytest

from gateway.errors import Refusal
from gateway.protocol.codec import Codec, NoSuchForm
from gateway.protocol.pdu import Exchange, Identify, ReadWords, Request, WriteBlock, WriteRam, WriteStored
from gateway.protocol.registry import PROTOCOLS
from tests.protocol.drive_side import Denied, Heard, heard
from tests.sim.rig import Rig

ONE_BYTE = range(256)
BEYOND = range(256, 300)
SELECTED = {"block_read_1": 1, "block_read_2": 2, "block_write_1": 1, "block_write_2": 3}
every_protocol = pytest.mark.parametrize("codec", PROTOCOLS.values(), ids=PROTOCOLS)


def drive(codec: Codec, **options: Any) -> Rig:
    """Return a drive that speaks a protocol."""
    return Rig(protocol="modbus-rtu" if codec.name == "modbus-rtu" else "toshiba", **options)


def exchange(rig: Rig, codec: Codec, request: Request) -> Heard | None:
    """Send what the gateway sends; return what it makes of the answer and the silence behind it, None for silence."""
    answer = rig.send(codec.encode(request))
    said = heard(codec.decoder(request), [answer or b"", b""])
    assert len(said) == (answer is not None)
    return said[0] if said else None


@every_protocol
def test_the_numbers_that_the_gateway_addresses_are_those_that_answer(codec: Codec) -> None:
    """ASCII 00 to 99, binary 00H to 3FH, MODBUS-RTU 1 to 247; no other number has a frame."""
    for number in (*ONE_BYTE, *BEYOND):
        request = ReadWords(number, 0xFB07)
        if number in codec.forms.numbers:
            said = exchange(drive(codec, number=number), codec, request)
            assert said is not None
            assert not isinstance(said, Denied)
        else:
            with pytest.raises(NoSuchForm, match="inverter number must be"):
                codec.encode(request)


@every_protocol
def test_a_password_that_is_set_is_not_overwritten(codec: Codec) -> None:
    """F738 with a value in it refuses another as impossible to execute (4.3, 5.3)."""
    rig = drive(codec, presets={"password": 1234})
    said = exchange(rig, codec, WriteStored(1, 0x0738, 0))
    assert isinstance(said, Denied)
    assert said.reason is Refusal.UNABLE
    assert rig.word("password") == 1234


@every_protocol
@pytest.mark.parametrize(
    ("model", "code", "is_read"),
    [("vf-nc3", 2, True), ("vf-nc3", 4, True), ("vf-mb1", 2, True), ("vf-mb1", 4, False)],
)
def test_f700_inhibits_parameters_and_nothing_else(codec: Codec, model: str, code: int, is_read: bool) -> None:
    """2: writing; 4, which only VF-MB1 has: reading too (4.3, 5.3). Commands and monitors are as ever."""
    rig = drive(codec, model=model, presets={"write_protection": code})
    is_written = (model, code) == ("vf-nc3", 4)
    for request, is_done in (
        (WriteStored(1, 0x0880, 7), is_written),
        (ReadWords(1, 0x0880), is_read),
        (ReadWords(1, 0xFD00), True),
        (WriteRam(1, 0xFA01, 100), True),
    ):
        said = exchange(rig, codec, request)
        assert said is not None
        assert (not isinstance(said, Denied)) == is_done
        assert is_done or (isinstance(said, Denied) and said.reason is Refusal.UNABLE)


@every_protocol
def test_only_toshiba_answers_tell_of_a_trip(codec: Codec) -> None:
    """Each kind of answer of a tripped drive, and of one that is not: small letters, large ones; MODBUS-RTU none."""
    requests: list[Request] = [
        ReadWords(1, 0xFD00),
        WriteRam(1, 0xFA01, 100),
        WriteStored(1, 0x0880, 1),
        ReadWords(1, 0x0131),
    ]
    if codec.forms.has_exchange:
        requests += [Exchange(1, 0x1875, 2, 0x1870, (0, 0)), WriteBlock(1, 0x1870, (0, 0))]
    if codec.forms.has_identification:
        requests.append(Identify(1))
    for is_tripped in (False, True):
        rig = drive(codec, presets=SELECTED)
        if is_tripped:
            rig.drive.inverter.trip(0x18)
        for request in requests:
            said = exchange(rig, codec, request)
            assert said is not None
            assert said.is_tripped is (is_tripped if codec.forms.says_tripped else None)


@pytest.mark.parametrize("body", ["10 FA01 0001 02 0BB8", "10 1870 0002 04 8400 0BB8", "06 FA01 0BB8"])
def test_every_write_of_modbus_to_number_0_is_obeyed_in_silence(body: str) -> None:
    """One word by 06H and 10H, two words to 1870H."""
    rig = Rig(presets=SELECTED)
    assert rig.ask(body, number=0) is None
    assert rig.word("frequency_command") == 3000


@pytest.mark.parametrize(
    "body", ["03 FD00 0001", "03 1875 0002", "2B 0E 01 00", "17 1875 0002 1870 0002 04 0000 0000"]
)
def test_a_read_of_modbus_from_number_0_is_not_answered(body: str) -> None:
    """Nor is 17H, whose write is done."""
    assert Rig(presets=SELECTED).ask(body, number=0) is None


@pytest.mark.parametrize("size", range(1, 11))
def test_a_block_frame_that_breaks_off_is_not_answered_and_does_nothing(size: int) -> None:
    """The manual gives the rest a second (4.1.3); the silence has ended the frame long before."""
    rig = drive(PROTOCOLS["toshiba-binary"], presets=SELECTED)
    frame = PROTOCOLS["toshiba-binary"].encode(Exchange(1, 0x1875, 2, 0x1870, (0x8400, 3000)))
    assert len(frame) == 10
    assert (rig.send(frame[:size]) is None) == (size < len(frame))
    assert rig.word("frequency_command") == (3000 if size == len(frame) else 0)


@every_protocol
def test_a_drive_hears_nothing_for_a_second_after_the_power_is_on(codec: Codec) -> None:
    """About one second until the initial setting is completed (E6581657 4, 5)."""
    rig = drive(codec)
    rig.drive.inverter.reset(rig.now)
    request = ReadWords(1, 0xFD00)
    rig.wait(0.99)
    assert exchange(rig, codec, request) is None
    rig.wait(0.02)
    assert exchange(rig, codec, request) is not None
