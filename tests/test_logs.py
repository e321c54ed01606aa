"""Logs: one parseable line a record, and nobody who logs waits for who reads."""

from __future__ import annotations

import asyncio
import io
import json
import logging
import os
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway import logs
from tests.soak import FACTOR


@pytest.fixture(autouse=True)
def restored() -> Iterator[None]:
    """Put logging back as it was."""
    root = logging.getLogger()
    names = (*logs.CHATTY, *logs.CHANNELS)
    before = root.level, {name: logging.getLogger(name).level for name in names}
    yield
    logging.captureWarnings(False)
    for handler in [handler for handler in root.handlers if isinstance(handler, logs.PatientHandler)]:
        root.removeHandler(handler)
        handler.close()
    root.setLevel(before[0])
    for name, level in before[1].items():
        logging.getLogger(name).setLevel(level)


def logged(action: Callable[[], object], level: str = "info", form: Any = "json", **options: Any) -> list[str]:
    """Return the lines that an action logs."""
    stream = io.StringIO()
    handler = logs.set_up(level, form, stream, **options)
    action()
    handler.close()
    return stream.getvalue().splitlines()


def objects(action: Callable[[], object], level: str = "info", **options: Any) -> list[dict[str, Any]]:
    """Return the JSON objects that an action logs."""
    return [json.loads(line) for line in logged(action, level, **options)]


log = logging.getLogger("gateway.test")


def fail() -> None:
    """Log an error with its traceback."""
    try:
        raise ValueError("no\nsuch")
    except ValueError:
        log.exception("could not")


def test_a_json_line_holds_time_level_logger_and_message() -> None:
    """The four keys, and no others where there is nothing else to say."""
    (line,) = objects(lambda: log.info("line %s: open", "a"))
    assert set(line) == {"time", "level", "logger", "message"}
    assert (line["level"], line["logger"], line["message"]) == ("info", "gateway.test", "line a: open")


def test_the_time_is_utc_with_milliseconds() -> None:
    """2023-11-14T22:13:20.500Z is 1700000000.5 whatever zone the machine is in."""
    record = logging.makeLogRecord({"created": 1_700_000_000.5, "msg": "x", "name": "n", "levelname": "INFO"})
    assert json.loads(logs.JsonLines().format(record))["time"] == "2023-11-14T22:13:20.500Z"
    assert logs.TextLines().format(record) == "2023-11-14T22:13:20.500Z INFO    n: x"


def test_further_fields_stand_in_the_object_and_cannot_replace_its_own() -> None:
    """What is no JSON is written as text, so that the line stays parseable."""
    extra = {"drive": "pump-1", "load": 0.5, "age": float("inf"), "where": {"at": (1, object)}, "level": "none"}
    (line,) = objects(lambda: log.warning("stale", extra=extra))
    assert line["drive"] == "pump-1"
    assert line["load"] == 0.5
    assert line["age"] == "inf"
    assert line["where"] == {"at": [1, "<class 'object'>"]}
    assert line["level"] == "warning"


def test_a_traceback_stays_inside_its_json_line() -> None:
    """One record, one line, the traceback under "trace"."""
    (line,) = objects(fail)
    assert line["message"] == "could not"
    assert line["trace"].endswith("ValueError: no\nsuch")


def test_a_text_line_shows_its_fields_and_an_indented_traceback() -> None:
    """Lines that begin a record can be told from those that continue one."""
    first, *rest = logged(lambda: log.error("lost", extra={"line": "a"}), form="text")
    assert first.endswith("ERROR   gateway.test: lost line=a")
    assert not rest
    first, *rest = logged(fail, form="text")
    assert first.endswith("could not")
    assert rest[0] == "    Traceback (most recent call last):"
    assert all(part.startswith("    ") for part in rest)


