"""Finds what happens to a drive: trips with their code, lost links, settings that wait for a reset.

Pure. An event is a change; what is found when the gateway starts, or a drive is first heard, is a state and no event.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from gateway.control.command import Result, Status, Verb
from gateway.image import DriveImage, Image, LinkState, Quality

TRIP_CODE = "trip_code"
NO_TRIP = 0  # FC90 (E6581657 7.2)
CODE_WITHIN = 2.0  # seconds for the trip's code to be read, after which a trip is told without it

FOUND = ("trip", "trip_cleared", "link_lost", "link_restored", "reset_needed", "reset_done", "reset")  # told by us
OF_CONTROL = (  # told by the control of a drive
    "taken",
    "released",
    "lease_lost",
    "armed",
    "disarmed",
    "on_loss",
    "not_stopped",
    "quiesced",
    "awake",
    "unowned",
    "watchdog",
    "eeprom",
)
KINDS = (*FOUND, *OF_CONTROL)


@dataclass(frozen=True, slots=True)
class Event:
    """What happened to a drive, and why; `more` goes with it."""

    drive: str
    kind: str
    reason: str = ""
    more: Mapping[str, object] = field(default_factory=dict)


class _Watch:
    """One drive: what was known of it before."""

    def __init__(self, image: DriveImage) -> None:
        self._image = image
        self._is_connected: bool | None = None
        self._is_tripped: bool | None = None
        self._is_reset_needed = False
        self._tripped_at: float | None = None  # a trip whose code is not known yet
        self._noticed: tuple[object, ...] = ()

    @property
    def is_quiet(self) -> bool:
        """Say whether nothing can be new: all is as it was when it was looked at last, and no code is waited for."""
        return self._tripped_at is None and self._noticed == self._standing

    @property
    def _standing(self) -> tuple[object, ...]:
        return self._image.link, self._image.is_tripped, self._image.is_reset_needed

    def notice(self, now: float) -> list[Event]:
        """Return what is new; most often nothing."""
        if self.is_quiet:
            return []
        found = [*self._link(), *self._reset(), *self._trip(now)]
        self._noticed = self._standing
        return found

    def _event(self, kind: str, reason: str = "", **more: object) -> Event:
        return Event(self._image.drive.name, kind, reason, more)

    def _link(self) -> Iterator[Event]:
        image, before = self._image, self._is_connected
        if image.link is LinkState.STARTING:
            return
        self._is_connected = image.link.is_connected
        if before is not None and before is not self._is_connected:
            yield self._event("link_restored") if self._is_connected else self._event("link_lost", image.reason)

    def _reset(self) -> Iterator[Event]:
        is_needed = self._image.is_reset_needed
        if is_needed is not self._is_reset_needed:
            self._is_reset_needed = is_needed
            yield self._event("reset_needed" if is_needed else "reset_done")

    def _trip(self, now: float) -> Iterator[Event]:
        is_tripped, before = self._image.is_tripped, self._is_tripped
        if not is_tripped and self._tripped_at is not None:
            self._tripped_at = None
            yield self._of_trip(None)  # it was over, or out of sight, before its code was read
        if is_tripped is None:
            return
        self._is_tripped = is_tripped
        if before is False and is_tripped:
            self._tripped_at = now
        elif before and not is_tripped:
            yield self._event("trip_cleared")
        if self._tripped_at is not None:
            yield from self._told_trip(self._tripped_at, now)

    def _told_trip(self, tripped_at: float, now: float) -> Iterator[Event]:
        """Tell of a trip as soon as its code is read; without it where the code is not read, or not in time."""
        code = self._code(now)
        if code is not None or TRIP_CODE not in self._image.points or now - tripped_at >= CODE_WITHIN:
            self._tripped_at = None
            yield self._of_trip(code)

    def _code(self, now: float) -> int | None:
        if TRIP_CODE not in self._image.points:
            return None
        sample = self._image.sample(TRIP_CODE, now)
        return sample.word if sample.quality is Quality.GOOD and sample.word != NO_TRIP else None

    def _of_trip(self, code: int | None) -> Event:
        text = "" if code is None else self._image.text(TRIP_CODE, code) or ""
        return self._event("trip", text, code=code)


class Events:
    """What happens to every drive of a gateway."""

    def __init__(self, image: Image) -> None:
        self._watches = {each.drive.name: _Watch(each) for each in image.drives}
        for watch in self._watches.values():
            watch.notice(0.0)

    def notice(self, image: DriveImage, names: Sequence[str], now: float) -> list[Event]:
        """Return what is new after an answer, or, without names, after a change of the link; most often nothing."""
        watch = self._watches[image.drive.name]
        if watch.is_quiet or (names and TRIP_CODE not in names):
            return []
        return watch.notice(now)

    def look(self, now: float) -> list[Event]:
        """Return what has become known by waiting."""
        return [event for watch in self._watches.values() for event in watch.notice(now)]


def of_result(result: Result) -> Event | None:
    """Return the event that a command was: a reset of the drive."""
    command = result.command
    if command.verb is not Verb.RESET or result.status is not Status.DONE:
        return None
    return Event(command.drive, "reset", f"asked for by {command.source}")
