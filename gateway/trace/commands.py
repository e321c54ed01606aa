"""The command trace: shows the frames of a running gateway, or writes them for Wireshark."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Annotated

import typer

from gateway import site
from gateway.errors import BadConfig, GatewayError
from gateway.trace.capture import Capture
from gateway.trace.client import Lost, Seen
from gateway.trace.place import sockets_to_try
from gateway.trace.text import line_of

STDOUT = "-"

ConfigFile = Annotated[Path | None, typer.Argument(metavar="[FILE]", help="configuration file of the gateway (TOML)")]


def add_to(app: typer.Typer) -> None:
    """Add the command to the command line."""
    app.command("trace")(trace)


def trace(
    file: ConfigFile = None,
    follow: Annotated[bool, typer.Option("--follow", "-f", help="show frames as they come, until Ctrl-C")] = False,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="follow for so long")] = None,
    output: Annotated[
        str | None, typer.Option("--output", "-o", metavar="FILE.pcapng", help="for Wireshark; - is stdout")
    ] = None,
    socket: Annotated[Path | None, typer.Option(help="socket of the gateway, instead of FILE")] = None,
) -> None:
    """Show the latest frames of a running gateway, or those to come; the line is not touched.

    Each with its time, direction, bytes, meaning, gap, answer time and verdict.
    """
    if (file is None) == (socket is None):
        raise BadConfig("trace: give the FILE that the gateway runs with, or its --socket")
    paths = [socket] if socket is not None else list(sockets_to_try(site.load(file or Path())))
    with contextlib.closing(Seen(paths, is_followed=follow or seconds is not None, seconds=seconds)) as seen:
        try:
            _record(seen, output) if output is not None else _show(seen)
        except KeyboardInterrupt:
            return
        except BrokenPipeError:  # head, or Wireshark, has seen enough
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left is for nobody
            return
    if follow and seconds is None:
        raise GatewayError("the gateway has ended")


def _show(seen: Seen) -> None:
    for shown in seen.frames():
        if isinstance(shown, Lost):
            print(_missing(shown), file=sys.stderr, flush=True)  # noqa: T201
        else:
            print(line_of(shown), flush=True)  # noqa: T201


def _record(seen: Seen, output: str) -> None:
    capture, count = Capture(seen.lines), 0
    with _opened(output) as file:
        file.write(capture.begin())
        try:
            for shown in seen.frames():
                if isinstance(shown, Lost):
                    print(_missing(shown), file=sys.stderr, flush=True)  # noqa: T201
                    continue
                file.write(capture.packets([shown]))
                count += 1
        finally:
            print(f"{count} frames in {output}", file=sys.stderr, flush=True)  # noqa: T201


@contextlib.contextmanager
def _opened(output: str) -> Iterator[IO[bytes]]:
    """Open a file, unbuffered, or stdout."""
    try:
        file = open(1, "wb", buffering=0, closefd=False) if output == STDOUT else Path(output).open("wb", buffering=0)  # noqa: SIM115
    except OSError as error:
        raise GatewayError(f"{output}: {error.strerror}") from error
    with file:
        yield file


def _missing(lost: Lost) -> str:
    return f"{lost.count} frames are missing here: they were not read fast enough"
