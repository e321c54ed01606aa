"""A controlled drive under its unit: what is polled, and what was read back after a command. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

from gateway.control.command import Result
from gateway.control.door import Door
from gateway.control.writes import Allowed, BadCommand, check_access
from gateway.drives.register import Register, Storage
from gateway.image import DriveImage, LinkState, Missing, Reading
from gateway.site import Drive

FRESH_FOR = 5.0  # seconds; what is to be read at any time is to be polled
HARMLESS = frozenset(("taken", "armed"))  # events by which no register changes


def commanded_registers(drive: Drive) -> tuple[Register, ...]:
    """Return what may be written to a drive by its numbers: nothing where it is not controlled."""
    if drive.section is None or not drive.is_controlled:
        return ()
    return tuple(_writable(drive, has_stored=drive.section.allow_stored or drive.codec.forms.has_ram_write))


def _writable(drive: Drive, *, has_stored: bool) -> Iterator[Register]:
    for register in sorted(drive.model.registers.values(), key=lambda register: register.address):
        if register.storage is Storage.EEPROM and not has_stored:
            continue
        try:
            check_access(drive.model, register, Allowed(stored=has_stored))
        except BadCommand:
            continue
        yield register


class CommandedUnit:
    """The registers of a controlled drive. A word that was read back holds for a while, and for this link only."""

    def __init__(self, image: DriveImage, door: Door) -> None:
        self._image = image
        self._door = door
        self._drive = image.drive
        self._polled = frozenset(point.register.address for point in image.points.values())
        self._commanded = frozenset(register.address for register in commanded_registers(self._drive))
        self._words: dict[int, tuple[int, float]] = {}  # word, and until when it holds
        door.on_result(self.learn)
        door.on_event(self._on_event)
        image.subscribe(self._on_image)

    @property
    def link(self) -> LinkState:
        """Return what is known of the connection to it."""
        return self._image.link

    @property
    def identity(self) -> Mapping[str, str]:
        """Return vendor, device and version; empty where not known yet."""
        return self._image.identity

    def read(self, start: int, count: int, now: float) -> bytes | Missing:
        """Return words as they stand on the wire, or why not."""
        words = self._image.read(start, count, now)
        return self._one_by_one(start, count, now) if words is Missing.UNMAPPED else words

    def reading(self, start: int, count: int) -> Reading:
        """Return what reads these words again and again."""
        is_polled = self._polled.issuperset(range(start, start + count))
        return self._image.reading(start, count) if is_polled else partial(self.read, start, count)

    def _one_by_one(self, start: int, count: int, now: float) -> bytes | Missing:
        numbers = range(start, start + count)
        if not self._commanded.issuperset(number for number in numbers if number not in self._polled):
            return Missing.UNMAPPED
        words = []
        for number in numbers:
            word = self._image.read(number, 1, now) if number in self._polled else self._read_back(number, now)
            if isinstance(word, Missing):
                return word
            words.append(word)
        return b"".join(words)

    def _read_back(self, number: int, now: float) -> bytes | Missing:
        if not self._image.link.is_connected:
            return Missing.LINE_DOWN if self._image.link is LinkState.LINE_DOWN else Missing.NOT_FRESH
        word, until = self._words.get(number, (0, float("-inf")))
        return word.to_bytes(2, "big") if now <= until else Missing.NOT_FRESH

    def learn(self, result: Result) -> None:
        """Take what a command has brought: what was read back is known, what else was written no longer is."""
        if result.command.drive != self._drive.name:
            return
        until = self._door.clock.now() + FRESH_FOR
        registers = self._drive.model.registers
        for name in result.raw:
            self._words.pop(registers[name].address, None)
        for name, word in result.read_back.items():
            self._words[registers[name].address] = (word, until)

    def _on_event(self, drive: str, event: str, _reason: str) -> None:
        """Forget all where the gateway or the drive itself may have changed it since."""
        if drive == self._drive.name and event not in HARMLESS:
            self._words.clear()

    def _on_image(self, _image: DriveImage, names: Sequence[str]) -> None:
        """Forget all when the link, or whether the drive is tripped, has changed."""
        if not names:
            self._words.clear()
