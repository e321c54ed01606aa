"""A simulated line as a program: a port to point a master at, until it is told to end."""

from __future__ import annotations

import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from gateway.errors import GatewayError
from gateway.sim.control import ControlSocket
from gateway.sim.loop import LineLoop
from gateway.sim.pty_port import PtyPort
from gateway.sim.settings import SimulatedLineConfig, build, doubled_numbers

ENDING = (signal.SIGINT, signal.SIGTERM)


def simulate(config: SimulatedLineConfig, *, control: Path | None, announce: Callable[[str], None]) -> None:
    """Run a simulated line until SIGINT or SIGTERM; call it in the main thread."""
    with opened(config, control) as loop, _ended_by_signal(loop):
        for line in describe(config, loop.port.name, control):
            announce(line)
        loop.run()


@contextlib.contextmanager
def opened(config: SimulatedLineConfig, control: Path | None) -> Iterator[LineLoop]:
    """Open the port and the control socket, and take both away in the end; GatewayError says what is in the way."""
    with contextlib.ExitStack() as stack:
        try:
            port = PtyPort(Path(config.link) if config.link else None)
            stack.callback(port.unplug)
            loop = LineLoop(build(config, time.monotonic()), port)
            stack.callback(loop.close)
            if control is not None:
                stack.callback(ControlSocket(control, loop).close)
        except OSError as error:
            raise GatewayError(f"the simulated line cannot be opened: {error}") from error
        yield loop


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
    yield f"line {config.baud} 8{config.parity[0].upper()}1, answers after {config.processing_time * 1000:g} ms"
    for drive in config.drive:
        running = f", running at {drive.running_at:g} Hz" if drive.running_at else ""
        yield f"drive {drive.number} {drive.model}{running}"
    for number in doubled_numbers(config):
        yield f"note: {number} is the number of more than one drive: their answers collide"
    if control is not None:
        yield f"control {control}"
