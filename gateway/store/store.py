"""The store: counts writes to the EEPROM for good, and keeps the audit, in a thread that alone waits for the disk.

It stands beside the path of control (SAFETY.md H35). Whatever is wrong with its file, drives are commanded as before;
only writes to their EEPROM are refused, since they could not be counted, and it is tried again and again. Counts that
were lost with a damaged file are not taken to be 0: such writes are refused until an operator has accepted how often
a parameter was written at most. Setpoints and run commands are kept as words of the audit, never to be sent again.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
from collections.abc import Callable, Mapping
from pathlib import Path

from gateway.clock import Clock
from gateway.config import StoreSection
from gateway.control.ledger import Counted, Entry
from gateway.control.wear import Key, Wear, last_write
from gateway.site import Site
from gateway.store.inbox import Write
from gateway.store.schema import Saved
from gateway.store.thread import Pace, StoreThread

log = logging.getLogger("gateway.store")

FILE = "state.sqlite"
ANSWER_WITHIN = 1.0  # seconds for the disk to take a count, before the write is refused
CLOSE_WITHIN = 3.0  # seconds for the last rows to be written when the gateway ends
NOT_YET = "the store is not open yet"
ENDED = "the gateway ends"
HANGS = "the disk does not answer"
PACE = Pace()


def store_path(section: StoreSection, folder: Path, environment: Mapping[str, str] = os.environ) -> Path:
    """Return where the file is: as configured, else in $STATE_DIRECTORY, else in the configuration file's folder."""
    if section.path is not None:
        return folder / section.path
    state = environment.get("STATE_DIRECTORY", "").split(":")[0]  # systemd lists several with colons
    return (Path(state) if state else folder) / FILE


def needs_store(site: Site) -> bool:
    """Say whether anything is ever written to a drive, or Sparkplug counts its connections."""
    return site.config.sparkplug is not None or any(drive.is_controlled or drive.provision for drive in site.drives)


class Reservation:
    """One write that is to be counted: `then` is told once, by the disk, or that it does not answer in time."""

    def __init__(self, then: Counted, loop: asyncio.AbstractEventLoop, on_late: Callable[[], None]) -> None:
        self._then = then
        self._on_late = on_late
        self._timer = loop.call_later(ANSWER_WITHIN, self._give_up)
        self._is_told = False

    def tell(self, problem: str) -> None:
        """Tell what became of it; later it is too late."""
        if not self._is_told:
            self._is_told = True
            self._timer.cancel()
            self._then(problem)

    def _give_up(self) -> None:
        self._on_late()
        self.tell(HANGS)


