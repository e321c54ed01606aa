"""A simulated line as a program: a port to point a master at, until it is told to end."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gateway.errors import GatewayError
from gateway.sim.control import Control, ControlSocket
from gateway.sim.journal import Entry, Way, told
from gateway.sim.loop import LineLoop, sharpen
from gateway.sim.pty_port import PtyPort
from gateway.sim.settings import SimulatedLineConfig, install, notes

ENDING = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class OpenLine:
    """A line behind a port, its loop, and the control of both."""

    loop: LineLoop
    control: Control


def simulate(config: SimulatedLineConfig, *, control: Path | None, announce: Callable[[str], None]) -> None:
    """Run a simulated line until SIGINT or SIGTERM, and say what is done to it; call it in the main thread."""
    with opened(config, control) as line, _ended_by_signal(line.loop):
        sharpen()  # whoever reads the name of the port finds it served
        for text in describe(config, line.loop.port.name, control):
            announce(text)
        wire, begin = line.loop.wire, line.control.line.opened

        def tell(entry: Entry) -> None:
            if entry.way is Way.EVENT or (config.trace and entry.is_told):
                announce(told(entry, begin))

        wire.journal.listen(tell)
        line.loop.run()


@contextlib.contextmanager
def opened(config: SimulatedLineConfig, control: Path | None) -> Iterator[OpenLine]:
    """Open the port and the control socket, and take both away in the end; GatewayError says what is in the way."""
    with contextlib.ExitStack() as stack:
        with _blamed_on(f"link {config.link}" if config.link else "pseudo-terminal"):
            port = PtyPort(Path(config.link) if config.link else None)
        stack.callback(port.unplug)
        line = install(config, time.monotonic(), port)
        stack.callback(line.capture, None)
        loop = LineLoop(line.wire, port, config.baud if config.checks_baud else None)
        loop.started = line.opened  # one beginning for what is counted and for the journal's times
        stack.callback(loop.close)
        controls = Control(line, loop)
        if control is not None:
            with _blamed_on(f"control {control}"):
                stack.callback(ControlSocket(control, controls, loop).close)
        yield OpenLine(loop, controls)


@contextlib.contextmanager
def _blamed_on(what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise GatewayError(f"the simulated line cannot be opened: {what}: {reason}") from error


@contextlib.contextmanager
def _ended_by_signal(loop: LineLoop) -> Iterator[None]:
    before = {number: signal.signal(number, lambda *_: loop.stop()) for number in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def describe(config: SimulatedLineConfig, port: str, control: Path | None) -> Iterator[str]:
    """Say, a line each, what stands where."""
    yield f"port {config.link or port}" + (f" -> {port}" if config.link else "")
    checked = ", and the master's baud rate is checked" if config.checks_baud else ""
    answers = f"answers after {config.processing_time * 1000:g} ms"
    yield f"line {config.baud} 8{config.parity[0].upper()}1, {answers}{checked}"
    for drive in config.drive:
        name = f" ({drive.name})" if drive.name else ""
        running = f", running at {drive.running_at:g} Hz" if drive.running_at else ""
        yield f"drive {drive.number}{name} {drive.model} {drive.protocol or config.protocol}{running}"
    if config.event:
        yield f"scenario of {len(config.event)} event{'s' if len(config.event) > 1 else ''}"
    for note in notes(config):
        yield f"note: {note}"
    if control is not None:
        yield f"control {control}"
