"""RFC 2217 from the client's side: bytes in, bytes out, as the RFC and its servers have them."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.rfc2217 import ComPort, Settings
from tests.soak import FACTOR

SETTINGS = Settings(19200, "even", 1)
WILL_COM_PORT = bytes.fromhex("FF FB 2C")
DO_COM_PORT = bytes.fromhex("FF FD 2C")
DONT_COM_PORT = bytes.fromhex("FF FE 2C")
SET_19200 = bytes.fromhex("FF FA 2C 01 00 00 4B 00 FF F0")
ACKNOWLEDGED = bytes.fromhex(
    "FF FA 2C 65 00 00 4B 00 FF F0"  # SET-BAUDRATE 19200
    "FF FA 2C 66 08 FF F0"  # SET-DATASIZE 8
    "FF FA 2C 67 03 FF F0"  # SET-PARITY even
    "FF FA 2C 68 01 FF F0"  # SET-STOPSIZE 1
)
INPUTS = 10_000 * FACTOR


def agreed() -> ComPort:
    """Return a connection whose server has agreed to everything."""
    com_port = ComPort(SETTINGS)
    com_port.feed(DO_COM_PORT + ACKNOWLEDGED)
    com_port.outgoing()
    assert com_port.is_ready
    return com_port


def test_the_option_is_asked_for_first_and_settings_are_sent_once_it_is_granted() -> None:
    """Not before: a server that does not know them would hand them to the drives."""
    com_port = ComPort(SETTINGS)
    first = com_port.outgoing()
    assert first.startswith(WILL_COM_PORT)
    assert SET_19200 not in first
    com_port.feed(DO_COM_PORT)
    assert SET_19200 in com_port.outgoing()
    com_port.feed(DO_COM_PORT)
    assert com_port.outgoing() == b""


@pytest.mark.parametrize("step", [1, 3, 100])
def test_it_is_ready_when_every_setting_is_acknowledged(step: int) -> None:
    """However the server's bytes are cut; three of four are not enough."""
    com_port = ComPort(SETTINGS)
    said = DO_COM_PORT + ACKNOWLEDGED
    for place in range(0, len(said), step):
        assert not com_port.is_ready
        assert com_port.feed(said[place : place + step]) == b""
    assert com_port.is_ready


def test_a_setting_that_comes_out_otherwise_is_named() -> None:
    """What is in force, and what was asked."""
    com_port = ComPort(SETTINGS)
    com_port.feed(DO_COM_PORT + ACKNOWLEDGED.replace(bytes.fromhex("67 03"), bytes.fromhex("67 01")))
    assert com_port.problem.startswith("its parity is none and not even: ")
    com_port = ComPort(SETTINGS)
    com_port.feed(DO_COM_PORT + bytes.fromhex("FF FA 2C 65 00 00 25 80 FF F0"))
    assert com_port.problem.startswith("its baud rate is 9600 and not 19200: ")
    assert not com_port.is_ready


def test_what_a_server_lacks_is_said() -> None:
    """No RFC 2217 at all, refused, or a setting without an answer."""
    assert 'write "socket://"' in ComPort(SETTINGS).lacking
    refused = ComPort(SETTINGS)
    refused.feed(DONT_COM_PORT)
    assert "refuses RFC 2217" in refused.problem
    slow = ComPort(SETTINGS)
    slow.feed(DO_COM_PORT + ACKNOWLEDGED[:10])
    assert slow.lacking == "it does not acknowledge data bits, parity, stop bits"


def test_options_that_are_not_wanted_are_refused_once() -> None:
    """ECHO (1) of a telnet server; a server that insists is not answered for ever."""
    com_port = ComPort(SETTINGS)
    com_port.outgoing()
    com_port.feed(bytes.fromhex("FF FB 01"))
    assert com_port.outgoing() == bytes.fromhex("FF FE 01")
    com_port.feed(bytes.fromhex("FF FB 01") * 1000)
    assert com_port.outgoing() == b""


@pytest.mark.parametrize(
    "said",
    [
        bytes.fromhex("FF FA 2C 6B 30") + bytes(62),  # NOTIFY-MODEMSTATE, and bytes of the line
        bytes.fromhex("FF FA 2C 6B 30 FF FA 2C 6B 30 FF F0"),
        bytes.fromhex("FF FA 2C 64") + bytes(1023),
    ],
)
def test_a_subnegotiation_without_an_end_is_a_problem(said: bytes) -> None:
    """Otherwise every answer would vanish in it; what a subnegotiation may be long is none."""
    com_port = agreed()
    com_port.feed(said)
    assert "does not end" in com_port.problem


@pytest.mark.parametrize("said", [b"\x2c\x6b" + bytes(62), b"\x2c\x64" + b"firmware 1.0, " * 50])
def test_a_subnegotiation_that_ends_in_time_is_none_of_the_line(said: bytes) -> None:
    """A server may send a signature of any length."""
    com_port = agreed()
    assert com_port.feed(bytes.fromhex("FF FA") + said + bytes.fromhex("FF F0") + b"answer") == b"answer"
    assert not com_port.problem


@given(st.binary(max_size=64), st.integers(1, 7))
def test_every_byte_of_the_line_goes_through_both_ways(data: bytes, step: int) -> None:
    """FFH is sent twice, and comes twice; what telnet says in between is no byte of the line."""
    com_port = agreed()
    sent = com_port.escaped(data)
    assert sent.count(b"\xff") == 2 * data.count(b"\xff")
    told = bytes.fromhex("FF FA 2C 6B 30 FF F0")  # NOTIFY-MODEMSTATE
    stream = told + sent + told
    assert b"".join(com_port.feed(stream[at : at + step]) for at in range(0, len(stream), step)) == data


def test_nothing_that_a_server_sends_breaks_it_or_grows_without_bounds() -> None:
    """Seeded: telnet's bytes among others; it answers a bounded number of times, and stays what it was."""
    chance = Random(2217)
    alphabet = [255, 250, 240, 251, 252, 253, 254, 44, 0, 1, 3, 101, 103, 104, 112]
    com_port = ComPort(SETTINGS)
    size = 0
    for _ in range(INPUTS):
        piece = bytes(chance.choice(alphabet) if chance.random() < 0.8 else chance.randrange(256) for _ in range(16))
        passed = com_port.feed(piece)
        assert len(passed) <= len(piece)
        size += len(com_port.outgoing())
    assert size < 8192
    assert not com_port.problem or "its " in com_port.problem or "refuses" in com_port.problem
