"""Simulated drives under the hand of a test: build one, send it requests, look at what it is."""

from __future__ import annotations

from functools import cache
from random import Random
from typing import Any

from gateway.drives.catalogue import Catalogue, load
from gateway.drives.model import Model
from gateway.sim.drive import SimulatedDrive
from gateway.sim.modbus import crc
from gateway.sim.options import DriveOptions


@cache
def models() -> Catalogue:
    """Read the catalogue once."""
    return load()


def framed(body: str, number: int = 1) -> bytes:
    """Return a frame from its hexadecimal function and data."""
    data = bytes([number]) + bytes.fromhex(body)
    return data + crc(data)


def binary(body: str) -> bytes:
    """Return a frame of TOSHIBA binary from what is between start code and checksum, in hexadecimal."""
    data = b"/" + bytes.fromhex(body)
    return data + bytes([sum(data) % 256])


def checked(body: str) -> bytes:
    """Return a frame of TOSHIBA ASCII with a checksum, from what is between start code and checksum."""
    data = f"({body}&".encode()
    return data + f"{sum(data) % 256:02X})\r".encode()


class Rig:
    """One drive and a clock that the test moves."""

    def __init__(self, model: str | Model = "vf-nc3", *, seed: int = 1, **options: Any) -> None:
        """Switch a drive on at time 0; its undefined bits read 0 unless asked."""
        settings = DriveOptions(**({"number": 1, "stable_bits": True} | options))
        described = models()[model] if isinstance(model, str) else model
        self.drive = SimulatedDrive(described, settings, Random(seed))
        self.now = 0.0
        self.delay = 0.0

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds
        self.drive.tick(self.now)

    def send(self, frame: bytes) -> bytes | None:
        """Hand the drive a frame and return its answer."""
        answer, self.delay = self.drive.handle(frame, self.now)
        return answer

    def ask(self, body: str, number: int = 1) -> str | None:
        """Send function and data; return the answer's function and data, or None for silence."""
        answer = self.send(framed(body, number))
        if answer is None:
            return None
        assert answer[-2:] == crc(answer[:-2])
        assert answer[0] == number
        return answer[1:-2].hex(" ").upper()

    def tell(self, body: str) -> str | None:
        """Send what stands between "(" and ")" of an ASCII frame; return the same of the answer, None for silence."""
        answer = self.send(f"({body})\r".encode())
        if answer is None:
            return None
        assert (answer[:1], answer[-2:]) == (b"(", b")\r")
        return answer[1:-2].decode()

    def tell_binary(self, body: str) -> str | None:
        """Send what stands between start code and checksum, in hexadecimal; return the same, None for silence."""
        answer = self.send(binary(body))
        if answer is None:
            return None
        assert (answer[:1], answer[-1]) == (b"/", sum(answer[:-1]) % 256)
        return answer[1:-1].hex(" ").upper()

    def word(self, name: str) -> int:
        """Look at the word of a register in the RAM, sending nothing."""
        return self.drive.inverter.memory.word(name)

    def read(self, name: str) -> int:
        """Read a register by name over the wire."""
        address = self.drive.model.registers[name].address
        answer = self.ask(f"03 {address:04X} 0001")
        assert answer is not None
        assert answer.startswith("03 02 "), answer
        return int(answer[6:].replace(" ", ""), 16)

    def write(self, name: str, word: int) -> str | None:
        """Write a register by name over the wire; return the answer."""
        address = self.drive.model.registers[name].address
        return self.ask(f"06 {address:04X} {word:04X}")

    def power_cycle(self) -> None:
        """Switch the drive off and on, and wait until it hears again."""
        self.drive.inverter.reset(self.now)
        self.wait(self.drive.model.times.start_up)
