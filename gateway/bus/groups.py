"""Which frames reach exactly the drives of a group: one for all where one does, else one for each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from gateway.protocol.pdu import EVERY_DRIVE, Group
from gateway.protocol.registry import PROTOCOLS
from gateway.site import Drive

MODBUS = "modbus-rtu"
DIGITS = "toshiba-ascii"  # the mode that addresses drives by one digit


@dataclass(frozen=True, slots=True)
class Reach:
    """A frame's address, its protocol, and the configured drives that it reaches.

    `representative` is the drive that answers a group's frame: None where it is not configured on the line, and
    always in MODBUS-RTU. A group's frame also reaches drives that nobody configured.
    """

    protocol: str
    target: int | Group
    drives: tuple[Drive, ...]
    representative: Drive | None = None

    @property
    def is_group(self) -> bool:
        """Say whether one frame is for several drives."""
        return isinstance(self.target, Group)

    @property
    def address(self) -> str:
        """Spell the address as it stands in the frame: ** or 1* or *2, FFH, 0 for groups; a number for one drive."""
        if not self.is_group:
            return f"number {self.target}"
        if self.protocol == MODBUS:
            return "0"
        return str(self.target) if PROTOCOLS[self.protocol].forms.has_digit_groups else "FFH"

    @property
    def names(self) -> str:
        """Name the drives."""
        return ", ".join(drive.name for drive in self.drives)

    def __str__(self) -> str:
        answers = f"; {self.representative.name} answers" if self.representative else "; nobody answers"
        return f"{self.address} ({self.protocol}): {self.names}{answers if self.is_group else ''}"


def family(protocol: str) -> str:
    """Return what drives must have in common to hear one frame: TOSHIBA drives hear ASCII and binary alike."""
    return "MODBUS" if protocol == MODBUS else "TOSHIBA"


def reach(members: Sequence[Drive], on_line: Sequence[Drive], protocol: str = "") -> tuple[Reach, ...]:
    """Return the frames that reach the members, all of them and no other configured drive, each once.

    `on_line` are all drives of the line. Frames are of the protocols that the members are configured with, or
    of `protocol` where it is given; ASCII reaches a digit's drives though they are configured with binary, for
    they hear both. The narrowest group that fits is taken.
    """
    found: list[Reach] = []
    for name in dict.fromkeys(family(drive.protocol) for drive in members):
        own = [drive for drive in members if family(drive.protocol) == name]
        others = [drive for drive in on_line if family(drive.protocol) == name]
        together = next(_together(own, others, protocol), None) if len(own) > 1 else None
        if together is not None:
            found.append(together)
        else:
            found += [Reach(protocol or drive.protocol, drive.number, (drive,)) for drive in own]
    return tuple(found)


def _together(members: Sequence[Drive], on_line: Sequence[Drive], protocol: str) -> Iterator[Reach]:
    """Yield the group frames that reach exactly these members among the drives that can hear them."""
    wanted = {drive.name for drive in members}
    configured = [drive.protocol for drive in members]
    both = [DIGITS] if MODBUS not in configured else []
    for name in (protocol,) if protocol else dict.fromkeys([*configured, *both]):
        forms = PROTOCOLS[name].forms
        if any(drive.number not in forms.numbers for drive in members):
            continue
        for group in _groups(members, has_digits=forms.has_digit_groups):
            heard = [drive for drive in on_line if group.has(drive.number)]
            if {drive.name for drive in heard} == wanted:
                answers = next((drive for drive in heard if drive.number == group.representative), None)
                yield Reach(name, group, tuple(members), None if name == MODBUS else answers)


def _groups(members: Sequence[Drive], *, has_digits: bool) -> Iterator[Group]:
    """Yield the groups that hold all members, the narrow ones first: fewer strangers hear them."""
    tens = {drive.number // 10 for drive in members}
    ones = {drive.number % 10 for drive in members}
    if has_digits and len(tens) == 1:
        yield Group(tens=tens.pop())
    if has_digits and len(ones) == 1:
        yield Group(ones=ones.pop())
    yield EVERY_DRIVE
