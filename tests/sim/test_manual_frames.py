from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from gateway.sim.modbus import is_whole
from tests.frames import FRAMES, MISPRINTED, RTU, Frame
from tests.sim.rig import Rig

EXAMPLE_READ = {f"block_read_{place}": place for place in range(1, 6)}
EXAMPLE_WRITE = {"block_write_1": 1, "block_write_2": 3}
OUTPUTS = {"output_function_1": 4, "output_function_3": 10}


def at_60_hertz(**options: Any) -> Rig:
    """Return a drive at 60 Hz that reads what the manual prints: E404H, 0.00 %, 99.83 %, alarm 0080H."""
    rig = Rig(running_at=60.0, **options)
    shown = {"status": 0xE404, "output_current": 0, "output_voltage": 0x26FF, "alarm": 0x0080}
    for name, word in shown.items():
        rig.drive.force(name, word)
    return rig


def plain(presets: dict[str, int] | None = None, model: str = "vf-nc3") -> Rig:
    """Return a standing drive with some parameters set."""
    return Rig(model, presets=presets or {})


NC3_IDENTITY = (
    "01 2B 0E 01 01 00 00 03 00 07 54 4F 53 48 49 42 41 01 0B"
    " 56 46 6E 43 33 2D 32 30 30 37 50 02 04 30 31 30 30 38 2C"
)

EXCHANGES: list[tuple[str, str, Callable[[], Rig]]] = [
    ("01 03 FD 00 00 01 B5 A6", "01 03 02 17 70 B6 50", lambda: Rig(running_at=60.0)),
    ("01 03 FD 00 00 02 F5 A7", "01 83 03 01 31", plain),
    (
        "01 03 18 75 00 05 92 B3",
        "01 03 0A E4 04 17 70 00 00 26 FF 00 80 58 00",
        lambda: at_60_hertz(presets=EXAMPLE_READ),
    ),
    ("01 03 18 75 00 02 D3 71", "01 03 04 E4 04 17 70 83 16", lambda: at_60_hertz(presets=EXAMPLE_READ)),
    ("01 03 18 75 00 02 D3 71", "01 03 04 00 00 17 70 F4 27", lambda: at_60_hertz(presets={"block_read_2": 2})),
    ("01 03 18 75 00 06 D2 B2", "01 83 03 01 31", lambda: plain(EXAMPLE_READ)),
    ("01 03 18 76 00 02 23 71", "01 83 03 01 31", lambda: plain(EXAMPLE_READ)),
    ("01 03 01 30 00 05 84 3A", "01 03 0A 00 04 80 00 00 0A 80 00 80 00 CE 17", lambda: plain(OUTPUTS)),
    (
        "01 03 01 30 00 05 84 3A",
        "01 03 0A 00 04 00 06 00 0A 80 00 80 00 A0 77",
        lambda: plain(OUTPUTS | {"output_function_2": 6}, "vf-mb1"),
    ),
    ("01 06 FA 01 17 70 E6 C6", "01 06 FA 01 17 70 E6 C6", plain),
    ("01 06 FF FF 00 00 89 EE", "01 86 02 C3 A1", plain),
    ("01 10 FA 01 00 01 02 17 70 F3 9A", "01 10 FA 01 00 01 60 D1", plain),
    ("01 10 18 70 00 02 04 C4 00 17 70 6D AF", "01 10 18 70 00 02 46 B3", lambda: plain(EXAMPLE_WRITE)),
    ("01 10 18 70 00 02 04 C4 00 17 70 6D AF", "01 90 04 4D C3", plain),
    ("01 10 18 71 00 02 04 C4 00 17 70 AC 63", "01 90 03 0C 01", lambda: plain(EXAMPLE_WRITE)),
    ("01 10 18 70 00 03 04 C4 00 17 70 6C 7E", "01 90 03 0C 01", lambda: plain(EXAMPLE_WRITE)),
    ("01 2B 0E 01 00 70 77", NC3_IDENTITY, lambda: Rig(capacity="VFnC3-2007P")),
]


@pytest.mark.parametrize(("request_", "response", "make"), EXCHANGES)
def test_a_drive_answers_as_the_manual_prints_it(request_: str, response: str, make: Callable[[], Rig]) -> None:
    """Each printed MODBUS-RTU request gets the printed answer from a drive that is set as the example says."""
    answer = make().send(bytes.fromhex(request_))
    assert answer == bytes.fromhex(response)


def test_every_printed_modbus_frame_is_answered_or_is_an_answer() -> None:
    """No MODBUS-RTU frame of the manuals is left out here but the misprinted one, which has its own test."""
    used = {request for request, _, _ in EXCHANGES} | {response for _, response, _ in EXCHANGES}
    printed = {frame.hex for frame in FRAMES if frame.protocol == RTU} - set(MISPRINTED)
    assert printed == used


def test_the_misprinted_identification_is_answered_with_the_right_check() -> None:
    """VF-MB1's printed identification has a wrong CRC: the drive sends its bytes with B6 0C behind them."""
    rig = Rig("vf-mb1", capacity="VFMB1S-2004PL", version=102)
    printed = bytes.fromhex(MISPRINTED[0])
    assert rig.send(bytes.fromhex("01 2B 0E 01 00 70 77")) == printed[:-2] + b"\xb6\x0c"


@pytest.mark.parametrize("frame", [frame for frame in FRAMES if frame.protocol == RTU], ids=lambda frame: frame.hex)
def test_the_check_of_a_printed_frame_is_as_printed(frame: Frame) -> None:
    """The simulation's CRC agrees with every printed frame but the misprinted one."""
    assert is_whole(frame.data) == (frame.hex not in MISPRINTED)


@pytest.mark.parametrize("frame", [frame for frame in FRAMES if frame.protocol != RTU], ids=lambda frame: frame.hex)
def test_frames_of_the_other_protocol_get_no_answer(frame: Frame) -> None:
    """A drive set to MODBUS-RTU is silent to what the TOSHIBA protocol sends."""
    assert Rig(number=47).send(frame.data) is None


@pytest.mark.parametrize("exchange", EXCHANGES, ids=lambda exchange: exchange[0])
def test_a_damaged_frame_gets_no_answer(exchange: tuple[str, str, Callable[[], Rig]]) -> None:
    """Every truncation, and junk behind or before the frame, keeps the drive silent."""
    request, _, make = exchange
    frame, rig = bytes.fromhex(request), make()
    damaged = [frame[:size] for size in range(len(frame))] + [frame + b"\x00", b"\x00" + frame]
    assert [rig.send(piece) for piece in damaged] == [None] * len(damaged)
