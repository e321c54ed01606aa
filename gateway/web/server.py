"""Serves the start page, /healthz and /metrics over HTTP, read-only."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Iterable

from aiohttp import web
from prometheus_client import ProcessCollector, generate_latest
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from gateway.clock import Clock
from gateway.config import WebSection, address
from gateway.control.ledger import Ledger
from gateway.image import Image
from gateway.metrics import Stats
from gateway.ports import explain_bind_error
from gateway.site import Site
from gateway.web import page
from gateway.web.exposition import families

log = logging.getLogger("gateway.web")

CONNECTIONS = 64  # beyond it the oldest gives way: an answer takes milliseconds, so the oldest is idle
SHUTDOWN = 1.0  # seconds for answers under way when the server stops
EXPOSITION = "text/plain; version=0.0.4; charset=utf-8"  # Prometheus' text format
HEADERS = {
    "Server": "tosvert-gateway",
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
}


class WebServer:
    """The web server of one gateway; it reads the image and the counters and never waits for the bus."""

    def __init__(
        self,
        section: WebSection,
        image: Image,
        stats: Stats,
        site: Site,
        clock: Clock,
        ledger: Ledger | None = None,
    ) -> None:
        self._host, self._port = address(section.listen)
        self._image = image
        self._stats = stats
        self._site = site
        self._clock = clock
        self._ledger = ledger
        self._process = ProcessCollector(registry=None)
        self._listener: asyncio.Server | None = None
        application = web.Application()
        application.on_response_prepare.append(_add_headers)
        application.add_routes(
            [
                web.get("/", self._start_page),
                web.get("/healthz", self._healthz),
                web.get("/metrics", self._metrics),
            ]
        )
        self._runner = web.AppRunner(application, access_log=None, shutdown_timeout=SHUTDOWN)

    @property
    def port(self) -> int:
        """Return the TCP port that is listened on, the configured one before the start."""
        return self._port

    async def start(self) -> None:
        """Open the port; GatewayError says who has it."""
        await self._runner.setup()
        assert self._runner.server is not None  # noqa: S101 - set by setup
        turnstile = _Turnstile(self._runner.server)
        loop = asyncio.get_running_loop()
        try:
            self._listener = await loop.create_server(turnstile, self._host, self._port)
        except OSError as error:
            await self._runner.cleanup()
            raise explain_bind_error(error, self._host, self._port, "web.listen") from error
        self._port = self._listener.sockets[0].getsockname()[1]
        log.info("listening on http://%s:%d", self._host, self._port)

    async def stop(self) -> None:
        """Close the port and every connection."""
        if self._listener is not None:
            self._listener.close()
            self._listener = None
        await self._runner.cleanup()

    async def _start_page(self, _: web.Request) -> web.Response:
        return web.Response(text=page.start_page(self._site.config.gateway.name), content_type="text/html")

    async def _healthz(self, _: web.Request) -> web.Response:
        health = page.judge(self._site, self._image, self._stats, self._clock.now())
        document = page.as_document(health, self._site, self._stats, self._clock.wall(), self._ledger)
        return web.json_response(document, status=200 if health.is_well else 503, dumps=_dumps)

    async def _metrics(self, _: web.Request) -> web.Response:
        parts = []
        for family in self._families():
            parts.append(generate_latest(_One(family)))
            await asyncio.sleep(0)  # a line that waits for its gap is not held up by the whole scrape
        return web.Response(body=b"".join(parts), headers={"Content-Type": EXPOSITION})

    def _families(self) -> Iterable[Metric]:
        yield from families(self._site, self._image, self._stats, self._clock.now(), self._ledger)
        yield from self._process.collect()


class _One(Collector):
    """A registry of a single family, so that families are rendered one by one."""

    def __init__(self, family: Metric) -> None:
        self._family = family

    def collect(self) -> Iterable[Metric]:
        return (self._family,)


class _Turnstile:
    """Makes the protocol of each new connection, and lets the oldest connection go when there are too many."""

    def __init__(self, server: web.Server) -> None:
        self._server = server

    def __call__(self) -> asyncio.BaseProtocol:
        connections = self._server.connections
        if len(connections) >= CONNECTIONS:
            connections[0].force_close()
        return self._server()


async def _add_headers(_: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(HEADERS)


def _dumps(document: object) -> str:
    return json.dumps(document, indent=2, allow_nan=False)
