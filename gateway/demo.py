"""The demonstration: simulated drives, a broker on loopback, the real gateway, and a live view of it all."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import signal
import socket
import subprocess  # the gateway and the line run as a user would run them
import sys
import tempfile
import urllib.request
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from paho.mqtt import client as mqtt
from paho.mqtt.enums import CallbackAPIVersion
from rich import box
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from gateway import site
from gateway.errors import GatewayError
from gateway.image import DriveImage

REFRESH = 0.5  # seconds between two pictures
START_LIMIT = 20.0  # seconds for the gateway to answer
END_LIMIT = 10.0  # seconds for a program to end in order
DRIVES = (
    ("pump-1", 1, "vf-nc3", "modbus-rtu"),
    ("pump-2", 2, "vf-nc3", "toshiba-binary"),
    ("fan-1", 3, "vf-mb1", "toshiba-binary"),
)
MIXER = ("mixer-1", 4, "vf-nc3", "modbus-rtu")  # stands still until somebody commands it
CONTROL = """control = "leased"
lease = "60s"
communication_timeout = "3s"
timeout_action = "stop"
frequency = { min = 0.0, max = 50.0 }
"""
F829 = {"modbus-rtu": "modbus-rtu", "toshiba-binary": "toshiba"}

LINE = """\
baud = 19200
parity = "even"
{drives}
"""

DRIVE = """
[[drive]]
number = {number}
model = "{model}"
protocol = "{protocol}"
block_read = [1, 2, 3, 4, 5]
running_at = {hz}
"""


@dataclass(frozen=True, slots=True)
class Ports:
    """The loopback ports of the demonstration."""

    mqtt: int = 1883
    modbus_tcp: int = 5020
    web: int = 8080


@dataclass(slots=True)
class Seen:
    """What the broker and the gateway's metrics told so far."""

    states: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    metrics: dict[str, float] = field(default_factory=dict)
    rate: float = 0.0
    _before: tuple[float, float] = (0.0, 0.0)

    def take_metrics(self, metrics: dict[str, float], now: float) -> None:
        """Take a reading of /metrics; the exchanges per second follow from two of them."""
        total, (before, at) = metrics.get('tosvert_line_exchanges_total{line="a"}', 0.0), self._before
        if at:
            self.rate = (total - before) / (now - at)
        self.metrics, self._before = metrics, (total, now)


def run(ports: Ports, seconds: float | None = None) -> None:
    """Run the demonstration until Ctrl-C, or for that many seconds; GatewayError says what is in the way."""
    for name, port in (("mqtt", ports.mqtt), ("modbus-tcp", ports.modbus_tcp), ("web", ports.web)):
        _check_port(name, port)
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_run(ports, seconds))


