"""How fast a line can be read at the worst, from which follows at what age a value is stale. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.config import DriveSection, LineSection, PollSection
from gateway.drives.catalogue import Catalogue
from gateway.drives.model import Model
from gateway.protocol.pdu import ReadWords
from gateway.protocol.registry import PROTOCOLS
from gateway.protocol.timing import LineTiming

LEAST_MAX_AGE = 1.0  # seconds; below it, one lost frame would make a value stale
MAX_AGE_PERIODS = 3
LEAST_REST = 0.1  # share of the line that polls without a period are reckoned to get at the least


@dataclass(frozen=True, slots=True)
class Pace:
    """How fast a line can be read at the worst, in single reads: what each period comes out as.

    `stretch` is by how much the timed polls ask too much of it (1: they fit); `round` is how long one turn of
    the polls without a period takes in what the timed ones leave, in seconds.
    """

    stretch: float
    round: float

    def usual_max_age(self, every: float) -> float:
        """Return the age in seconds past which a value that is polled so often is stale, unless told otherwise."""
        return max(MAX_AGE_PERIODS * (every * self.stretch or self.round), LEAST_MAX_AGE)


def pace_of(section: LineSection, models: Catalogue, timing: LineTiming) -> Pace:
    """Reckon the pace of a line from the polls of all its drives."""
    load = turn = 0.0
    for drive in section.drive:
        codec, read = PROTOCOLS[drive.protocol], ReadWords(drive.number, 0)
        size, answer = len(codec.encode(read)), codec.answer_size(read)
        single = timing.exchange(size, answer, models[drive.model].times.processing + drive.wait_time)
        for poll in polls_of(drive, models[drive.model]):
            if poll.every:
                load += len(poll.values) * single / poll.every
            else:
                turn += len(poll.values) * single
    return Pace(max(1.0, load), turn / max(LEAST_REST, 1 - load))


def polls_of(section: DriveSection, model: Model) -> list[PollSection]:
    """Return what is read of a drive: what is configured, or the model's profile."""
    profile = ({"values": list(values), "every": every} for values, every in model.profile)
    return section.poll or [PollSection.model_validate(poll) for poll in profile]