def test_nothing_from_outside_forges_a_text_line_or_drives_the_terminal() -> None:
    """Line ends and escape sequences in a message are shown, not obeyed."""
    (line,) = logged(lambda: log.info("topic %s", "a\n2026 ERROR b\x1b[2J µ", extra={"k": "c\rd"}), form="text")
    assert line.endswith("topic a\\n2026 ERROR b\\x1b[2J µ k=c\\rd")


TEXTS = st.text(st.characters(exclude_categories=()))  # lone surrogates too


@settings(max_examples=300 * FACTOR)
@given(TEXTS, st.dictionaries(st.text("abc", min_size=1), TEXTS | st.floats() | st.binary() | st.none(), max_size=3))
def test_whatever_is_logged_makes_one_line(message: str, fields: dict[str, object]) -> None:
    """One printable text line; one JSON object with the message unchanged; both can be written as UTF-8."""
    record = logging.makeLogRecord({"msg": message, "name": "n", "levelname": "INFO", **fields})
    text, line = logs.TextLines().format(record), logs.JsonLines().format(record)
    assert text.isprintable()
    text.encode()
    assert line.isascii()
    assert json.loads(line)["message"] == message


def test_the_level_bounds_what_is_logged() -> None:
    """At "warning" an info is silent."""

    def speak() -> None:
        log.info("a")
        log.warning("b")

    assert [line["message"] for line in objects(speak, "warning")] == ["b"]


@pytest.mark.parametrize("channel", [logs.POINTS, logs.FRAMES, logs.BYTES])
def test_a_channel_is_heard_at_debug_or_when_it_is_asked_for(channel: str) -> None:
    """The three channels are silent at "info", and can be shown one by one."""

    def speak() -> None:
        for name in logs.CHANNELS:
            logging.getLogger(name).debug("x")

    assert not objects(speak)
    assert [line["logger"] for line in objects(speak, show=[channel])] == [channel]
    assert [line["logger"] for line in objects(speak, "debug")] == list(logs.CHANNELS)


def test_libraries_are_heard_from_warnings_on() -> None:
    """Their debugging is not ours."""

    def speak() -> None:
        for name in logs.CHATTY:
            logging.getLogger(name).info("x")
            logging.getLogger(name).warning("y")

    lines = objects(speak, "debug")
    assert [(line["logger"], line["message"]) for line in lines] == [(name, "y") for name in logs.CHATTY]
    assert not objects(lambda: logging.getLogger("aiohttp").warning("x"), "error")


def test_warnings_are_logged() -> None:
    """What Python warns of stands in the log, not beside it."""

    def warn() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            # captureWarnings was set up before: catch_warnings keeps its hook
            warnings.warn("old way", DeprecationWarning, stacklevel=1)

    (line,) = objects(warn)
    assert line["logger"] == "py.warnings"
    assert "DeprecationWarning: old way" in line["message"]