class Store:
    """A ledger in a file. All of it is for the event loop; nothing here waits for the disk."""

    def __init__(self, path: Path, audit_rows: int, clock: Clock, pace: Pace = PACE) -> None:
        self.path = path
        self._clock = clock
        self._wear: dict[Key, Wear] = {}
        self._begins_at = 0
        self._problem = NOT_YET
        self._lost = ""
        self._hangs = ""
        self._is_loaded = False
        self._kept: dict[str, str] = {}
        self._was_read = asyncio.Event()
        self._ended = asyncio.Event()
        self._thread = StoreThread(path, audit_rows, pace, self, self._post)
        self._loop: asyncio.AbstractEventLoop | None = None

    @classmethod
    def of(cls, site: Site, clock: Clock, environment: Mapping[str, str] = os.environ) -> Store | None:
        """Return the store of a site; None where there is nothing to keep."""
        section = site.config.store
        if not needs_store(site):
            return None
        return cls(store_path(section, site.folder, environment), section.audit_rows, clock)

    def start(self) -> None:
        """Begin to open the file; until it is open there is a `problem`."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    async def close(self) -> None:
        """Write what waits and let the file go; a disk that hangs is not waited for."""
        self._problem = ENDED
        if self._loop is None:
            return
        self._thread.inbox.end()
        try:
            await asyncio.wait_for(self._ended.wait(), CLOSE_WITHIN)
        except TimeoutError:
            log.warning("%s: the disk does not answer; the last rows of the audit may be lost", self.path)

    # ---- what control asks

    @property
    def problem(self) -> str:
        """Say why nothing can be counted for good; "" while all is well."""
        return self._problem or self._lost or self._hangs

    @property
    def dropped(self) -> int:
        """Return how many rows of the audit were dropped since the start."""
        return self._thread.inbox.dropped

    @property
    def wear(self) -> Mapping[Key, Wear]:
        """Return all that was counted; times are monotonic seconds."""
        return self._wear

    def count(self, drive: str, address: int) -> int:
        """Return how many writes of a parameter were counted, before the last start too."""
        return self._of((drive, address)).writes

    def last(self, drive: str) -> float:
        """Return when a write to the drive was counted last; -inf where none was."""
        return last_write(self._wear, drive)

    def reserve(self, drive: str, address: int, then: Counted) -> None:
        """Count a write for good; `then` is called when that is done, or at once where it cannot be."""
        if self.problem:
            then(self.problem)
            return
        assert self._loop is not None  # noqa: S101 - there is a problem until it is started
        reservation = Reservation(then, self._loop, self._hang)

        def told(problem: str) -> None:
            self._hangs = ""
            reservation.tell(problem)

        self._add((drive, address), told)

    def note(self, drive: str, address: int) -> None:
        """Count a write that is made anyway; while the file is away it is remembered until it is back."""
        self._add((drive, address), None)

    def record(self, entry: Entry) -> None:
        """Add a row to the audit; it is dropped where too many wait."""
        self._thread.inbox.append(entry)

    # ---- what others keep

    async def recalled(self, key: str, within: float) -> str:
        """Return a short text that was kept, "" where none was, or the file was not open in so many seconds."""
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._was_read.wait(), within)
        return self._kept.get(key, "")

    def keep(self, key: str, text: str) -> None:
        """Keep a short text; while the file is away it is remembered until it is back."""
        self._kept[key] = text
        self._thread.inbox.keep(key, text)

    def _of(self, key: Key) -> Wear:
        return self._wear.get(key) or Wear(self._begins_at)

    def _add(self, key: Key, then: Counted | None) -> None:
        self._wear[key] = self._of(key).after_write(self._clock.now())
        self._write(key, then)

    def _write(self, key: Key, then: Counted | None = None) -> None:
        wear = self._wear[key]
        self._thread.inbox.write(Write(key, Wear(wear.writes, wear.pace, wear.last + self._to_utc), then))

    @property
    def _to_utc(self) -> float:
        return self._clock.wall() - self._clock.now()

    # ---- what the thread tells, in the event loop

    def _post(self, call: Callable[..., None], *arguments: object) -> None:
        """Have something called in the event loop; called by the thread, perhaps after the loop has ended."""
        assert self._loop is not None  # noqa: S101 - set before the thread is started
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(call, *arguments)

    def ended(self) -> None:
        """Take that the thread has ended."""
        self._ended.set()

    def _hang(self) -> None:
        """Take that the disk does not answer: until it does, nothing more is asked of it."""
        if not self._hangs:
            log.error("%s: %s: writes to the EEPROM are refused, all else goes on", self.path, HANGS)
        self._hangs = f"{self.path}: {HANGS}"

    def away(self, problem: str) -> None:
        """Take that the file cannot be used."""
        if self._problem not in (ENDED, problem):
            log.error("%s: writes to the EEPROM are refused, all else goes on", problem)
            self._problem = problem

    def opened(self, saved: Saved) -> None:
        """Take what the file holds, and have written what it does not hold yet; counts only go up."""
        mine, self._wear = self._wear, {key: self._loaded(wear) for key, wear in saved.wear.items()}
        before, self._begins_at = self._begins_at, max(self._begins_at, saved.begins_at)
        for key, wear in mine.items():
            self._wear[key] = self._joined(key, wear, before)
            if self._wear[key].writes > saved.wear.get(key, Wear()).writes:
                self._write(key)
        self._is_loaded = True
        self._kept = {**saved.kept, **self._kept}
        self._was_read.set()
        self._lost = f"{saved.lost}; accept a count by `tosvert-gateway store accept`" if saved.lost else ""
        if self._lost:
            log.error("writes to the EEPROM are refused: %s", self._lost)
        if self._problem not in ("", NOT_YET, ENDED):
            log.info("%s is open again", self.path)
        self._problem = self._problem if self._problem == ENDED else ""

    def _joined(self, key: Key, mine: Wear, before: int) -> Wear:
        """Return the account of a parameter: what came before the first look at the file is added to it."""
        if self._is_loaded:
            return self._of(key).joined(mine)
        held = self._of(key)
        return Wear(held.writes + mine.writes - before, held.pace + mine.pace, max(held.last, mine.last))

    def _loaded(self, wear: Wear) -> Wear:
        """Return what was saved by monotonic time; what lies in the future, by a clock set back, is now."""
        now = self._clock.now()
        return Wear(wear.writes, wear.pace, min(now, wear.last - self._to_utc))
