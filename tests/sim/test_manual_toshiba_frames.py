from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from gateway.drives.register import Kind, Register, Storage
from gateway.sim import toshiba_ascii, toshiba_binary
from tests.frames import ASCII, BINARY, FRAMES, Frame
from tests.sim.rig import Rig, binary, checked, models

ERR5 = 0x18
EXAMPLE = {f"block_read_{place}": place for place in range(1, 6)} | {"block_write_1": 1, "block_write_2": 3}


def plain(number: int = 1, **options: Any) -> Rig:
    """Return a standing drive that is set to TOSHIBA."""
    return Rig(number=number, protocol="toshiba", **options)


def running(**forced: int) -> Rig:
    """Return a drive at 60 Hz, its block set as in 4.1.3, with some registers forced."""
    rig = plain(running_at=60.0, presets=EXAMPLE)
    for name, word in forced.items():
        rig.drive.force(name, word)
    return rig


def tripped() -> Rig:
    """Return a drive that has tripped with Err5."""
    rig = plain()
    rig.drive.inverter.trip(ERR5)
    return rig


def with_a_current_of_1915() -> Rig:
    """Return a drive whose FE03 reads 19.15 %."""
    rig = plain()
    rig.drive.force("trip_output_current", 1915)
    return rig


def with_number_1234() -> Rig:
    """Return a drive that has what the manual's example writes to, and the catalogue does not: 1234H."""
    nc3 = models()["vf-nc3"]
    extra = Register("extra", 0x1234, Kind.PARAMETER, "E6581657 4.1.1", is_writable=True, storage=Storage.EEPROM)
    return Rig(replace(nc3, registers={**nc3.registers, "extra": extra}), protocol="toshiba")


def showing_data() -> Rig:
    """Return a drive that shows "dAtA" by communication, its block for the display (7.3.1)."""
    return plain(presets={"standard_monitor": 18, "led_selection": 1, "block_mode": 1})


Exchange = tuple[bytes, bytes | None, Callable[[], Rig]]


def ascii_(request: str, response: str, make: Callable[[], Rig] = plain) -> Exchange:
    """Return an exchange in ASCII, from what stands between start and stop code."""
    return f"({request})\r".encode(), f"({response})\r".encode(), make


def hex_(request: str, response: str | None, make: Callable[[], Rig] = plain) -> Exchange:
    """Return an exchange in binary; None for silence."""
    return bytes.fromhex(request), None if response is None else bytes.fromhex(response), make


def echoed(frame: str) -> Exchange:
    """Return an exchange whose answer is as its request."""
    return ascii_(frame, frame) if frame[0].isalpha() else hex_(frame, frame)


