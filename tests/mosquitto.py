"""Mosquitto for end-to-end tests: a broker of its own on a loopback port, and a subscriber to watch it."""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

LIMIT = 20.0  # seconds after which a wait in a test is given up
TRIES = 5  # another program may take the free port first


def program(name: str) -> str:
    """Return the path of a program; Debian keeps daemons out of a user's PATH."""
    found = shutil.which(name) or shutil.which(name, path="/usr/sbin:/usr/local/sbin")
    if found is None:
        raise AssertionError(f"{name} is not installed: apt install mosquitto mosquitto-clients")
    return found


def free_port() -> int:
    """Return a loopback port that is free now."""
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        port: int = sock.getsockname()[1]
        return port


class Mosquitto:
    """A broker on `port` of loopback, from `with` to its end; `lines` are added to its configuration.

    Anybody may connect unless `lines` say otherwise. Nothing is kept on disk: a restart forgets retained messages.
    """

    def __init__(self, *lines: str) -> None:
        self.port = free_port()
        self.log: list[str] = []
        self._lines = lines or ("allow_anonymous true",)
        self._folder = tempfile.TemporaryDirectory(prefix="mosquitto-")
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None

    def __enter__(self) -> Self:
        for _ in range(TRIES - 1):
            with contextlib.suppress(AssertionError):
                self.start()
                return self
            self.port = free_port()
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._folder.cleanup()

    @property
    def pid(self) -> int:
        """Return the process id of the running broker."""
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Start, or start again on the same port, and wait until clients are served."""
        path = Path(self._folder.name) / "mosquitto.conf"
        settings = ("user root", f"listener {self.port} 127.0.0.1", "log_dest stderr", *self._lines)
        path.write_text("\n".join(settings) + "\n", encoding="utf-8")
        arguments = [program("mosquitto"), "-c", str(path)]
        self._process = subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True)
        is_running = threading.Event()
        self._reader = threading.Thread(target=self._read, args=(self._process, is_running), daemon=True)
        self._reader.start()
        started = is_running.wait(LIMIT) and self._process.poll() is None
        if not started:
            self.stop()
            raise AssertionError("mosquitto did not start:\n" + "\n".join(self.log))

    def _read(self, process: subprocess.Popen[str], is_running: threading.Event) -> None:
        assert process.stderr is not None
        for line in process.stderr:
            self.log.append(line.rstrip())
            if line.rstrip().endswith("running"):
                is_running.set()
        is_running.set()  # ended: nobody waits any longer

    def stop(self) -> None:
        """End the broker in order; its clients see the connection close."""
        self._end(signal.SIGTERM)

    def kill(self) -> None:
        """End the broker without a word."""
        self._end(signal.SIGKILL)

    def _end(self, number: signal.Signals) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        for _ in range(int(LIMIT)):
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(number)
            with contextlib.suppress(subprocess.TimeoutExpired):  # a signal while it starts up is forgotten by it
                process.wait(1)
                break
        if self._reader is not None:
            self._reader.join(LIMIT)
        if process.stderr is not None:
            process.stderr.close()

    def freeze(self) -> None:
        """Stop the broker's time: connections stay open, nothing is read."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let a frozen broker go on."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)


@dataclass(frozen=True, slots=True)
class Message:
    """What a subscriber was given; `is_retained` says that it is an old message, kept by the broker."""

    topic: str
    payload: str
    is_retained: bool
    qos: int


class Subscriber:
    """mosquitto_sub on a topic filter, subscribed from `async with` on; every message is kept."""

    MARK = "=> "
    SHOWN = "%p"  # how a payload is printed

    def __init__(self, port: int, topic: str = "#", options: Iterable[str] = ()) -> None:
        self.messages: list[Message] = []
        self._arguments = ["-h", "127.0.0.1", "-p", str(port), "-t", topic, "-q", "2", "-d", *options]
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._changed = asyncio.Condition()
        self._is_subscribed = False

    async def __aenter__(self) -> Self:
        self._process = await asyncio.create_subprocess_exec(
            "stdbuf",  # mosquitto_sub flushes after messages, but not after saying that it is subscribed
            "-oL",
            program("mosquitto_sub"),
            *self._arguments,
            "-F",
            f"{self.MARK}%r %q %t {self.SHOWN}",
            stdout=asyncio.subprocess.PIPE,
            limit=1 << 20,
        )
        self._task = asyncio.create_task(self._read())
        await self.until(lambda: self._is_subscribed)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process is not None
        assert self._task is not None
        if self._process.returncode is None:
            self._process.kill()  # mosquitto_sub forgets a SIGTERM that comes at a bad moment
        await self._process.wait()
        await self._task

    async def _read(self) -> None:
        assert self._process is not None
        assert self._process.stdout is not None
        async for line in self._process.stdout:
            text = line.decode().removesuffix("\n")
            async with self._changed:
                if text.startswith(self.MARK):
                    retained, qos, topic, payload = text.removeprefix(self.MARK).split(" ", 3)
                    self.messages.append(Message(topic, payload, retained == "1", int(qos)))
                elif text.startswith("Subscribed"):
                    self._is_subscribed = True
                self._changed.notify_all()

    async def until(self, condition: Callable[[], bool]) -> None:
        """Wait until the messages so far fulfil a condition."""
        try:
            async with asyncio.timeout(LIMIT), self._changed:
                await self._changed.wait_for(condition)
        except TimeoutError:
            last = "\n".join(map(str, self.messages[-50:]))
            raise AssertionError(f"waited {LIMIT} s in vain; the last messages:\n{last}") from None

    async def until_payload(self, topic: str, payload: str) -> None:
        """Wait until the newest message on a topic is this one."""
        await self.until(lambda: self.newest().get(topic) == payload)

    def newest(self) -> dict[str, str]:
        """Return the newest payload of each topic."""
        return {message.topic: message.payload for message in self.messages}

    def on(self, topic: str) -> list[str]:
        """Return all payloads of one topic, in the order of arrival."""
        return [message.payload for message in self.messages if message.topic == topic]