def test_an_error_in_a_callback_of_the_loop_is_logged() -> None:
    """With its traceback and what the loop knows of it."""

    async def main() -> None:
        loop = asyncio.get_running_loop()
        logs.watch_loop(loop)
        called = asyncio.Event()
        loop.call_soon(lambda: 1 // 0)
        loop.call_soon(called.set)
        await called.wait()

    (line,) = objects(lambda: asyncio.run(main()))
    assert (line["logger"], line["level"]) == ("gateway.loop", "error")
    assert "ZeroDivisionError" in line["trace"]
    assert "handle" in line["context"]


def test_a_loop_error_without_exception_is_logged_too() -> None:
    """The loop may know of no exception."""
    loop = asyncio.new_event_loop()
    logs.watch_loop(loop)
    (line,) = objects(lambda: loop.call_exception_handler({"message": "odd"}))
    loop.close()
    assert line["message"] == "odd"
    assert "trace" not in line


def test_a_wrong_format_string_does_not_end_who_logs(capsys: pytest.CaptureFixture[str]) -> None:
    """The record is lost and complained of; the next one is logged."""
    stream = io.StringIO()
    handler = logs.set_up("info", "json", stream)
    for args in (("x",), (1,)):
        handler.handle(logging.makeLogRecord({"msg": "%d", "args": args}))
    handler.close()
    assert [json.loads(line)["message"] for line in stream.getvalue().splitlines()] == ["1"]
    assert "Logging error" in capsys.readouterr().err


def test_setting_up_anew_replaces_the_first() -> None:
    """No line is written twice."""
    first = io.StringIO()
    logs.set_up("info", "json", first)
    assert len(objects(lambda: log.info("once"))) == 1
    assert first.getvalue() == ""


class StuckStream(io.StringIO):
    """A stream whose reader has stopped: writing waits until it is let go."""

    def __init__(self) -> None:
        super().__init__()
        self.is_writing = threading.Event()
        self.let_go = threading.Event()

    def write(self, text: str) -> int:
        """Wait, then write."""
        self.is_writing.set()
        self.let_go.wait(30)
        return super().write(text)


def test_a_reader_that_stops_never_stops_who_logs() -> None:
    """Lines beyond the queue are dropped, and their number is logged once the reader goes on."""
    stream = StuckStream()
    handler = logs.set_up("info", "json", stream)
    log.info("first")
    assert stream.is_writing.wait(5)
    for number in range(logs.QUEUE + 7):
        log.info("%d", number)
    stream.let_go.set()
    handler.close()
    messages = [json.loads(line)["message"] for line in stream.getvalue().splitlines()]
    assert messages[: logs.QUEUE + 1] == ["first", *map(str, range(logs.QUEUE))]
    assert messages[logs.QUEUE + 1 :] == ["7 log lines were dropped: they were not read fast enough"]


def test_the_end_does_not_wait_for_ever_for_a_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closing gives up after its limit."""
    monkeypatch.setattr(logs, "LAST_WORDS", 0.01)
    stream = StuckStream()
    handler = logs.set_up("info", "json", stream)
    log.info("first")
    assert stream.is_writing.wait(5)
    handler.close()
    assert stream.getvalue() == ""
    stream.let_go.set()


def test_a_full_disk_loses_lines_and_nothing_else() -> None:
    """A write that fails is given up; a later one works again."""

    class FullOnce(io.StringIO):
        failures = 0
        failed = threading.Event()

        def write(self, text: str) -> int:
            if not self.failures:
                self.failures += 1
                self.failed.set()
                raise OSError(28, "No space left on device")
            return super().write(text)

    stream = FullOnce()
    handler = logs.set_up("info", "json", stream)
    log.info("lost")
    assert stream.failed.wait(5)
    log.info("kept")
    handler.close()
    assert [json.loads(line)["message"] for line in stream.getvalue().splitlines()] == ["kept"]


PROGRAM = """
import logging
from gateway import logs
logs.set_up("info", "json")
logging.getLogger("gateway").info("last words")
"""


def test_last_words_reach_stderr_at_the_end_of_the_process() -> None:
    """Nobody needs to close the log for its last line to come out."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(done.stderr)["message"] == "last words"


def test_a_process_without_stderr_logs_nowhere() -> None:
    """Its number may be a drive's port by then: nothing is written to it."""
    closing = f"import os; os.close(2); os.execv({sys.executable!r}, [{sys.executable!r}, '-c', {PROGRAM!r}])"
    done = subprocess.run([sys.executable, "-c", closing], stdout=subprocess.PIPE, timeout=60, check=True)
    assert done.stdout == b""


def test_a_stopped_terminal_does_not_keep_the_process_from_ending() -> None:
    """A full pipe that nobody reads: the process ends by itself, in order."""
    reading, writing = os.pipe()
    program = PROGRAM + "for _ in range(5000): logging.getLogger('gateway').info('x' * 100)\n"
    with os.fdopen(reading, "rb"), os.fdopen(writing, "wb") as full:
        process = subprocess.Popen([sys.executable, "-c", program], stderr=full)
        assert process.wait(60) == 0
