"""The web server on a real socket."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path

import aiohttp
import pytest
import uvloop
from prometheus_client.parser import text_string_to_metric_families

from gateway.config import WebSection
from gateway.errors import GatewayError
from gateway.image import LinkState
from gateway.web import server as web_server
from gateway.web.server import WebServer
from tests.web.rig import Rig


def serve(rig: Rig, listen: str = "127.0.0.1:0") -> WebServer:
    """Return a server for the rig, not yet started."""
    return WebServer(WebSection(listen=listen), rig.image, rig.stats, rig.built, rig.clock)


@pytest.fixture
def rig() -> Rig:
    """Every line up, every drive just heard."""
    made = Rig()
    made.open()
    made.answer()
    return made


@pytest.fixture
async def server(rig: Rig) -> AsyncIterator[WebServer]:
    """Run a server on a port of its own."""
    running = serve(rig)
    await running.start()
    yield running
    await running.stop()


@pytest.fixture
async def client(server: WebServer) -> AsyncIterator[aiohttp.ClientSession]:
    """Return a client of that server."""
    async with aiohttp.ClientSession(f"http://127.0.0.1:{server.port}") as session:
        yield session


async def test_healthz_is_200_while_the_data_are_fresh(client: aiohttp.ClientSession) -> None:
    """And says so in JSON."""
    async with client.get("/healthz") as response:
        assert response.status == 200
        assert response.content_type == "application/json"
        document = await response.json()
    assert (document["status"], document["reasons"]) == ("ok", [])


@pytest.mark.hazard("H19")
async def test_healthz_turns_503_by_the_age_of_the_data_alone(client: aiohttp.ClientSession, rig: Rig) -> None:
    """Nobody tells the server: time passes, and the answer changes; it changes back with the next answers."""
    rig.clock.moment += 1.5
    async with client.get("/healthz") as response:
        assert response.status == 503
        document = await response.json()
    assert document["status"] == "fail"
    assert len(document["reasons"]) == 3
    rig.answer()
    async with client.get("/healthz") as response:
        assert response.status == 200


async def test_healthz_is_503_when_a_drive_is_silent(client: aiohttp.ClientSession, rig: Rig) -> None:
    """And says which one, and why."""
    rig.image.by_name["fan"].set_link(LinkState.OFFLINE, "no answer to 3 requests")
    async with client.get("/healthz") as response:
        assert response.status == 503
        document = await response.json()
    assert document["reasons"] == ["drive fan: offline: no answer to 3 requests"]
    assert document["drives"]["fan"]["link"] == "offline"
    assert document["drives"]["pump-1"]["quality"] == "good"


async def test_healthz_is_503_when_a_line_is_down(client: aiohttp.ClientSession, rig: Rig) -> None:
    """Before the values have aged."""
    rig.stats.lines["a"].is_up = False
    async with client.get("/healthz") as response:
        assert response.status == 503
        assert (await response.json())["reasons"] == ["line a: down"]


async def test_metrics_are_prometheus_text(client: aiohttp.ClientSession, rig: Rig) -> None:
    """The text form 0.0.4, read at scrape time, with the process' own metrics."""
    rig.stats.lines["a"].exchanges = 4711
    async with client.get("/metrics") as response:
        assert response.status == 200
        assert response.headers["Content-Type"] == "text/plain; version=0.0.4; charset=utf-8"
        text = await response.text()
    found = {family.name: family for family in text_string_to_metric_families(text)}
    assert [s.value for s in found["tosvert_line_exchanges"].samples if s.labels == {"line": "a"}] == [4711]
    assert "process_start_time_seconds" in found


async def test_the_start_page_links_both(client: aiohttp.ClientSession) -> None:
    """And says what it is not."""
    async with client.get("/") as response:
        assert response.status == 200
        assert response.content_type == "text/html"
        text = await response.text()
    assert "not a safety function" in text
    for link in ("/healthz", "/metrics"):
        assert f'href="{link}"' in text


