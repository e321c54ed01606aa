"""One line as it is served, and each of its drives: what those who serve it share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gateway import site
from gateway.bus.blocks import Planner
from gateway.bus.controls import LineControls
from gateway.bus.keepalive import Keepalive
from gateway.bus.link import Link
from gateway.bus.poll_jobs import phases
from gateway.bus.reader import DriveReader
from gateway.bus.refresh import WorstCase, turn, worst_case
from gateway.bus.schedule import Job, Schedule
from gateway.bus.work import Task, Work
from gateway.clock import Clock
from gateway.control.drive_control import DriveControl
from gateway.image import DriveImage, LinkState
from gateway.metrics import DriveStats, LineStats
from gateway.protocol.pdu import ReadBlock, Request, WriteStored

LOST = (LinkState.OFFLINE, LinkState.STRANGER, LinkState.LINE_DOWN)


class Station:
    """One drive as this line serves it: its reader, its link, and where its values and counts go."""

    def __init__(
        self, drive: site.Drive, image: DriveImage, stats: DriveStats, planner: Planner, reader: DriveReader
    ) -> None:
        self.drive = drive
        self.image = image
        self.stats = stats
        self.planner = planner
        self.reader = reader
        self.link = Link()
        self.vain = 0  # polls without an answer in a row, whoever it says it is
        self.trip_looked = float("-inf")  # when the trip code was read anew because the status says otherwise
        self.is_tripped: bool | None = None  # by its last answer that said so, before it is online as well
        self.trip_signs: dict[str, bool] = {}  # MODBUS-RTU: by FC90, and by the bit in FD01
        self.is_left_alone = False  # by its control, so that its own time-out acts
        self.quiet_until = float("-inf")  # nothing but identifications before: a late answer might be believed
        self.turn = 0.0  # seconds that a keepalive exchange may take, where it is commanded
        self.processing = drive.model.times.processing + drive.wait_time

    def processing_of(self, request: Request) -> float:
        """Return how long the drive may take for a request, in seconds: longer for a write to its EEPROM."""
        if isinstance(request, WriteStored):
            return self.drive.model.times.eeprom + self.drive.wait_time
        return self.processing

    @property
    def is_lost(self) -> bool:
        """Say whether its link is lost, or another drive answers."""
        return self.link.state in LOST

    def forget(self) -> None:
        """Forget all that a reset or another drive may have changed."""
        self.reader.forget()
        self.is_tripped = None
        self.trip_signs.clear()


@dataclass(slots=True)
class ServedLine:
    """One line, its drives by name, and what goes over it: whoever serves a part of it changes it here."""

    line: site.Line
    stations: Mapping[str, Station]
    controls: LineControls
    schedule: Schedule[Work]
    stats: LineStats
    clock: Clock
    worst: WorstCase

    @classmethod
    def of(
        cls,
        line: site.Line,
        images: Mapping[str, DriveImage],
        stats: LineStats,
        drive_stats: Mapping[str, DriveStats],
        clock: Clock,
        controls: Mapping[str, DriveControl],
    ) -> ServedLine:
        """Return a line of which nothing was heard yet; `controls` may be those of more drives than its own."""
        own = {drive.name: controls[drive.name] for drive in line.drives if drive.name in controls}
        stations = {}
        shifts = phases(line.drives)
        for place, drive in enumerate(line.drives):
            processing = drive.model.times.processing + drive.wait_time
            planner = Planner(drive.number, drive.model, drive.codec, line.timing, processing)
            reader = DriveReader(drive, planner, place, len(line.drives), shifts[drive.name])
            stations[drive.name] = Station(drive, images[drive.name], drive_stats[drive.name], planner, reader)
            if drive.name in own:
                stations[drive.name].turn = turn(line, drive)
        worst = worst_case(line)
        deadlines = Keepalive(worst.lead if own else 0.0)
        schedule: Schedule[Work] = Schedule(line.silent_share, line.probe_every, line.probe_at_most)
        return cls(line, stations, LineControls(own, deadlines), schedule, stats, clock, worst)

    def control_of(self, station: Station) -> DriveControl | None:
        """Return the control of a drive; None where it is read only."""
        return self.controls.controls.get(station.drive.name)

    def block_poll(self, station: Station) -> Job[Work] | None:
        """Return the poll of a drive's block."""
        jobs = self.schedule.jobs(station.drive.name)
        polls = (job for job in jobs if job.work.task is Task.POLL and isinstance(job.work.request, ReadBlock))
        return next(polls, None)
