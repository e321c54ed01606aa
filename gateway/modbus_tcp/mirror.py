"""What a controller's registers in the mirror ask for, and whether what they asked for still holds. Pure.

A controller writes its registers in cycles, and means one thing by the same words: a command is made once, when the
words change. A command register that is written alone is a command each time. Permission that was lost, or a motor
that was stopped, is never taken up again by words that merely stand there; a stop that stands there is.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal

from gateway.control.command import Result, Source, Status, Verb
from gateway.control.composing import COMMAND, FREQUENCY, has_bit, runs
from gateway.control.state import DriveState, Standing
from gateway.modbus_tcp.mirror_map import ORDERS, Order, Place

HUNDREDTH = Decimal("0.01")  # of a hertz, the unit of the frequency register
SHEETS = 4096  # drives times controllers that are remembered; the longest unwritten is forgotten first

Words = Mapping[Place, int]


@dataclass(frozen=True, slots=True)
class Wish:
    """One command that the registers ask for."""

    verb: Verb
    is_reverse: bool = False
    value: Decimal | None = None


@dataclass(slots=True, eq=False)
class Attempt:
    """A command that was made by the registers, with the sequence number that stood beside it, and its end."""

    sequence: int
    result: Result | None = None

    @property
    def is_done(self) -> bool:
        """Say whether it was done."""
        return self.result is not None and self.result.status is Status.DONE


@dataclass(slots=True, eq=False)
class Sheet:
    """The registers of one drive as one controller, `source`, has written them; they begin at 0.

    `current` is the command that the words as they are have made, `last` the last one that any words have made.
    """

    source: Source
    words: dict[Place, int] = field(default_factory=lambda: dict.fromkeys(filter(_is_written, Place), 0))
    current: Attempt | None = None
    last: Attempt | None = None
    _is_frequency_due: bool = False  # it was written, and not given to the drive
    _sequence: int = 0  # with which the command register was looked at last

    @property
    def order(self) -> Order | None:
        """Return what the command register holds."""
        return ORDERS.get(self.words[Place.COMMAND])

    @property
    def hertz(self) -> Decimal:
        """Return the frequency register in Hz."""
        return self.words[Place.FREQUENCY] * HUNDREDTH

    def write(self, words: Words, state: DriveState, now: float) -> Wish | None:
        """Take what a request writes; return the command that it makes, if any.

        A frequency that comes with other registers goes with a run command, else by itself as soon as the controller
        may command more than stops; it is not sent while a stop stands beside it.
        """
        changed = {place for place, word in words.items() if self.words[place] != word} - {Place.HEARTBEAT}
        self.words.update(words)
        is_again = Place.COMMAND in words and self.words[Place.SEQUENCE] != self._sequence
        if Place.COMMAND in words:
            self._sequence = self.words[Place.SEQUENCE]
        if Place.FREQUENCY in words:
            self._is_frequency_due |= Place.FREQUENCY in changed or (is_again and self.order is None)
        if changed or is_again:
            self.current = None
        if self._is_new_order(words, changed, is_again=is_again):
            return self._ordered(words)
        is_due = self._is_due_alone(state) if words.keys() == {Place.FREQUENCY} else self._is_due(state, now)
        if not is_due:
            return None
        self._is_frequency_due = False
        return Wish(Verb.FREQUENCY, value=self.hertz)

    def _is_due(self, state: DriveState, now: float) -> bool:
        is_under_way = self.current is not None and self.current.result is None
        is_stop = self.order is not None and self.order.verb.is_stopping
        return self._is_frequency_due and not is_under_way and not is_stop and state.is_own(self.source, now)

    def _is_due_alone(self, state: DriveState) -> bool:
        """Say whether a frequency that is written alone is to be sent: unless it was, and the drive holds it."""
        if self.current is None:
            return True
        register = state.drive.model.registers.get(FREQUENCY)
        held = state.facts.get(FREQUENCY)
        is_held = register is not None and held is not None and register.decode(held) == self.hertz
        return self.current.result is not None and not (self.current.is_done and is_held)

    def _is_new_order(self, words: Words, changed: set[Place], *, is_again: bool) -> bool:
        if self.order is None:
            return False
        if Place.COMMAND in words and (is_again or words.keys() == {Place.COMMAND}):
            return True
        return Place.COMMAND in changed or (self.order.has_number and Place.PARAMETER in changed)

    def _ordered(self, words: Words) -> Wish:
        order = self.order
        if order is None:
            raise AssertionError("there is an order")
        value = Decimal(self.words[Place.PARAMETER]) if order.has_number else None
        if order.verb is Verb.RUN and (self._is_frequency_due or Place.FREQUENCY in words):
            value, self._is_frequency_due = self.hertz, False
        return Wish(order.verb, order.is_reverse, value)

    def stop_again(self, state: DriveState, now: float) -> Wish | None:
        """Return the stop that the words hold, where the drive is not stopped by it any more."""
        if self.order is None or not self.order.verb.is_stopping or holds(self.order, state, self.source, now):
            return None
        return Wish(self.order.verb)

    def has_ended(self, state: DriveState, now: float) -> bool:
        """Say whether the words hold what was done once and is no longer so: it takes others to have it again."""
        order = self.order
        if order is None or order.verb.is_stopping or not (self.current is None or self.current.is_done):
            return False
        return not holds(order, state, self.source, now)

    def begun(self) -> Attempt:
        """Note that the words have made a command."""
        self.current = self.last = Attempt(self.words[Place.SEQUENCE])
        return self.last


class Sheets:
    """The sheets of all drives and controllers."""

    def __init__(self) -> None:
        self._sheets: OrderedDict[tuple[str, Source], Sheet] = OrderedDict()

    def of(self, drive: str, source: Source) -> Sheet:
        """Return the sheet of a controller for a drive."""
        sheet = self._sheets.setdefault((drive, source), Sheet(source))
        self._sheets.move_to_end((drive, source))
        if len(self._sheets) > SHEETS:
            self._sheets.popitem(last=False)
        return sheet

    def find(self, drive: str, source: Source) -> Sheet | None:
        """Return it where there is one."""
        return self._sheets.get((drive, source))


def holds(order: Order, state: DriveState, source: Source, now: float) -> bool:
    """Say whether what an order brought about is still so."""
    if order.verb.is_stopping:
        return is_stopped(state)
    if order.verb in (Verb.RESET, Verb.RELEASE, Verb.RELEASE_PRIORITY):
        return True
    if order.verb in (Verb.RUN, Verb.JOG) and not (state.is_online and state.is_running):
        return False
    if order.verb in (Verb.RUN, Verb.JOG, Verb.ARM) and state.standing is not Standing.ARMED:
        return False
    return state.is_own(source, now)


def is_stopped(state: DriveState) -> bool:
    """Say whether a drive was seen to be stopped by command, and nothing is on its way to it."""
    register = state.drive.model.registers.get(COMMAND)
    is_settled = state.is_online and state.standing is not Standing.LOST and not state.queue
    if register is None or not is_settled:
        return False
    word = state.facts.get(COMMAND, 0)
    is_held = has_bit(register, word, "command_priority") and not runs(register, word)
    return is_held or state.is_tripped is True


def _is_written(place: Place) -> bool:
    return place.is_written
