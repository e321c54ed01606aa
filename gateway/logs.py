"""Sets up logging: lines for people or JSON for machines, to stderr, without ever holding up the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import os
import sys
import threading
from collections import deque
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, TextIO

POINTS = "gateway.points"  # values as they are decoded
FRAMES = "gateway.bus.frames"  # requests and replies by their fields
BYTES = "gateway.bus.bytes"  # what is on the wire, in hexadecimal
CHANNELS = (POINTS, FRAMES, BYTES)
SHOWN = {"points": POINTS, "frames": FRAMES, "bytes": BYTES}  # as gateway.log.show names them

CHATTY = ("aiohttp", "amqtt", "asyncio", "paho", "pymodbus", "transitions")  # heard from warnings on

QUEUE = 10_000  # lines that may wait for a slow reader of stderr
LAST_WORDS = 2.0  # seconds that the end of the process waits for them

_STANDARD = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


def set_up(
    level: str,
    form: Literal["text", "json"] = "text",
    stream: TextIO | None = None,
    show: Sequence[str] = (),
) -> logging.Handler:
    """Log from `level` on to `stream` (stderr by default), and the channels in `show` in full at any level.

    Replaces what was set up before. Warnings are captured. Return the handler; closing it writes what waits.
    """
    handler = PatientHandler(stream or _own_stderr())
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    root = logging.getLogger()
    for old in [old for old in root.handlers if isinstance(old, PatientHandler)]:
        root.removeHandler(old)
        old.close()
    root.addHandler(handler)
    root.setLevel(level.upper())
    for name in CHATTY:
        logging.getLogger(name).setLevel(max(logging.WARNING, root.level))
    for name in CHANNELS:
        logging.getLogger(name).setLevel(logging.DEBUG if name in show else logging.NOTSET)
    logging.captureWarnings(True)
    return handler


def _own_stderr() -> TextIO:
    """Return a stream of our own on stderr: the end of the interpreter must not wait for a lock on sys.stderr."""
    if sys.__stderr__ is None:  # started with stderr closed: its number may be any other file by now
        return Path(os.devnull).open("w")
    return open(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)


def watch_loop(loop: asyncio.AbstractEventLoop) -> None:
    """Log what goes wrong in callbacks and forgotten tasks of the event loop."""
    loop.set_exception_handler(_log_loop_error)


def _log_loop_error(_: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    error = context.get("exception")
    about = {key: repr(value) for key, value in context.items() if key not in ("message", "exception")}
    logging.getLogger("gateway.loop").error(
        "%s", context.get("message", "error in the event loop"), exc_info=error, extra={"context": about}
    )


def _utc(record: logging.LogRecord) -> str:
    moment = datetime.fromtimestamp(record.created, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _extras(record: logging.LogRecord) -> dict[str, Any]:
    return {key: value for key, value in vars(record).items() if key not in _STANDARD}


def _on_one_line(text: str) -> str:
    """Escape control characters, so that nothing from outside can forge a line or drive a terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class TextLines(logging.Formatter):
    """One line for people: UTC time, level, logger, message, further fields; a traceback follows, indented."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        fields = "".join(f" {key}={_on_one_line(str(value))}" for key, value in _extras(record).items())
        message = _on_one_line(record.getMessage())
        line = f"{_utc(record)} {record.levelname:<7} {record.name}: {message}{fields}"
        trace = _trace(self, record)
        return line + "".join(f"\n    {_on_one_line(part)}" for part in trace.splitlines())


class JsonLines(logging.Formatter):
    """One JSON object a line: time, level, logger, message, the record's further fields, and a traceback."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        fields: dict[str, Any] = {
            **_extras(record),
            "time": _utc(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        trace = _trace(self, record)
        if trace:
            fields["trace"] = trace
        return json.dumps(_plain(fields), allow_nan=False)


def _trace(formatter: logging.Formatter, record: logging.LogRecord) -> str:
    trace = formatter.formatException(record.exc_info) if record.exc_info and record.exc_info[0] else ""
    return "\n".join(part for part in (trace, record.stack_info) if part)


def _plain(value: object) -> object:
    """Return what JSON can hold; everything else by its text."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return str(value)


class PatientHandler(logging.Handler):
    """Writes lines in a thread of its own: whoever logs never waits for the reader of the stream.

    A terminal stopped by Ctrl-S or a full pipe would otherwise stop the event loop, and with it the drives'
    communication. When too many lines wait, new ones are dropped, counted, and the count is logged.
    """

    def __init__(self, stream: TextIO) -> None:
        super().__init__()
        self._stream = stream
        self._lines: deque[str] = deque()
        self._dropped = 0
        self._is_closed = False
        self._changed = threading.Condition()
        self._writer = threading.Thread(target=self._write, name="log writer", daemon=True)
        self._writer.start()

    def emit(self, record: logging.LogRecord) -> None:
        """Put the line into the queue."""
        try:
            line = self.format(record)
        except Exception:  # a bad format string must not end what only wanted to log
            self.handleError(record)
            return
        with self._changed:
            if len(self._lines) >= QUEUE:
                self._dropped += 1
            elif not self._is_closed:
                self._lines.append(line)
                self._changed.notify()

    def close(self) -> None:
        """Write what waits, for a limited time, and end the thread."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        if self._writer is not threading.current_thread():
            self._writer.join(LAST_WORDS)
        super().close()

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._lines and not self._is_closed:
                    self._changed.wait()
                waiting = list(self._lines)
                self._lines.clear()
                dropped, self._dropped = self._dropped, 0
                is_last = self._is_closed
            if dropped:
                waiting.append(self.format(_dropped_record(dropped)))
            if waiting:
                self._put(waiting)
            if is_last:
                return

    def _put(self, lines: list[str]) -> None:
        with contextlib.suppress(OSError, ValueError):  # full disk, reader gone, stream closed: nobody to tell
            self._stream.write("\n".join(lines) + "\n")
            self._stream.flush()


def _dropped_record(count: int) -> logging.LogRecord:
    text = "%d log lines were dropped: they were not read fast enough"
    return logging.LogRecord("gateway.logs", logging.WARNING, __file__, 0, text, (count,), None)
