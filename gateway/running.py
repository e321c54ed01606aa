"""Runs the gateway from a file until it is told to end, and at SIGHUP with the file as it is then."""

from __future__ import annotations

import asyncio
import logging
from pathlib import Path

from gateway import check, logs
from gateway.app import App
from gateway.errors import BadConfig, GatewayError
from gateway.site import Site
from gateway.trace.tracing import Tracing

log = logging.getLogger("gateway")


def run(file: Path, loop: str | None = None, record: Path | None = None) -> None:
    """Run it on the loop that is named, or else configured; `record` is where every frame is captured."""
    configured = check.load(file)
    section = configured.config.gateway
    show = [logs.SHOWN[name] for name in section.log.show]
    logs.set_up(section.log.level, section.log.format, show=show)
    chosen = loop or section.loop
    if chosen not in ("uvloop", "asyncio"):
        raise BadConfig(f"--loop {chosen}: give uvloop or asyncio")
    factory = None
    if chosen == "uvloop":
        import uvloop

        factory = uvloop.new_event_loop
    with asyncio.Runner(loop_factory=factory) as runner:
        runner.run(_run(configured, file, record))


async def _run(configured: Site, file: Path, record: Path | None) -> None:
    """Run the gateway; at SIGHUP with the file as it is then."""
    logs.watch_loop(asyncio.get_running_loop())
    successor: Site | None = configured
    before: Site | None = None  # what ran well, and is gone back to
    while successor is not None:
        check.warn(successor, file)
        running, gateway = successor, None
        try:
            tracing = Tracing(running, record=record, is_continued=running is not configured)
            gateway = App(running, load=lambda: check.load(file), tracing=tracing)
            await gateway.run()
        except GatewayError as error:
            if before is None or (gateway is not None and gateway.has_started):
                raise
            log.error("not reloaded, the gateway goes back to what it was: %s", error)
            successor, before = before, None
        else:
            successor, before = gateway.successor, running
