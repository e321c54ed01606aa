"""The frames that the manuals print, with the requests that make them and the replies that they are."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.errors import Refusal
from gateway.protocol.codec import Codec
from gateway.protocol.modbus_rtu import ModbusRtu
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
    Words,
    WriteBlock,
    WriteRam,
    WriteStored,
    Written,
)
from gateway.protocol.toshiba_ascii import ToshibaAscii
from gateway.protocol.toshiba_binary import ToshibaBinary
from tests.protocol.drive_side import Denied, Heard, heard

RTU = ModbusRtu()
RTU_10H = ModbusRtu(writes_by_10h=True)
BINARY = ToshibaBinary()
BINARY_G = ToshibaBinary(reads_by_g=True)
SUMMED = ToshibaAscii()
PLAIN = ToshibaAscii(has_checksum=False)


def text(line: str) -> str:
    """Return the hexadecimal digits of an ASCII frame, as the manuals print it without the carriage return."""
    return (line + "\r").encode().hex(" ").upper()


RUN_60_HZ = (0xC400, 6000)
REQUESTS: dict[str, tuple[Codec, Request]] = {
    "01 03 FD 00 00 01 B5 A6": (RTU, ReadWords(1, 0xFD00)),
    "01 03 FD 00 00 02 F5 A7": (RTU, ReadWords(1, 0xFD00, 2)),
    "01 03 18 75 00 05 92 B3": (RTU, ReadBlock(1, 0x1875, 5)),
    "01 03 18 75 00 02 D3 71": (RTU, ReadBlock(1, 0x1875, 2)),
    "01 03 18 75 00 06 D2 B2": (RTU, ReadWords(1, 0x1875, 6)),
    "01 03 18 76 00 02 23 71": (RTU, ReadBlock(1, 0x1876, 2)),
    "01 03 01 30 00 05 84 3A": (RTU, ReadWords(1, 0x0130, 5)),
    "01 06 FA 01 17 70 E6 C6": (RTU, WriteRam(1, 0xFA01, 6000)),
    "01 06 FF FF 00 00 89 EE": (RTU, WriteStored(1, 0xFFFF, 0)),
    "01 10 FA 01 00 01 02 17 70 F3 9A": (RTU_10H, WriteRam(1, 0xFA01, 6000)),
    "01 10 18 70 00 02 04 C4 00 17 70 6D AF": (RTU, WriteBlock(1, 0x1870, RUN_60_HZ)),
    "01 10 18 71 00 02 04 C4 00 17 70 AC 63": (RTU, WriteBlock(1, 0x1871, RUN_60_HZ)),
    "01 2B 0E 01 00 70 77": (RTU, Identify(1)),
    "2F 58 02 05 C4 00 17 70 D9": (BINARY, Exchange(None, 0x1875, 5, 0x1870, RUN_60_HZ)),
    "2F 57 00 10 00 64 FA": (BINARY, WriteStored(None, 0x0010, 100)),
    "2F 50 FA 00 90 00 09": (BINARY, WriteRam(None, 0xFA00, 0x9000)),
    "2F 52 FE 03 82": (BINARY, ReadWords(None, 0xFE03)),
    "2F 47 FE 03 00 00 77": (BINARY_G, ReadWords(None, 0xFE03)),
    "2F 50 FA 01 17 70 01": (BINARY, WriteRam(None, 0xFA01, 6000)),
    "2F 50 FA 00 C4 00 3D": (BINARY, WriteRam(None, 0xFA00, 0xC400)),
    "2F 52 FD 00 7E": (BINARY, ReadWords(None, 0xFD00)),
    "2F 52 FD 01 7F": (BINARY, ReadWords(None, 0xFD01)),
    "2F 52 FC 90 0D": (BINARY, ReadWords(None, 0xFC90)),
    "2F 53 FA 01 13 88 18": (BINARY, Proportional(None, 0xFA01, 5000)),
    "2F 58 05 05 00 30 00 31 00 32 00 33 00 03 5A": (BINARY, Exchange(None, 0, 5, 0, (0x30, 0x31, 0x32, 0x33, 3))),
    text("(W00100064)"): (PLAIN, WriteStored(None, 0x0010, 100)),
    text("(PFA009000)"): (PLAIN, WriteRam(None, 0xFA00, 0x9000)),
    text("(RFE03)"): (PLAIN, ReadWords(None, 0xFE03)),
    text("(PFA011770)"): (PLAIN, WriteRam(None, 0xFA01, 6000)),
    text("(PFA00C400)"): (PLAIN, WriteRam(None, 0xFA00, 0xC400)),
    text("(RFD00)"): (PLAIN, ReadWords(None, 0xFD00)),
    text("(RFD01)"): (PLAIN, ReadWords(None, 0xFD01)),
    text("(RFC90)"): (PLAIN, ReadWords(None, 0xFC90)),
    text("(R0000&60)"): (SUMMED, ReadWords(None, 0)),
    text("(*2R0000)"): (PLAIN, ReadWords(Group(None, 2), 0)),
    text("(**PFA011770)"): (PLAIN, WriteRam(EVERY_DRIVE, 0xFA01, 6000)),
    text("(*9PFA011770)"): (PLAIN, WriteRam(Group(None, 9), 0xFA01, 6000)),
}
NOT_MADE = {  # by design: printed to show what a drive refuses, or how it reads less than four digits
    "01 10 18 70 00 03 04 C4 00 17 70 6C 7E": "three words announced, two given",
    "2F 58 02 05 C4 00 17 70 D8": "wrong checksum",
    text("(W08030)"): "one digit of data",
    text("(W123412)"): "two digits of data",
}

X = Exchange(None, 0x1875, 5, 0x1870, RUN_60_HZ)
REPLIES: list[tuple[Codec, Request, str, Heard]] = [
    (RTU, ReadWords(1, 0xFD00), "01 03 02 17 70 B6 50", Words((6000,))),
    (RTU, ReadWords(1, 0xFD00, 2), "01 83 03 01 31", Denied(Refusal.RANGE, None)),
    (
        RTU,
        ReadBlock(1, 0x1875, 5),
        "01 03 0A E4 04 17 70 00 00 26 FF 00 80 58 00",
        Words((0xE404, 6000, 0, 0x26FF, 0x80)),
    ),
    (RTU, ReadBlock(1, 0x1875, 2), "01 03 04 E4 04 17 70 83 16", Words((0xE404, 6000))),
    (RTU, ReadBlock(1, 0x1875, 2), "01 03 04 00 00 17 70 F4 27", Words((0, 6000))),
    (
        RTU,
        ReadWords(1, 0x0130, 5),
        "01 03 0A 00 04 80 00 00 0A 80 00 80 00 CE 17",
        Words((4, 0x8000, 10, 0x8000, 0x8000)),
    ),
    (
        RTU,
        ReadWords(1, 0x0130, 5),
        "01 03 0A 00 04 00 06 00 0A 80 00 80 00 A0 77",
        Words((4, 6, 10, 0x8000, 0x8000)),
    ),
    (RTU, WriteStored(1, 0xFFFF, 0), "01 86 02 C3 A1", Denied(Refusal.ADDRESS, None)),
    (RTU_10H, WriteRam(1, 0xFA01, 6000), "01 10 FA 01 00 01 60 D1", Written()),
    (RTU, WriteBlock(1, 0x1870, RUN_60_HZ), "01 10 18 70 00 02 46 B3", Written()),
    (RTU, WriteBlock(1, 0x1870, RUN_60_HZ), "01 90 04 4D C3", Denied(Refusal.UNABLE, None)),
    (RTU, WriteBlock(1, 0x1871, RUN_60_HZ), "01 90 03 0C 01", Denied(Refusal.RANGE, None)),
    (
        RTU,
        Identify(1),
        "01 2B 0E 01 01 00 00 03 00 07 54 4F 53 48 49 42 41 01 0B 56 46 6E 43 33 2D 32 30 30 37 50"
        " 02 04 30 31 30 30 38 2C",
        Identity("TOSHIBA", "VFnC3-2007P", "0100"),
    ),
    (BINARY, X, "2F 59 05 03 00 00 00 00 00 00 00 00 00 00 90", Exchanged((0,) * 5, (0, 1), False)),
    (BINARY, X, "2F 59 05 00 40 00 00 00 00 00 00 00 00 00 CD", Exchanged((0x4000, 0, 0, 0, 0), (), False)),
    (
        BINARY,
        X,
        "2F 59 05 00 64 00 17 70 1A 8A 24 FD 00 00 3D",
        Exchanged((0x6400, 6000, 6794, 9469, 0), (), False),
    ),
    (BINARY, X, "2F 4E 00 04 81", Denied(Refusal.CHECKSUM, False)),
    (BINARY, WriteStored(None, 0x0011, 1), "2F 4E 00 00 7D", Denied(Refusal.UNABLE, False)),
    (BINARY, WriteStored(None, 0x0011, 1), "2F 4E 00 01 7E", Denied(Refusal.RANGE, False)),
    (BINARY, WriteStored(None, 0x0011, 1), "2F 4E 00 02 7F", Denied(Refusal.ADDRESS, False)),
    (BINARY, ReadWords(None, 0xFE03), "2F 52 FE 03 07 7B 04", Words((1915,), False)),
    (BINARY_G, ReadWords(None, 0xFE03), "2F 47 FE 03 07 7B F9", Words((1915,), False)),
    (BINARY, ReadWords(None, 0xFD00), "2F 52 FD 00 17 70 05", Words((6000,), False)),
    (BINARY, ReadWords(None, 0xFD01), "2F 72 FD 01 00 03 A2", Words((3,), True)),
    (BINARY, ReadWords(None, 0xFC90), "2F 72 FC 90 00 18 45", Words((0x18,), True)),
    (
        BINARY,
        Exchange(None, 0, 5, 0, (0x30, 0x31, 0x32, 0x33, 3)),
        "2F 59 05 00 00 64 00 41 00 74 00 41 00 00 E7",
        Exchanged((0x64, 0x41, 0x74, 0x41, 0), (), False),
    ),
    (PLAIN, ReadWords(None, 0xFE03), text("(RFE03077B)"), Words((1915,), False)),
    (PLAIN, ReadWords(None, 0xFD00), text("(RFD001770)"), Words((6000,), False)),
    (PLAIN, ReadWords(None, 0xFD01), text("(rFD010003)"), Words((3,), True)),
    (PLAIN, ReadWords(None, 0xFC90), text("(rFC900018)"), Words((0x18,), True)),
    (PLAIN, WriteStored(None, 0x0803, 0), text("(W08030000)"), Written((), False)),
    (PLAIN, WriteStored(None, 0x1234, 0x12), text("(W12340012)"), Written((), False)),
    (SUMMED, ReadWords(None, 0), text("(N0000&5C)"), Denied(Refusal.UNABLE, False)),
    (SUMMED, ReadWords(None, 0), text("(N0001&5D)"), Denied(Refusal.RANGE, False)),
    (SUMMED, ReadWords(None, 0), text("(N0002&5E)"), Denied(Refusal.ADDRESS, False)),
    (SUMMED, ReadWords(None, 0), text("(N0003&5F)"), Denied(Refusal.COMMAND, False)),
    (SUMMED, ReadWords(None, 0), text("(N0004&60)"), Denied(Refusal.CHECKSUM, False)),
    (PLAIN, ReadWords(Group(None, 2), 0), text("(02R00000000)"), Words((0,), False)),
    (PLAIN, WriteRam(EVERY_DRIVE, 0xFA01, 6000), text("(00PFA011770)"), Written((), False)),
    (PLAIN, WriteRam(Group(None, 9), 0xFA01, 6000), text("(09PFA011770)"), Written((), False)),
]
COPIES = [  # answers that the manuals describe as the same bytes as the request
    (codec, request, printed, Written((), None if codec is RTU else False))
    for printed, (codec, request) in REQUESTS.items()
    if isinstance(request, WriteRam | WriteStored) and isinstance(request.number, int | None) and codec is not RTU_10H
]


@dataclass(frozen=True)
class Printed:
    """One printed answer, its request, and what it says."""

    codec: Codec
    request: Request
    frame: bytes
    said: Heard

    def hear(self, *pieces: bytes) -> list[Heard]:
        """Return what a fresh decoder makes of some pieces."""
        return heard(self.codec.decoder(self.request), pieces)


ANSWERS = [Printed(codec, request, bytes.fromhex(frame), said) for codec, request, frame, said in REPLIES + COPIES]
