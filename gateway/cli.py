"""The command line: run, check, map, schema, registers, simulate, demo; scan, read, write, ...; store; trace."""

from __future__ import annotations

import asyncio
import json
import logging
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gateway import __version__, check, check_rights, logs, site
from gateway import demo as demonstration
from gateway.app import App, CoreTaskEnded
from gateway.clock import SystemClock
from gateway.commissioning import commands as commissioning
from gateway.config import Config
from gateway.drives import catalogue
from gateway.errors import BadConfig, GatewayError, Refused
from gateway.image import Image
from gateway.modbus_tcp import credentials, mapping, tags
from gateway.mqtt import topics
from gateway.mqtt.discovery import Discovery
from gateway.sim import runner, settings
from gateway.sparkplug import topics as sparkplug_topics
from gateway.store import backlog
from gateway.store import commands as store
from gateway.trace import commands as trace
from gateway.trace.tracing import Tracing

log = logging.getLogger("gateway")

EXIT_UNAVAILABLE = 69  # sysexits(3): the numbers that service managers know
EXIT_SOFTWARE = 70
EXIT_CONFIG = 78

app = typer.Typer(
    help="MODBUS-TCP and MQTT gateway for Toshiba TOSVERT drives on RS485. Not a safety function.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)

ConfigFile = Annotated[Path, typer.Argument(metavar="FILE", help="configuration file (TOML)")]


class MapFormat(StrEnum):
    """How the register map is printed."""

    MD = "md"
    CSV = "csv"
    JSON = "json"
    TAGS = "tags"


def run_command() -> None:
    """Run the command line; what the gateway can explain is explained in a line, never with a traceback."""
    try:
        app()
    except commissioning.WRONG_CALLS as error:
        _fail(error, EXIT_CONFIG)
    except Refused as error:
        _fail(error, commissioning.EXIT_NOT_DONE)
    except CoreTaskEnded as error:
        _fail(error, EXIT_SOFTWARE)
    except GatewayError as error:
        _fail(error, EXIT_UNAVAILABLE)


def _fail(error: GatewayError, code: int) -> None:
    typer.echo(f"tosvert-gateway: {error}".replace("\n", "\n  "), err=True)
    sys.exit(code)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tosvert-gateway {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """MODBUS-TCP and MQTT gateway for Toshiba TOSVERT drives on RS485. Not a safety function."""


@app.command()
def run(
    file: ConfigFile,
    loop: Annotated[str | None, typer.Option(help="uvloop or asyncio, instead of gateway.loop")] = None,
    record: Annotated[
        Path | None, typer.Option("--trace", metavar="FILE.pcapng", help="capture every frame for Wireshark")
    ] = None,
) -> None:
    """Run the gateway until SIGTERM or SIGINT."""
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
    with asyncio.Runner(loop_factory=factory) as runner_:
        runner_.run(_run(configured, file, record))


async def _run(configured: site.Site, file: Path, record: Path | None) -> None:
    """Run the gateway; at SIGHUP with the file as it is then."""
    logs.watch_loop(asyncio.get_running_loop())
    successor: site.Site | None = configured
    before: site.Site | None = None  # what ran well, and is gone back to
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


@app.command("check")
def check_file(
    file: ConfigFile,
    strict: Annotated[bool, typer.Option("--strict", help="an error, too, where polls may be answered late")] = False,
) -> None:
    """Check a configuration and print what it comes to: exchanges, load, topics, register map."""
    configured = site.load(file)
    for line in check.report(configured):
        typer.echo(line)
    for section in configured.config.brokers:
        way = "" if section.commands else ": nothing is taken from it"
        typer.echo(f"\nMQTT topics{f' of {section.label}{way}' if section.name else way}")
        for topic in topics.overview(section, configured):
            typer.echo(f"  {topic}")
        typer.echo(f"  {backlog.summary(configured, section)}")
        if section.home_assistant.enabled:
            for topic in Discovery(section, configured.config.gateway.name, Image(configured.drives)).topics():
                typer.echo(f"  {topic}")
    if configured.config.sparkplug is not None:
        typer.echo("\nSparkplug topics")
        for topic in sparkplug_topics.overview(configured.config.sparkplug, configured):
            typer.echo(f"  {topic}")
        typer.echo(f"  {backlog.summary(configured, configured.config.sparkplug)}")
    if configured.config.modbus_tcp is not None:
        typer.echo("")
        for line in check_rights.report(configured):
            typer.echo(line)
        if (tls := configured.config.modbus_tcp.tls) is not None:
            typer.echo(f"  {credentials.report(tls, SystemClock().wall())}")
        typer.echo("")
        typer.echo(mapping.as_markdown(mapping.register_map(configured)))
    check.refuse(configured, file)
    if strict:
        check.refuse_late(configured, file)
    typer.echo(f"\n{file}: no errors")


@app.command("map")
def print_map(
    file: ConfigFile,
    form: Annotated[
        MapFormat, typer.Option("--format", help="md, csv, json, or tags: a CSV for tag importers")
    ] = MapFormat.MD,
) -> None:
    """Print the MODBUS-TCP register map of a configuration, for the SCADA engineer."""
    document = mapping.register_map(site.load(file))
    printers = {
        MapFormat.MD: mapping.as_markdown,
        MapFormat.CSV: mapping.as_csv,
        MapFormat.JSON: mapping.as_json,
        MapFormat.TAGS: tags.as_tags,
    }
    typer.echo(printers[form](document), nl=form not in (MapFormat.CSV, MapFormat.TAGS))


@app.command()
def schema() -> None:
    """Print the JSON Schema of the configuration file, for editors."""
    typer.echo(json.dumps(Config.model_json_schema(), indent=2, sort_keys=True))


@app.command()
def registers(
    model: Annotated[str, typer.Argument(help="vf-nc3, vf-mb1, vf-as3, or one of your own")],
    catalogue_file: Annotated[list[Path] | None, typer.Option("--catalogue", help="a further catalogue file")] = None,
) -> None:
    """List the registers of a drive model: what can stand under `values`."""
    models = catalogue.load(catalogue_file or [])
    if model not in models:
        raise BadConfig(f"no model {model!r}; known: {', '.join(sorted(models))}")
    for register in sorted(models[model].registers.values(), key=lambda register: register.address):
        access = "read, write" if register.is_writable else "read"
        unit = f"{register.scaling.scale} {register.unit}".strip()
        typer.echo(f"{register.address:04X}  {register.name:34}{unit:12}{access:13}{register.title}")
    for derived in models[model].derived:
        typer.echo(f"      {derived.name:34}{derived.unit:12}{'computed':13}{derived.of} of {derived.base}")


@app.command()
def simulate(
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="the simulated line (TOML)")] = None,
    drive: Annotated[list[str] | None, typer.Option(help="NUMBER:MODEL[:PROTOCOL], once for each drive")] = None,
    baud: Annotated[int, typer.Option(help="9600, 19200 or 38400, with --drive")] = 19200,
    parity: Annotated[str, typer.Option(help="even, odd or none, with --drive")] = "even",
    link: Annotated[Path | None, typer.Option(help="a symbolic link to the port, kept while the line runs")] = None,
    control: Annotated[Path | None, typer.Option(help="a socket for what can be done to the line and asked")] = None,
) -> None:
    """Simulate drives on an RS485 line behind a pty, for any MODBUS-RTU or TOSHIBA master."""
    if (file is None) == (not drive):
        raise BadConfig("simulate: give a FILE or at least one --drive NUMBER:MODEL")
    config = settings.load(file) if file else settings.from_options(drive or [], baud=baud, parity=parity)
    if link is not None:
        config = config.model_copy(update={"link": str(link)})
    runner.simulate(config, control=control, announce=typer.echo)


@app.command()
def demo(
    mqtt_port: Annotated[int, typer.Option(help="port of the demonstration's broker")] = 1883,
    modbus_tcp_port: Annotated[int, typer.Option(help="port of the MODBUS-TCP server")] = 5020,
    web_port: Annotated[int, typer.Option(help="port of /healthz and /metrics")] = 8080,
    seconds: Annotated[float | None, typer.Option(help="end by itself after that time")] = None,
) -> None:
    """Show the main job without hardware: simulated drives, a broker, the gateway, and a live view."""
    demonstration.run(demonstration.Ports(mqtt_port, modbus_tcp_port, web_port), seconds)


commissioning.add_to(app)
store.add_to(app)
trace.add_to(app)
