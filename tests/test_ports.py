"""A port that cannot be listened on is explained: which key, why, and who has it."""

from __future__ import annotations

import errno
import os
import socket
from pathlib import Path

import pytest

from gateway.ports import explain_bind_error, holder

HEADING = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n"


def row(port: int, state: str, inode: int, address: str = "0100007F") -> str:
    """Make a line of /proc/net/tcp."""
    return f"   0: {address}:{port:04X} 00000000:0000 {state} 0:0 00:0 0  0  0 {inode} 1 0\n"


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    """Make a /proc where mosquitto (42) listens on 5020, and 1883 belongs to somebody who cannot be seen."""
    (tmp_path / "net").mkdir()
    table = HEADING + row(5020, "01", 7) + row(5020, "0A", 8) + row(1883, "0A", 9) + "cut off\n"
    (tmp_path / "net" / "tcp").write_text(table)
    six = HEADING + row(502, "0A", 10, "0" * 32)
    (tmp_path / "net" / "tcp6").write_text(six)
    for pid, name, inode in ((41, "bash", 7), (42, "mosquitto", 8), (43, "slave", 10)):
        descriptors = tmp_path / str(pid) / "fd"
        descriptors.mkdir(parents=True)
        (tmp_path / str(pid) / "comm").write_text(f"{name}\n")
        (descriptors / "0").symlink_to("/dev/null")
        (descriptors / "5").symlink_to(f"socket:[{inode}]")
    (tmp_path / "44").mkdir()
    return tmp_path


@pytest.mark.parametrize(
    ("port", "name"), [(5020, "mosquitto (pid 42)"), (502, "slave (pid 43)"), (1883, None), (80, None)]
)
def test_the_listener_is_found_by_its_socket(proc: Path, port: int, name: str | None) -> None:
    """A connection of the same port is no listener; IPv6 counts; what cannot be seen is not guessed."""
    assert holder(port, proc) == name


def test_a_system_without_proc_names_nobody(tmp_path: Path) -> None:
    """Not Linux, or not mounted."""
    assert holder(5020, tmp_path) is None


def test_a_process_that_is_gone_meanwhile_has_no_name(proc: Path) -> None:
    """Its descriptors were still seen."""
    (proc / "42" / "comm").unlink()
    assert holder(5020, proc) == "a process (pid 42)"


@pytest.mark.parametrize(
    ("number", "port", "words"),
    [
        (errno.EADDRINUSE, 5020, "in use by mosquitto (pid 42)"),
        (errno.EADDRINUSE, 1883, "in use by a process that this user cannot see"),
        (errno.EACCES, 502, "CAP_NET_BIND_SERVICE"),
        (errno.EADDRNOTAVAIL, 502, "no such address"),
        (errno.EMFILE, 502, os.strerror(errno.EMFILE)),
    ],
)
def test_the_reason_stands_with_the_key(proc: Path, number: int, port: int, words: str) -> None:
    """A line that says which key to change."""
    error = explain_bind_error(OSError(number, os.strerror(number)), "10.0.0.9", port, "web.listen", proc)
    assert str(error).startswith(f"web.listen: cannot listen on 10.0.0.9:{port}: ")
    assert words in str(error)


def test_an_unknown_host_and_ipv6(proc: Path) -> None:
    """Brackets around IPv6; a name that is not known is said to be so."""
    unknown = explain_bind_error(socket.gaierror(-2, "Name or service not known"), "nowhere", 1, "web.listen", proc)
    assert "nowhere:1: the host name is not known" in str(unknown)
    assert "[::1]:5020" in str(explain_bind_error(OSError(errno.EADDRINUSE, ""), "::1", 5020, "web.listen", proc))


def test_this_process_is_found() -> None:
    """The real /proc."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        assert f"(pid {os.getpid()})" in (holder(listener.getsockname()[1]) or "")
