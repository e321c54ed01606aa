"""The command line: run, check, map, schema, registers, simulate, demo; scan, read, write, ...; store; trace.

What only one command needs is imported where that is carried out: the servers, the broker's client and the
simulation take longer to be imported than it takes to read a value from a drive.
"""

from __future__ import annotations

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gateway import __version__, site
from gateway.commissioning import commands as commissioning
from gateway.config import Config
from gateway.drives import catalogue
from gateway.errors import BadConfig, CoreTaskEnded, GatewayError, Refused
from gateway.store import commands as store
from gateway.trace import commands as trace

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
    from gateway import running

    running.run(file, loop, record)


@app.command("check")
def check_file(
    file: ConfigFile,
    strict: Annotated[bool, typer.Option("--strict", help="an error, too, where polls may be answered late")] = False,
) -> None:
    """Check a configuration and print what it comes to: exchanges, load, topics, register map."""
    from gateway import check, overview

    configured = site.load(file)
    for line in overview.lines(configured):
        typer.echo(line)
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
    from gateway.modbus_tcp import mapping, tags

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
    from gateway.sim import runner, settings

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
    from gateway import demo as demonstration

    demonstration.run(demonstration.Ports(mqtt_port, modbus_tcp_port, web_port), seconds)


commissioning.add_to(app)
store.add_to(app)
trace.add_to(app)