def _check_port(name: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            raise GatewayError(
                f"port {port} of 127.0.0.1 cannot be used: {error.strerror}; "
                f"end the program that has it, or choose another: tosvert-gateway demo --{name}-port NUMBER"
            ) from error


async def _run(ports: Ports, seconds: float | None) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    with tempfile.TemporaryDirectory(prefix="tosvert-demo-") as name:
        folder = Path(name)
        config = _write_files(folder, ports)
        async with _broker(ports.mqtt), _program(_simulate(folder)) as line:
            await _until(lambda: (folder / "line").exists(), line, "the simulated line")
            async with _program(["run", str(config)], folder / "gateway.log") as gateway:
                await _show(ports, site.load(config), gateway, folder / "gateway.log", stop, seconds)


def _simulate(folder: Path) -> list[str]:
    return ["simulate", str(folder / "line.toml"), "--link", str(folder / "line")]


def _write_files(folder: Path, ports: Ports) -> Path:
    speeds = (50.0, 35.0, 42.5, 0.0)
    drives = (
        DRIVE.format(number=number, model=model, protocol=F829[protocol], hz=hz)
        for (_, number, model, protocol), hz in zip((*DRIVES, MIXER), speeds, strict=True)
    )
    (folder / "line.toml").write_text(LINE.format(drives="".join(drives)))
    config = folder / "gateway.toml"
    config.write_text("".join(_gateway_file(folder, ports)))
    return config


def _gateway_file(folder: Path, ports: Ports) -> Iterator[str]:
    yield '[gateway]\nname = "demo"\n'
    yield f'[mqtt]\nurl = "mqtt://127.0.0.1:{ports.mqtt}"\nversion = "3.1.1"\n'
    yield f'[modbus_tcp]\nlisten = "127.0.0.1:{ports.modbus_tcp}"\n[web]\nlisten = "127.0.0.1:{ports.web}"\n'
    yield f'[[line]]\nname = "a"\nport = "{folder / "line"}"\nbaud = 19200\nparity = "even"\n'
    for name, number, model, protocol in (*DRIVES, MIXER):
        yield f'[[line.drive]]\nname = "{name}"\nnumber = {number}\nmodel = "{model}"\nprotocol = "{protocol}"\n'
    yield CONTROL


@contextlib.asynccontextmanager
async def _broker(port: int) -> AsyncIterator[None]:
    try:
        from amqtt.broker import Broker
    except ImportError as error:
        raise GatewayError('the demonstration needs its broker: pip install "tosvert-gateway[demo]"') from error
    for logger in ("amqtt", "transitions"):
        logging.getLogger(logger).setLevel(logging.CRITICAL)
    broker = Broker(
        {
            "listeners": {"default": {"type": "tcp", "bind": f"127.0.0.1:{port}"}},
            "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}},
        }
    )
    await broker.start()
    try:
        yield
    finally:
        await broker.shutdown()


@contextlib.asynccontextmanager
async def _program(arguments: list[str], log: Path | None = None) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run one of this package's commands, and end it in order."""
    with contextlib.ExitStack() as files:
        output = files.enter_context(log.open("wb")) if log else subprocess.DEVNULL
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "gateway", *arguments, stdout=output, stderr=output, start_new_session=True
        )
        try:
            yield process
        finally:
            if process.returncode is None:
                process.terminate()
            try:
                await asyncio.wait_for(process.wait(), END_LIMIT)
            except TimeoutError:
                process.kill()
                await process.wait()


async def _until(condition: Any, process: asyncio.subprocess.Process, what: str) -> None:
    async with asyncio.timeout(START_LIMIT):
        while not condition():
            if process.returncode is not None:
                raise GatewayError(f"{what} ended with exit code {process.returncode}")
            await asyncio.sleep(0.05)


async def _show(
    ports: Ports,
    configured: site.Site,
    process: asyncio.subprocess.Process,
    log: Path,
    stop: asyncio.Event,
    seconds: float | None,
) -> None:
    """Show what a subscriber and a reader of /metrics see, until stopped."""
    seen = Seen()
    subscriber = _subscriber(ports.mqtt, seen)
    images = [DriveImage(drive) for drive in configured.drives]
    loop = asyncio.get_running_loop()
    end = None if seconds is None else loop.time() + seconds
    console = Console()
    for line in _hints(ports):
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    try:
        with Live(console=console, refresh_per_second=4, transient=False) as live:
            while not stop.is_set() and (end is None or loop.time() < end):
                if process.returncode is not None:
                    raise GatewayError(f"the gateway ended with exit code {process.returncode}:\n{_text(log)}")
                with contextlib.suppress(OSError):
                    seen.take_metrics(await loop.run_in_executor(None, _read_metrics, ports.web), loop.time())
                live.update(_picture(images, seen))
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(stop.wait(), REFRESH)
    finally:
        subscriber.disconnect()
        subscriber.loop_stop()


def _text(log: Path) -> str:
    return log.read_text(encoding="utf-8", errors="replace")


