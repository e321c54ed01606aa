"""The trace of one gateway: a tap for each line, and where what is told goes: ring, socket, files, log."""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from gateway import logs
from gateway.clock import Clock, SystemClock
from gateway.image import DriveImage, Image
from gateway.site import Site
from gateway.trace import place
from gateway.trace.channels import FramesChannel, log_bytes, log_points
from gateway.trace.faults import EVENTS, BadReplies, DriveWatch, Occasions
from gateway.trace.files import Recording, name_of, prune, write_ring
from gateway.trace.meaning import Meaning
from gateway.trace.record import Tap, Told
from gateway.trace.ring import Ring
from gateway.trace.server import TraceServer

log = logging.getLogger("gateway.trace")

LOOK_EVERY = 0.25  # seconds between two looks whether a file is due

Consumer = Callable[[str, Told], None]


class Tracing:
    """Takes what the lines tell; nothing that goes wrong here ends or delays a line."""

    def __init__(
        self,
        site: Site,
        clock: Clock | None = None,
        record: Path | None = None,
        environment: Mapping[str, str] = os.environ,
        *,
        is_continued: bool = False,
    ) -> None:
        section = site.config.trace
        self._name = site.config.gateway.name
        self._clock = clock or SystemClock()
        self._meanings = {line.name: Meaning(line) for line in site.lines}
        self._directory = place.directory(site, environment)
        self._most_files = section.files
        self.ring = Ring(section.frames)
        self._occasions = Occasions(section.pause) if section.on_fault and section.frames else None
        self._bad_replies = {line.name: BadReplies() for line in site.lines}
        self._drives = {drive.name: DriveWatch() for drive in site.drives}
        self._recording = (
            Recording(record, self._meanings, self._clock, is_continued=is_continued) if record is not None else None
        )
        self._server = (
            TraceServer(place.socket_path(site, environment), self._name, self._meanings, self.ring, self._clock)
            if section.serve
            else None
        )
        self._writing: asyncio.Task[None] | None = None
        self._consumers = list(self._chosen(section.frames))

    def _chosen(self, frames: int) -> Sequence[Consumer]:
        """Return whom every frame is told: what is off costs nothing."""
        wanted: list[tuple[bool, Consumer]] = [
            (frames > 0, self.ring.add),
            (self._occasions is not None, self._look_for_burst),
            (logging.getLogger(logs.FRAMES).isEnabledFor(logging.DEBUG), FramesChannel(self._meanings).take),
            (logging.getLogger(logs.BYTES).isEnabledFor(logging.DEBUG), log_bytes),
        ]
        if self._server is not None:
            wanted.append((True, self._server.take))
        if self._recording is not None:
            wanted.append((True, self._recording.take))
        return [consumer for is_wanted, consumer in wanted if is_wanted]

    def tap(self, line: str) -> Tap | None:
        """Return what the line with that name is to tell; None where nobody wants to know."""
        if not self._consumers:
            return None

        def tell(told: Told) -> None:
            for consumer in self._consumers:
                try:
                    consumer(line, told)
                except Exception:  # the line must go on, whatever is wrong with its trace
                    log.exception("a part of the trace fails and is left out from now on")
                    self._consumers = [other for other in self._consumers if other is not consumer]

        return tell

    # ---- faults

    def watch(self, image: Image) -> None:
        """Look for faults of the drives, and log values where that is wanted."""
        if self._occasions is not None:
            image.subscribe(self._on_change)
        if logging.getLogger(logs.POINTS).isEnabledFor(logging.DEBUG):
            log_points(image)

    def _on_change(self, image: DriveImage, names: Sequence[str]) -> None:
        if not names and (fault := self._drives[image.drive.name].take(image.link, image.is_tripped)):
            self._fault(f"{image.drive.name}: {fault}")

    def on_event(self, drive: str, event: str, reason: str) -> None:
        """Take an event of the door."""
        if event in EVENTS:
            self._fault(f"{drive}: {event.replace('_', ' ')}: {reason}")

    def _look_for_burst(self, line: str, told: Told) -> None:
        if self._bad_replies[line].take(told):
            self._fault(f"line {line}: bad replies")

    def _fault(self, reason: str) -> None:
        if self._occasions is not None:
            self._occasions.fault(reason, self._clock.now())

    # ---- files

    def write_now(self) -> None:
        """Write the ring to a file, whatever the time (SIGUSR1)."""
        if self._writing is None or self._writing.done():
            self._writing = asyncio.create_task(self._write("asked for by SIGUSR1"))

    async def _write(self, reason: str) -> None:
        told, wall = self.ring.all(), self._clock.wall()
        path, offset = self._directory / name_of(self._name, wall), wall - self._clock.now()
        try:
            await asyncio.to_thread(write_ring, path, told, self._meanings, offset, reason)
            await asyncio.to_thread(prune, self._directory, self._name, self._most_files)
        except OSError as error:
            log.warning("%s: the latest frames cannot be written: %s (%s)", path, error.strerror, reason)
        except Exception:  # as for a tap: no reason to end
            log.exception("the latest frames cannot be written")
        else:
            log.info("the latest frames are in %s: %s", path, reason)

    async def start(self) -> None:
        """Serve the socket."""
        if self._server is not None:
            await self._server.start()

    async def run(self) -> None:
        """Write a file whenever one is due, until cancelled."""
        while True:
            await asyncio.sleep(LOOK_EVERY)
            await self._write_due(self._clock.now())

    async def _write_due(self, now: float) -> None:
        if self._occasions is not None and (reason := self._occasions.take(now)) is not None:
            await self._write(reason)

    async def stop(self) -> None:
        """Write what is due, and end."""
        if self._occasions is not None and self._occasions.due < float("inf"):
            await self._write_due(self._occasions.due)
        if self._writing is not None:
            await self._writing
        if self._server is not None:
            await self._server.stop()
        if self._recording is not None:
            await asyncio.to_thread(self._recording.close)
