"""Polls of one line, and whatever else is read or set for its drives' sake: one exchange, finished in one place."""

from __future__ import annotations

from collections.abc import Callable

from gateway.bus.exchange import Answered, Exchanger
from gateway.bus.learning import Learning
from gateway.bus.line import LATE_AT_MOST
from gateway.bus.link import Heard
from gateway.bus.links import Links
from gateway.bus.schedule import AHEAD, Job
from gateway.bus.station import ServedLine, Station
from gateway.bus.trips import Trips
from gateway.bus.work import Task, Work
from gateway.errors import BadReply, NoReply, Refusal, Refused
from gateway.protocol.pdu import WriteStored

IN_VAIN = 3  # polls without an answer in a row, from which on a drive is asked more seldom


class Polls:
    """Carries out what is scheduled; `count_stored` keeps count of writes to the EEPROM, by drive and number."""

    def __init__(
        self,
        served: ServedLine,
        links: Links,
        learning: Learning,
        trips: Trips,
        count_stored: Callable[[str, int], None] | None,
    ) -> None:
        self._served = served
        self._links = links
        self._learning = learning
        self._trips = trips
        self._count_stored = count_stored
        self._stations = served.stations
        self._schedule = served.schedule
        self._clock = served.clock

    async def exchange(
        self, exchanger: Exchanger, job: Job[Work], started: float, babble: BadReply | None = None
    ) -> None:
        """Carry out one exchange; whatever comes of it is finished here and nowhere else.

        `started` is since when the line was waited for, in monotonic seconds: what comes to nothing has cost that.
        `babble` is why the line is not free for it: then nothing is sent, nor waited for a second time.
        """
        station = self._stations[job.drive]
        station.stats.exchanges += 1
        asked_since = job.due if job.period else job.waits_since
        request = job.work.request
        if isinstance(request, WriteStored):
            station.stats.eeprom_writes[request.address] += 1
            if self._count_stored is not None:
                self._count_stored(job.drive, request.address)
        try:
            if babble is not None:
                raise babble
            answered = await exchanger.exchange(station.drive.codec, request, station.processing_of(request))
        except (NoReply, BadReply) as error:
            self._unanswered(station, job, error, started)
        except Refused as refused:
            self._refused(station, job, refused, started)
        else:
            if job.work.task is Task.POLL and job.period is not None and job.period in station.stats.responses:
                station.stats.responses[job.period].observe(answered.done - asked_since)
            self._answered(station, job, answered)

    def _answered(self, station: Station, job: Job[Work], answered: Answered) -> None:
        station.stats.answers.observe(answered.done - answered.sent)
        self._links.note(station, answered.done)
        if job.work.task is not Task.IDENTIFY:
            station.vain = 0
        if answered.reply is not None:
            learnt = station.reader.on_reply(job.work, answered.reply, answered.done)
            self._learning.learn(station, job, learnt, answered.done)
            if not learnt.stranger:
                self._trips.read(station, learnt.words, answered.done, flag=answered.reply.is_tripped)

    def _refused(self, station: Station, job: Job[Work], refused: Refused, started: float) -> None:
        """Take a refusal; one for a wrong checksum says that the request was damaged on its way."""
        if refused.reason is Refusal.CHECKSUM:
            self._unanswered(station, job, BadReply(str(refused)), started)
            return
        now = self._clock.now()
        station.stats.refusals += 1
        self._served.stats.errors["refused"] += 1
        self._links.note(station, now, is_good=False)
        self._learning.learn(station, job, station.reader.on_refused(job.work, refused, now))
        if station.link.state.is_connected:
            self._trips.told(station, refused.is_tripped, now)

    def _unanswered(self, station: Station, job: Job[Work], error: NoReply | BadReply, started: float) -> None:
        """Count silence or garbage, and decide how the drive is tried next.

        The next request differs in form from the one without an answer (an identification), so that a late
        answer to the old one cannot be taken for its answer; and the drive is asked nothing else for a while.
        """
        now = self._clock.now()
        self._links.missed(station, error)
        name = station.drive.name
        self._links.hear(station, Heard.SILENCE, str(error))
        is_lost = station.is_lost
        if self._schedule.is_probed(name):
            self._learning.ask_again(station, job, started)
        elif is_lost:
            station.forget()
            self._learning.ask_again(station, job, started)
        else:
            station.vain += job.work.task is not Task.IDENTIFY
            station.quiet_until = now + self._pause(station, now - started)
            self._learning.unanswered(station, job, now)
            self._schedule.hold(name, station.quiet_until)
            self._schedule.add(Job(name, station.reader.identify(), None, now, AHEAD))

    def _pause(self, station: Station, cost: float) -> float:
        """Return how long a drive is left alone that did not answer, in seconds: at first as a late answer may take.

        One that says who it is and answers nothing else would cost a time-out each time: the longer that goes on, the
        longer the pause, until all such drives together keep to the share of silent ones.
        """
        line = self._served.line
        late = max(LATE_AT_MOST, 2 * line.margin)
        such = sum(other.vain >= IN_VAIN for other in self._stations.values())
        longest = max(late, such * cost / line.silent_share)
        return min(longest, late * 2.0 ** max(0, station.vain - IN_VAIN + 1))