def _subscriber(port: int, seen: Seen) -> mqtt.Client:
    client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="demo-view")

    def on_message(_client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        with contextlib.suppress(ValueError):
            seen.states[message.topic.split("/")[2]] = json.loads(message.payload, parse_float=str)

    client.on_connect = lambda client, *_: client.subscribe("tosvert/demo/+/state")
    client.on_message = on_message
    client.connect("127.0.0.1", port)
    client.loop_start()
    return client


def _read_metrics(port: int) -> dict[str, float]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=2) as answer:
        lines = answer.read().decode().splitlines()
    pairs = (line.rsplit(" ", 1) for line in lines if line and not line.startswith("#"))
    return {name: float(value) for name, value in pairs}


def _picture(images: list[DriveImage], seen: Seen) -> Group:
    """Draw a column a drive and a row a value, so that it fits 80 columns and 30 lines."""
    table = Table(title="three simulated drives on one RS485 line, 19200 8E1", box=box.SIMPLE)
    table.add_column("value", no_wrap=True)
    for image in images:
        table.add_column(f"{image.drive.name}, unit id {image.drive.unit}, {image.drive.protocol}", justify="right")
    states = [seen.states.get(image.drive.name, {}) for image in images]
    for name in dict.fromkeys(name for image in images for name in image.names):
        table.add_row(name, *(_shown(image, state, name) for image, state in zip(images, states, strict=True)))
    table.add_row("status in words", *(str(state.get("status_text") or "-") for state in states))
    table.add_row("quality", *(str(state.get("quality", "-")) for state in states))
    table.add_row("age", *(_age(image, seen) for image in images))
    load = seen.metrics.get('tosvert_line_load_ratio{line="a"}', 0.0)
    return Group(table, Text(f"line a: load {load:.0%}, {seen.rate:.0f} exchanges a second; Ctrl-C ends everything"))


def _shown(image: DriveImage, state: Mapping[str, Any], name: str) -> str:
    value = state.get(name)
    return "-" if value is None or name not in image.names else f"{value} {image.unit(name)}".strip()


def _age(image: DriveImage, seen: Seen) -> str:
    age = seen.metrics.get(f'tosvert_drive_age_seconds{{drive="{image.drive.name}",line="a"}}')
    return "-" if age is None else f"{age * 1000:.0f} ms"


def _hints(ports: Ports) -> Iterator[str]:
    """Yield where to look, and what to try."""
    yield f"MQTT 127.0.0.1:{ports.mqtt}: tosvert/demo/<drive>/<value>, tosvert/demo/<drive>/state (JSON)"
    yield f"MODBUS-TCP 127.0.0.1:{ports.modbus_tcp}: units 1-4 at the drives' own numbers (FD00H = 64768 is the"
    yield "  output frequency, FD01H the status); unit 255 is the compact map: 16 registers a drive from 0"
    yield f"HTTP http://127.0.0.1:{ports.web}/healthz and /metrics"
    yield "Try from another terminal:"
    yield f"  mosquitto_sub -p {ports.mqtt} -t 'tosvert/demo/#' -v"
    yield f"  mbpoll -m tcp -p {ports.modbus_tcp} -a 1 -0 -t 4:hex -r 64768 -c 2 -1 127.0.0.1"
    yield (
        "  python3 -c \"from pymodbus.client import ModbusTcpClient as C; c = C('127.0.0.1', "
        f"port={ports.modbus_tcp}); c.connect(); "
        'print(c.read_holding_registers(0, count=48, device_id=255).registers)"'
    )
    yield "(that one by .venv/bin/python3, where pymodbus is installed)"
    yield "Run the motor of mixer-1 for a minute, then see its lease end and the gateway stop it:"
    for command in ("take", "arm", '{"command": "run", "frequency": 30}'):
        yield f"  mosquitto_pub -p {ports.mqtt} -t tosvert/demo/mixer-1/command -m '{command}'"
