"""What one broker misses: kept while it is away or not known to have it, and sent behind all that is live.

What is told here comes from the adapters, in the event loop. Commands and their results never come here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Generic, Protocol, TypeVar

from gateway.backlog import Backlog, HistoricalReading, Kept, Kind, Loss, milliseconds
from gateway.clock import Clock
from gateway.image import DriveImage, Image
from gateway.mqtt.filters import Policy
from gateway.mqtt.forwarding import Forwarder, Parcel
from gateway.mqtt.sampling import Sampler, Taken
from gateway.mqtt.unconfirmed import Unconfirmed

P = TypeVar("P")

WHILE_LONG = 0.05  # seconds between looks whether they have become fewer
SHORT = 16  # messages that may wait for the broker while it is sent what it has missed


class Wire(Protocol):
    """The way to the broker, and what is known of it."""

    @property
    def waiting(self) -> int:
        """Return how many messages are on their way."""
        ...

    @property
    def handed(self) -> int:
        """Return how many messages were handed over on this connection."""
        ...

    @property
    def there(self) -> int:
        """Return how many of them the broker is known to have."""
        ...


class Missed(Generic[P]):
    """The readings of a gateway on their way to one broker, beside what is live."""

    def __init__(
        self,
        backlog: Backlog,
        image: Image,
        policies: Callable[[DriveImage], Mapping[str, Policy]],
        forwarder: Forwarder[P],
        clock: Clock,
    ) -> None:
        self._backlog = backlog
        self._clock = clock
        self._samplers = {each.drive.name: Sampler(each, policies(each)) for each in image.drives}
        self._unconfirmed: Unconfirmed[Taken | HistoricalReading] = Unconfirmed()
        self._forwarder = forwarder
        self._wake: Callable[[], None] | None = None  # None while the broker is away

    # ---- the connection

    def begin(self, wake: Callable[[], None]) -> None:
        """Take that the broker is there; `wake` is called when there is something to send to it."""
        self._wake = wake
        self._forwarder.begin()

    def end(self) -> None:
        """Take that it is away: what it is not known to have is kept."""
        self._wake = None
        self._keep(self._unconfirmed.give_up())

    def _keep(self, found: Iterable[Taken | HistoricalReading]) -> None:
        for each in found:
            self._backlog.put(each.written() if isinstance(each, Taken) else each)

    # ---- what happens

    def note(self, image: DriveImage, names: Sequence[str], mark: int | None) -> None:
        """Take an answer of a drive, or a change of its link; see `Unconfirmed.add` for `mark`."""
        taken = self._samplers[image.drive.name].take(names, self._clock.now(), self._clock.wall())
        if taken is not None:
            self._note(taken, mark)

    def note_event(
        self, drive: str, text: str, wall: float, mark: int | None, is_there: Callable[[], bool] | None = None
    ) -> None:
        """Take what happened to a drive, as JSON, and when that was in UTC seconds."""
        self._note(HistoricalReading(drive, Kind.EVENT, milliseconds(wall), text), mark, is_there)

    def _note(
        self, what: Taken | HistoricalReading, mark: int | None, is_there: Callable[[], bool] | None = None
    ) -> None:
        if self._wake is None:
            self._keep([what])
        else:
            self._keep(self._unconfirmed.add(what, mark, is_there))

    def look(self, mark: int | None) -> None:
        """Take what had to wait for its turn; the broker is told of it at the same time."""
        for sampler in self._samplers.values():
            taken = sampler.release(self._clock.now(), self._clock.wall())
            if taken is not None:
                self._note(taken, mark)

    # ---- what is sent

    @property
    def is_unsure(self) -> bool:
        """Say whether anything was sent that the broker is not known to have."""
        return bool(len(self._unconfirmed)) or self._forwarder.is_waiting

    def settle(self, there: int) -> None:
        """Take how many messages the broker is known to have."""
        self._keep(self._unconfirmed.settle(there))
        done = self._forwarder.settle()
        if done:
            self._backlog.stats.sent += len(done)
            self._backlog.let_go(done)

    def pass_over(self, drives: frozenset[str]) -> None:
        """Leave out some drives for now: hosts would not know what to do with their readings."""
        self._forwarder.pass_over(drives)

    def is_due(self, wire: Wire, now: float) -> bool:
        """Say whether something that was missed may be sent now, when nothing live waits; ask for more of it."""
        question = self._forwarder.question(now) if self._backlog.stats.waiting else None
        if question is not None:
            after, count, without, turn = question
            self._backlog.ask(after, count, without, lambda kept: self._answered(kept, turn))
        return wire.waiting < SHORT and self._forwarder.is_due(now)

    def _answered(self, kept: Sequence[Kept], turn: int) -> None:
        useless = self._forwarder.take(kept, turn, self._clock.now())
        if useless:
            self._backlog.stats.dropped[Loss.UNKNOWN] += len(useless)
            self._backlog.let_go(useless)
        if self._wake is not None:
            self._wake()

    def send(self, now: float, by: Callable[[P], Callable[[], bool] | None]) -> None:
        """Send the next message by `by`, which returns what says that it is there; None: it cannot be sent."""
        parcel = self._forwarder.next(now)
        is_there = by(parcel.what)
        if is_there is None:
            self._backlog.stats.dropped[Loss.UNKNOWN] += bool(parcel.number)
        self._forwarder.sent(parcel, is_there or _yes)

    def patience(self, wire: Wire, now: float, most: float) -> float:
        """Return for how many seconds nothing need be looked at here."""
        if not self._backlog.stats.waiting:
            return most
        return min(most, WHILE_LONG) if wire.waiting >= SHORT else self._forwarder.patience(now, most)


def _yes() -> bool:
    """Say that a message that cannot be sent is dealt with."""
    return True


__all__ = ["Missed", "Parcel"]
