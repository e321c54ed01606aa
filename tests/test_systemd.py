"""What the service manager is told, heard on a real datagram socket."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.systemd import notify, watchdog_interval


@pytest.fixture
def listener(tmp_path: Path) -> Iterator[tuple[socket.socket, str]]:
    """Listen as the service manager does, on a socket with a path."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(path)
        listening.settimeout(5)
        yield listening, path


def test_a_state_arrives_as_one_datagram(listener: tuple[socket.socket, str]) -> None:
    """READY=1 and STATUS= come together, in the order given."""
    listening, path = listener
    assert notify("READY=1\nSTATUS=2 of 2 drives online", {"NOTIFY_SOCKET": path})
    assert listening.recv(1000) == b"READY=1\nSTATUS=2 of 2 drives online"


def test_states_arrive_in_order(listener: tuple[socket.socket, str]) -> None:
    """A life: ready, alive, stopping."""
    listening, path = listener
    for state in ("READY=1", "WATCHDOG=1", "STOPPING=1"):
        assert notify(state, {"NOTIFY_SOCKET": path})
    assert [listening.recv(100) for _ in range(3)] == [b"READY=1", b"WATCHDOG=1", b"STOPPING=1"]


def test_an_abstract_socket_is_reached() -> None:
    """A name that begins with @ stands for an abstract socket."""
    name = f"tosvert-gateway-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        listening.settimeout(5)
        assert notify("WATCHDOG=1", {"NOTIFY_SOCKET": f"@{name}"})
        assert listening.recv(100) == b"WATCHDOG=1"


def test_the_environment_of_the_process_is_the_default(
    listener: tuple[socket.socket, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The service manager sets the variables for the daemon."""
    listening, path = listener
    monkeypatch.setenv("NOTIFY_SOCKET", path)
    monkeypatch.setenv("WATCHDOG_USEC", "30000000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    assert notify("READY=1")
    assert listening.recv(100) == b"READY=1"
    assert watchdog_interval() == 30.0


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": ""}, {"NOTIFY_SOCKET": "vsock:2:1234"}])
def test_without_a_service_manager_nothing_is_sent(environment: dict[str, str]) -> None:
    """Started by hand, or with a socket of an unknown kind, the daemon just runs."""
    assert not notify("READY=1", environment)


def test_a_service_manager_that_has_gone_is_no_error(tmp_path: Path) -> None:
    """Nobody listens: False, no exception."""
    assert not notify("READY=1", {"NOTIFY_SOCKET": str(tmp_path / "nobody")})


def test_a_service_manager_that_does_not_read_is_not_waited_for(listener: tuple[socket.socket, str]) -> None:
    """Once its queue is full, states are dropped at once instead of blocking the loop."""
    _, path = listener
    sent = 0
    while notify("WATCHDOG=1", {"NOTIFY_SOCKET": path}):
        sent += 1
        assert sent < 100_000
    assert sent > 0


@pytest.mark.parametrize(
    ("environment", "seconds"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": "-5"}, None),
        ({"WATCHDOG_USEC": "²"}, None),
        ({"WATCHDOG_USEC": "1500000"}, 1.5),
        ({"WATCHDOG_USEC": "1500000", "WATCHDOG_PID": str(os.getpid())}, 1.5),
        ({"WATCHDOG_USEC": "1500000", "WATCHDOG_PID": "1"}, None),
    ],
)
def test_the_watchdog_interval_is_taken_when_meant_for_this_process(
    environment: dict[str, str], seconds: float | None
) -> None:
    """Nonsense and another process' watchdog count as none."""
    assert watchdog_interval(environment) == seconds