@pytest.mark.parametrize("path", ["/", "/healthz", "/metrics"])
async def test_head_is_answered_like_get(client: aiohttp.ClientSession, path: str) -> None:
    """The same status and headers, no body."""
    async with client.head(path) as response:
        assert response.status == 200
        assert int(response.headers["Content-Length"]) > 0
        assert await response.read() == b""


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
async def test_nothing_but_get_and_head_is_served(client: aiohttp.ClientSession, method: str) -> None:
    """The server is read-only."""
    async with client.request(method, "/healthz") as response:
        assert response.status == 405
        assert response.headers["Allow"] == "GET,HEAD"


async def test_an_unknown_path_is_404(client: aiohttp.ClientSession) -> None:
    """And answered with the same headers as everything."""
    async with client.get("/etc/passwd") as response:
        assert response.status == 404
        assert response.headers["Cache-Control"] == "no-store"
        assert response.headers["Server"] == "tosvert-gateway"


async def test_a_port_in_use_is_explained(server: WebServer, rig: Rig) -> None:
    """Key and port stand in the message; the first server goes on."""
    second = serve(rig, f"127.0.0.1:{server.port}")
    with pytest.raises(GatewayError, match=rf"web\.listen.*127\.0\.0\.1:{server.port}.*in use"):
        await second.start()
    await second.stop()
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    writer.write(b"GET /healthz HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
    head, _, body = (await reader.read()).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 200")
    assert json.loads(body)["status"] == "ok"
    writer.close()


async def test_a_stopped_server_gives_its_port_back(rig: Rig) -> None:
    """Open connections are closed, and the port can be had again."""
    first = serve(rig)
    await first.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", first.port)
    writer.write(b"GET / HTTP/1.1\r\nHost: a\r\n\r\n")
    await reader.readuntil(b"</html>")
    await first.stop()
    assert (await reader.read()).strip() == b""
    writer.close()
    second = serve(rig, f"127.0.0.1:{first.port}")
    await second.start()
    assert second.port == first.port
    await second.stop()


async def asked(port: int) -> tuple[int | None, str]:
    """Return what the container's health check says of a port."""
    program = str(Path(__file__).parents[2] / "deploy" / "healthcheck.py")
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        program,
        env={"TOSVERT_WEB": f"127.0.0.1:{port}", "http_proxy": "http://127.0.0.1:9"},
        stdout=asyncio.subprocess.PIPE,
    )
    output, _ = await asyncio.wait_for(process.communicate(), 60)
    return process.returncode, output.decode().strip()


async def test_the_containers_health_check_says_what_healthz_says(server: WebServer, rig: Rig) -> None:
    """Exit code and reason, whatever proxy the environment names; no gateway at all is not healthy."""
    assert await asked(server.port) == (0, "ok")
    rig.stats.lines["a"].is_up = False
    assert await asked(server.port) == (1, "line a: down")
    await server.stop()
    code, text = await asked(server.port)
    assert code == 1
    assert "ConnectionRefusedError" in text


def test_it_serves_on_the_production_loop(rig: Rig) -> None:
    """The event loop of the daemon is uvloop's: start, answer, refuse a taken port, stop."""

    async def main() -> int:
        running = serve(rig)
        await running.start()
        with pytest.raises(GatewayError, match="in use"):
            await serve(rig, f"127.0.0.1:{running.port}").start()
        async with aiohttp.ClientSession(f"http://127.0.0.1:{running.port}") as session:
            async with session.get("/metrics") as response:
                assert "tosvert_line_up" in await response.text()
            async with session.get("/healthz") as response:
                status = response.status
        await running.stop()
        return status

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        assert runner.run(main()) == 200


async def test_stopping_without_a_start_is_no_error(rig: Rig) -> None:
    """The end of a start that failed elsewhere stops everything alike."""
    await serve(rig).stop()


@pytest.mark.hazard("H25")
async def test_idle_connections_cannot_shut_out_the_next_client(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the limit the oldest connection gives way, whether it has ever asked for anything or not."""
    monkeypatch.setattr(web_server, "CONNECTIONS", 4)
    server = serve(rig)
    await server.start()
    async with AsyncExitStack() as stack:
        stack.push_async_callback(server.stop)
        readers = []
        for _ in range(4):
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            stack.callback(writer.close)
            readers.append(reader)
        session = await stack.enter_async_context(aiohttp.ClientSession(f"http://127.0.0.1:{server.port}"))
        async with session.get("/healthz") as response:
            assert response.status == 200
        assert await readers[0].read() == b""
        assert not readers[1].at_eof()
