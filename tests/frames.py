"""The worked example frames of the drive manuals (E6581657 and the VF-MB1 manual), one field per line."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame as printed: who sends it, its bytes, what it says."""

    protocol: str
    direction: str
    hex: str
    meaning: str

    @property
    def data(self) -> bytes:
        """Return the bytes of the frame."""
        return bytes.fromhex(self.hex)


RTU = "modbus-rtu"
BINARY = "toshiba-binary"
ASCII = "toshiba-ascii"

MISPRINTED = (  # printed with a checksum that is not the one of its bytes
    "01 2B 0E 01 01 00 00 03 00 07 54 4F 53 48 49 42 41 01 0D 56 46 4D 42 31 53 2D 32 30 30 34"
    " 50 4C 02 04 30 31 30 32 9A CC",
)

FRAMES = (
    Frame(
        RTU,
        "request",
        "01 03 FD 00 00 01 B5 A6",
        "read one word: output frequency FD00",
    ),
    Frame(
        RTU,
        "response",
        "01 03 02 17 70 B6 50",
        "60.00 Hz",
    ),
    Frame(
        RTU,
        "request",
        "01 03 FD 00 00 02 F5 A7",
        "read two words from FD00; this drive refuses it",
    ),
    Frame(
        RTU,
        "response",
        "01 83 03 01 31",
        "error 03: data range",
    ),
    Frame(
        RTU,
        "request",
        "01 03 18 75 00 05 92 B3",
        "indirect block, five words",
    ),
    Frame(
        RTU,
        "response",
        "01 03 0A E4 04 17 70 00 00 26 FF 00 80 58 00",
        "status E404H, 60.00 Hz, current 0.00 %, voltage 99.83 %, alarm 0080H",
    ),
    Frame(
        RTU,
        "request",
        "01 03 18 75 00 02 D3 71",
        "indirect block, two words",
    ),
    Frame(
        RTU,
        "response",
        "01 03 04 E4 04 17 70 83 16",
        "selectors 1 and 2 in force: status E404H, 60.00 Hz",
    ),
    Frame(
        RTU,
        "response",
        "01 03 04 00 00 17 70 F4 27",
        "selectors 0 and 2 in force: dummy, 60.00 Hz",
    ),
    Frame(
        RTU,
        "request",
        "01 03 18 75 00 06 D2 B2",
        "indirect block, six words; error 03 answers",
    ),
    Frame(
        RTU,
        "request",
        "01 03 18 76 00 02 23 71",
        "indirect block from 1876H; error 03 answers",
    ),
    Frame(
        RTU,
        "request",
        "01 03 01 30 00 05 84 3A",
        "direct block, five words from 0130H",
    ),
    Frame(
        RTU,
        "response",
        "01 03 0A 00 04 80 00 00 0A 80 00 80 00 CE 17",
        "a VF-nC3 answers: 0131H, 0133H and 0134H are holes",
    ),
    Frame(
        RTU,
        "response",
        "01 03 0A 00 04 00 06 00 0A 80 00 80 00 A0 77",
        "a VF-MB1 answers: 0133H and 0134H are holes",
    ),
    Frame(
        RTU,
        "request",
        "01 06 FA 01 17 70 E6 C6",
        "set the frequency command to 60.00 Hz; echoed as the answer",
    ),
    Frame(
        RTU,
        "request",
        "01 06 FF FF 00 00 89 EE",
        "write to FFFFH, which no drive has",
    ),
    Frame(
        RTU,
        "response",
        "01 86 02 C3 A1",
        "error 02: communication number",
    ),
    Frame(
        RTU,
        "request",
        "01 10 FA 01 00 01 02 17 70 F3 9A",
        "set the frequency command to 60.00 Hz by 10H",
    ),
    Frame(
        RTU,
        "response",
        "01 10 FA 01 00 01 60 D1",
        "done: one word from FA01",
    ),
    Frame(
        RTU,
        "request",
        "01 10 18 70 00 02 04 C4 00 17 70 6D AF",
        "block write: run forward by communication (C400H) at 60.00 Hz",
    ),
    Frame(
        RTU,
        "response",
        "01 10 18 70 00 02 46 B3",
        "done: two words from 1870H",
    ),
    Frame(
        RTU,
        "response",
        "01 90 04 4D C3",
        "error 04: unable, or nothing is selected by F870 and F871",
    ),
    Frame(
        RTU,
        "request",
        "01 10 18 71 00 02 04 C4 00 17 70 AC 63",
        "block write to 1871H; error 03 answers",
    ),
    Frame(
        RTU,
        "request",
        "01 10 18 70 00 03 04 C4 00 17 70 6C 7E",
        "block write of three words; error 03 answers",
    ),
    Frame(
        RTU,
        "response",
        "01 90 03 0C 01",
        "error 03: data range",
    ),
    Frame(
        RTU,
        "request",
        "01 2B 0E 01 00 70 77",
        "who are you, read code 01",
    ),
    Frame(
        RTU,
        "response",
        "01 2B 0E 01 01 00 00 03 00 07 54 4F 53 48 49 42 41 01 0B 56 46 6E 43 33 2D 32 30 30 37 50"
        " 02 04 30 31 30 30 38 2C",
        "TOSHIBA, VFnC3-2007P, version 0100",
    ),
    Frame(
        RTU,
        "response",
        "01 2B 0E 01 01 00 00 03 00 07 54 4F 53 48 49 42 41 01 0D 56 46 4D 42 31 53 2D 32 30 30 34"
        " 50 4C 02 04 30 31 30 32 9A CC",
        "TOSHIBA, VFMB1S-2004PL, version 0102; printed with a wrong CRC, B6 0C is right",
    ),
    Frame(
        BINARY,
        "request",
        "2F 58 02 05 C4 00 17 70 D9",
        "X: run forward by communication (C400H) at 60.00 Hz, five words wanted",
    ),
    Frame(
        BINARY,
        "response",
        "2F 59 05 03 00 00 00 00 00 00 00 00 00 00 90",
        "Y: neither word could be written, nothing is selected",
    ),
    Frame(
        BINARY,
        "response",
        "2F 59 05 00 40 00 00 00 00 00 00 00 00 00 CD",
        "Y: selectors set, motor standing: status 4000H",
    ),
    Frame(
        BINARY,
        "response",
        "2F 59 05 00 64 00 17 70 1A 8A 24 FD 00 00 3D",
        "Y: running: status 6400H, 60.00 Hz, 67.94 %, 94.69 %, no alarm",
    ),
    Frame(
        BINARY,
        "request",
        "2F 58 02 05 C4 00 17 70 D8",
        "X with a checksum one too low",
    ),
    Frame(
        BINARY,
        "response",
        "2F 4E 00 04 81",
        "N: checksum error",
    ),
    Frame(
        BINARY,
        "response",
        "2F 4E 00 00 7D",
        "N: unable to execute",
    ),
    Frame(
        BINARY,
        "response",
        "2F 4E 00 01 7E",
        "N: data error",
    ),
    Frame(
        BINARY,
        "response",
        "2F 4E 00 02 7F",
        "N: no such communication number",
    ),
    Frame(
        BINARY,
        "request",
        "2F 57 00 10 00 64 FA",
        "W: deceleration time 10.0 s to RAM and EEPROM; echoed",
    ),
    Frame(
        BINARY,
        "request",
        "2F 50 FA 00 90 00 09",
        "P: emergency stop; echoed",
    ),
    Frame(
        BINARY,
        "request",
        "2F 52 FE 03 82",
        "R: current held from before the trip",
    ),
    Frame(
        BINARY,
        "response",
        "2F 52 FE 03 07 7B 04",
        "19.15 %",
    ),
    Frame(
        BINARY,
        "request",
        "2F 47 FE 03 00 00 77",
        "G: current held from before the trip, dummy word 0",
    ),
    Frame(
        BINARY,
        "response",
        "2F 47 FE 03 07 7B F9",
        "19.15 %",
    ),
    Frame(
        BINARY,
        "request",
        "2F 50 FA 01 17 70 01",
        "P: frequency command 60.00 Hz",
    ),
    Frame(
        BINARY,
        "request",
        "2F 50 FA 00 C4 00 3D",
        "P: run forward by communication",
    ),
    Frame(
        BINARY,
        "request",
        "2F 52 FD 00 7E",
        "R: output frequency",
    ),
    Frame(
        BINARY,
        "response",
        "2F 52 FD 00 17 70 05",
        "60.00 Hz",
    ),
    Frame(
        BINARY,
        "request",
        "2F 52 FD 01 7F",
        "R: status",
    ),
    Frame(
        BINARY,
        "response",
        "2F 72 FD 01 00 03 A2",
        "r, the drive is tripped: status 0003H",
    ),
    Frame(
        BINARY,
        "request",
        "2F 52 FC 90 0D",
        "R: trip code",
    ),
    Frame(
        BINARY,
        "response",
        "2F 72 FC 90 00 18 45",
        "r, the drive is tripped: code 18H, Err5",
    ),
    Frame(
        BINARY,
        "request",
        "2F 53 FA 01 13 88 18",
        "S: 50.00 % to the slaves; nobody answers",
    ),
    Frame(
        BINARY,
        "request",
        "2F 58 05 05 00 30 00 31 00 32 00 33 00 03 5A",
        'X in LED mode (FA80 = 1): show "0123"',
    ),
    Frame(
        BINARY,
        "response",
        "2F 59 05 00 00 64 00 41 00 74 00 41 00 00 E7",
        'Y: what the LEDs showed before, "dAtA"',
    ),
    Frame(
        ASCII,
        "request",
        "28 57 30 30 31 30 30 30 36 34 29 0D",
        "W: deceleration time 10.0 s; echoed",
    ),
    Frame(
        ASCII,
        "request",
        "28 50 46 41 30 30 39 30 30 30 29 0D",
        "P: emergency stop; echoed",
    ),
    Frame(
        ASCII,
        "request",
        "28 52 46 45 30 33 29 0D",
        "R: current held from before the trip",
    ),
    Frame(
        ASCII,
        "response",
        "28 52 46 45 30 33 30 37 37 42 29 0D",
        "19.15 %",
    ),
    Frame(
        ASCII,
        "request",
        "28 50 46 41 30 31 31 37 37 30 29 0D",
        "P: frequency command 60.00 Hz; echoed",
    ),
    Frame(
        ASCII,
        "request",
        "28 50 46 41 30 30 43 34 30 30 29 0D",
        "P: run forward by communication; echoed",
    ),
    Frame(
        ASCII,
        "request",
        "28 52 46 44 30 30 29 0D",
        "R: output frequency",
    ),
    Frame(
        ASCII,
        "response",
        "28 52 46 44 30 30 31 37 37 30 29 0D",
        "60.00 Hz",
    ),
    Frame(
        ASCII,
        "request",
        "28 52 46 44 30 31 29 0D",
        "R: status",
    ),
    Frame(
        ASCII,
        "response",
        "28 72 46 44 30 31 30 30 30 33 29 0D",
        "r, the drive is tripped: status 0003H",
    ),
    Frame(
        ASCII,
        "request",
        "28 52 46 43 39 30 29 0D",
        "R: trip code",
    ),
    Frame(
        ASCII,
        "response",
        "28 72 46 43 39 30 30 30 31 38 29 0D",
        "r, the drive is tripped: code 18H, Err5",
    ),
    Frame(
        ASCII,
        "request",
        "28 57 30 38 30 33 30 29 0D",
        "W with one digit of data: communication time-out off",
    ),
    Frame(
        ASCII,
        "response",
        "28 57 30 38 30 33 30 30 30 30 29 0D",
        "the answer has four digits",
    ),
    Frame(
        ASCII,
        "request",
        "28 57 31 32 33 34 31 32 29 0D",
        "W with two digits of data",
    ),
    Frame(
        ASCII,
        "response",
        "28 57 31 32 33 34 30 30 31 32 29 0D",
        "the answer has four digits",
    ),
    Frame(
        ASCII,
        "request",
        "28 52 30 30 30 30 26 36 30 29 0D",
        "R of number 0000 with a checksum",
    ),
    Frame(
        ASCII,
        "response",
        "28 4E 30 30 30 30 26 35 43 29 0D",
        "N: unable to execute",
    ),
    Frame(
        ASCII,
        "response",
        "28 4E 30 30 30 31 26 35 44 29 0D",
        "N: data error",
    ),
    Frame(
        ASCII,
        "response",
        "28 4E 30 30 30 32 26 35 45 29 0D",
        "N: no such communication number",
    ),
    Frame(
        ASCII,
        "response",
        "28 4E 30 30 30 33 26 35 46 29 0D",
        "N: no such command",
    ),
    Frame(
        ASCII,
        "response",
        "28 4E 30 30 30 34 26 36 30 29 0D",
        "N: checksum error",
    ),
    Frame(
        ASCII,
        "request",
        "28 2A 32 52 30 30 30 30 29 0D",
        "R to all drives whose number ends in 2",
    ),
    Frame(
        ASCII,
        "response",
        "28 30 32 52 30 30 30 30 30 30 30 30 29 0D",
        "drive 02 answers for its group",
    ),
    Frame(
        ASCII,
        "request",
        "28 2A 2A 50 46 41 30 31 31 37 37 30 29 0D",
        "P to all drives: 60.00 Hz",
    ),
    Frame(
        ASCII,
        "response",
        "28 30 30 50 46 41 30 31 31 37 37 30 29 0D",
        "drive 00 answers for all",
    ),
    Frame(
        ASCII,
        "request",
        "28 2A 39 50 46 41 30 31 31 37 37 30 29 0D",
        "P to all drives whose number ends in 9: 60.00 Hz",
    ),
    Frame(
        ASCII,
        "response",
        "28 30 39 50 46 41 30 31 31 37 37 30 29 0D",
        "drive 09 answers for its group",
    ),
)