EXCHANGES: list[Exchange] = [
    echoed("W00100064"),
    echoed("PFA009000"),
    echoed("PFA011770"),
    echoed("PFA00C400"),
    ascii_("RFE03", "RFE03077B", with_a_current_of_1915),
    ascii_("RFD00", "RFD001770", running),
    ascii_("RFD01", "rFD010003", tripped),
    ascii_("RFC90", "rFC900018", tripped),
    ascii_("W08030", "W08030000"),
    ascii_("W123412", "W12340012", with_number_1234),
    ascii_("R0000&60", "R00000000&20"),
    (checked("W00000001"), b"(N0000&5C)\r", running),
    (checked("W08040003"), b"(N0001&5D)\r", plain),
    (checked("R0131"), b"(N0002&5E)\r", plain),
    (checked("L0000"), b"(N0003&5F)\r", plain),
    ascii_("R0000&61", "N0004&60"),
    ascii_("*2R0000", "02R00000000", lambda: plain(2)),
    ascii_("**PFA011770", "00PFA011770", lambda: plain(0)),
    ascii_("*9PFA011770", "09PFA011770", lambda: plain(9)),
    hex_("2F 58 02 05 C4 00 17 70 D9", "2F 59 05 03 00 00 00 00 00 00 00 00 00 00 90"),
    hex_(
        "2F 58 02 05 C4 00 17 70 D9",
        "2F 59 05 00 40 00 00 00 00 00 00 00 00 00 CD",
        lambda: plain(presets=EXAMPLE),
    ),
    hex_(
        "2F 58 02 05 C4 00 17 70 D9",
        "2F 59 05 00 64 00 17 70 1A 8A 24 FD 00 00 3D",
        lambda: running(output_current=0x1A8A, output_voltage=0x24FD),
    ),
    hex_("2F 58 02 05 C4 00 17 70 D8", "2F 4E 00 04 81"),
    (binary("57 0000 0001"), bytes.fromhex("2F 4E 00 00 7D"), running),
    (binary("57 0804 0003"), bytes.fromhex("2F 4E 00 01 7E"), plain),
    (binary("52 0131"), bytes.fromhex("2F 4E 00 02 7F"), plain),
    echoed("2F 57 00 10 00 64 FA"),
    echoed("2F 50 FA 00 90 00 09"),
    echoed("2F 50 FA 01 17 70 01"),
    echoed("2F 50 FA 00 C4 00 3D"),
    hex_("2F 52 FE 03 82", "2F 52 FE 03 07 7B 04", with_a_current_of_1915),
    hex_("2F 47 FE 03 00 00 77", "2F 47 FE 03 07 7B F9", with_a_current_of_1915),
    hex_("2F 52 FD 00 7E", "2F 52 FD 00 17 70 05", running),
    hex_("2F 52 FD 01 7F", "2F 72 FD 01 00 03 A2", tripped),
    hex_("2F 52 FC 90 0D", "2F 72 FC 90 00 18 45", tripped),
    hex_("2F 53 FA 01 13 88 18", None, lambda: Rig("vf-mb1", protocol="toshiba")),
    hex_(
        "2F 58 05 05 00 30 00 31 00 32 00 33 00 03 5A",
        "2F 59 05 00 00 64 00 41 00 74 00 41 00 00 E7",
        showing_data,
    ),
]


@pytest.mark.parametrize(("request_", "response", "make"), EXCHANGES)
def test_a_drive_answers_as_the_manual_prints_it(
    request_: bytes, response: bytes | None, make: Callable[[], Rig]
) -> None:
    """Each printed TOSHIBA request gets the printed answer from a drive that is set as the example says."""
    assert make().send(request_) == response


def test_every_printed_toshiba_frame_is_answered_or_is_an_answer() -> None:
    """No TOSHIBA frame of the manuals is left out here."""
    used = {frame for request, response, _ in EXCHANGES for frame in (request, response)}
    printed = {frame.data for frame in FRAMES if frame.protocol in (ASCII, BINARY)}
    assert printed <= used


@pytest.mark.parametrize(
    "frame", [frame for frame in FRAMES if frame.direction == "request"], ids=lambda frame: frame.hex
)
def test_the_check_of_a_printed_request_is_as_printed(frame: Frame) -> None:
    """Each request is whole in its own mode, but the one printed with a wrong checksum, and in no other."""
    is_right = frame.hex != "2F 58 02 05 C4 00 17 70 D8"
    assert toshiba_ascii.is_whole(frame.data) == (frame.protocol == ASCII)
    assert toshiba_binary.is_whole(frame.data) == (frame.protocol == BINARY and is_right)


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda exchange: exchange[0].hex())
def test_a_damaged_frame_gets_no_answer(exchange: Exchange) -> None:
    """Every truncation, and junk behind or before the frame, keeps the drive silent."""
    frame, _, make = exchange
    rig = make()
    damaged = [frame[:size] for size in range(len(frame))] + [frame + b"\x00", b"\x00" + frame, frame + frame]
    assert [rig.send(piece) for piece in damaged] == [None] * len(damaged)


def test_the_emergency_stop_is_answered_in_upper_case_and_all_that_follows_in_lower_case() -> None:
    """As printed, (PFA009000) answers (PFA009000): the drive trips by it, and its next answer says so."""
    rig = plain()
    assert rig.tell("PFA009000") == "PFA009000"
    assert rig.tell("PFA009000") == "pFA009000"
    assert rig.tell("RFC90") == "rFC900011"
