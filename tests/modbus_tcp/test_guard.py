"""What reaches the door of a request that its client may not make: its stop, where it may write to the drive."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gateway.config import ModbusTcpSection
from gateway.control.command import Channel, Command, Reason, Result, Source, Status
from gateway.image import Image, LinkState
from gateway.metrics import LineStats, Stats
from gateway.modbus_tcp.connection import Connection
from gateway.modbus_tcp.hosts import source_name
from gateway.modbus_tcp.mirror_unit import _address
from gateway.modbus_tcp.reception import Reception
from gateway.modbus_tcp.rights import Grants
from gateway.modbus_tcp.server import ModbusTcpServer, identify
from tests.modbus_tcp.plant import ListeningDoor, Master, code_of, exchange, several, site_of
from tests.modbus_tcp.rig import StandingClock

STOP, RUN, NOTHING, RESET, EMERGENCY = 0x8000, 0xC400, 0x0000, 0xA000, 0x9400
FREQUENCY_ONLY = {"functions": ["read", "write"], "units": [1], "registers": [0xFA01]}
MIRROR_ONLY = {"functions": ["read", "write"], "units": [255], "registers": [[0x8001, 0x8002]]}


class Guarded:
    """A server that knows rights, in front of a door that only listens."""

    def __init__(self, *rights: dict[str, Any]) -> None:
        self.clock = StandingClock()
        site = site_of([{}, {}])
        door = ListeningDoor.of(site, self.clock)
        assert isinstance(door, ListeningDoor)
        self.door = door
        self.results: list[Result] = []
        self.door.on_result(self.results.append)
        image = Image(site.drives)
        for each in image.drives:
            each.set_link(LinkState.ONLINE)
        self.stats = Stats(0.0, {"a": LineStats(is_up=True)})
        section = ModbusTcpSection.model_validate({"right": list(rights)})
        self.server = ModbusTcpServer(section, image, self.stats, self.clock, door=self.door)

    def connect(self, peer: str = "10.0.0.7") -> Master:
        """Open a connection."""
        return Master(self.server._connection(), peer)

    def sent(self) -> Command:
        """Return the one command that has reached the door, and do it."""
        ((command, answer),) = self.door.asked
        self.door.asked.clear()
        answer(Result(command, Status.DONE))
        return command


@pytest.mark.hazard("H04")
@pytest.mark.hazard("H28")
@pytest.mark.parametrize(("word", "sent"), [(STOP, STOP), (NOTHING, STOP), (EMERGENCY, 0x9000)])
async def test_who_may_write_to_a_drive_may_stop_it_whatever_its_rights_name(word: int, sent: int) -> None:
    """Alone, and beside words that it may not write, which are left out; it is answered as it asked."""
    made = Guarded(FREQUENCY_ONLY)
    master = made.connect()
    for asked in (several(0xFA00, word), several(0xFA00, word, 3000), several(0xF9FF, 1, word)):
        number = master.send(1, asked)
        command = made.sent()
        assert (command.address, command.words) == (0xFA00, (sent,))
        assert await told(master, number) == asked[:5]


async def told(master: Master, number: int) -> bytes:
    """Wait for an answer that is on its way."""
    while (found := master.told(number)) is None:
        await asyncio.sleep(0)
    return found


@pytest.mark.hazard("H28")
@pytest.mark.parametrize(
    ("unit", "pdu"),
    [
        (1, several(0xFA00, RUN)),
        (1, several(0xFA00, RESET)),
        (1, several(0xFA00, RUN, 3000)),
        (1, several(0xFA02, 1)),
        (1, several(0xFA01, 3000, 1)),
        (2, several(0xFA00, STOP)),
        (2, several(0xFA01, 3000)),
        (255, several(0x8000, 4)),
        (255, several(0xE000, 4)),
        (1, exchange(0xFD00, 1, 0xFA01, 3000)),
    ],
)
async def test_what_no_right_covers_is_refused_and_goes_into_the_audit(unit: int, pdu: bytes) -> None:
    """Nothing reaches the door; who has asked what of which drive is told to those who listen."""
    made = Guarded(FREQUENCY_ONLY)
    assert code_of(await made.connect().ask(unit, pdu)) == 1
    assert made.door.asked == []
    assert made.door.line_stops == []
    assert made.stats.tcp.denied == 1
    if pdu[1] == 0xE0:
        assert made.results == []
        return
    (result,) = made.results
    assert (result.status, result.reason) == (Status.REFUSED, Reason.NOT_PERMITTED)
    assert result.command.source == Source(Channel.MODBUS_TCP, "10.0.0.7")
    assert result.command.drive == {1: "d1", 2: "d2", 255: "d1"}[unit]
    assert "10.0.0.7 has no right to write" in result.text


@pytest.mark.hazard("H04")
async def test_a_stop_by_17h_is_carried_out_whatever_it_wants_to_read() -> None:
    """What may be read is read behind it; what may not is 01, and the motor is stopped."""
    made = Guarded(FREQUENCY_ONLY, {"functions": ["read"], "units": [1], "registers": [[0xFA00, 0xFA01]]})
    master = made.connect()
    number = master.send(1, exchange(0xFA00, 1, 0xFA00, STOP, 3000))
    assert made.sent().words == (STOP,)
    assert await told(master, number) == b"\x97\x0b"  # not read back by this door
    number = master.send(1, exchange(0xFD00, 1, 0xFA00, STOP, 3000))
    assert made.sent().words == (STOP,)
    assert await told(master, number) == b"\x97\x01"


@pytest.mark.hazard("H04")
async def test_who_may_write_to_a_drive_in_the_mirror_may_stop_it_there() -> None:
    """That drive, and no other; what stands beside the stop is left out."""
    made = Guarded(MIRROR_ONLY)
    master = made.connect()
    for pdu in (several(0x8000, 4), several(0x8000, 6, 7, 3000, 0, 1)):
        number = master.send(255, pdu)
        command = made.sent()
        assert command.drive == "d1"
        assert command.verb.is_stopping
        assert await told(master, number) == pdu[:5]
    assert made.door.beats == []
    assert code_of(await master.ask(255, several(0x8000, 8))) == 1
    assert code_of(await master.ask(255, several(0x8010, 4))) == 1
    assert code_of(await master.ask(255, several(0x8001, 7))) == 0
    assert [beat for _, _, beat in made.door.beats] == [7]


@pytest.mark.hazard("H28")
async def test_who_may_only_read_stops_nothing() -> None:
    """A stop is taken from who may write."""
    made = Guarded({"functions": ["read"]}, {"addresses": ["10.0.0.9"], "functions": ["write"]})
    for pdu in (several(0xFA00, STOP), several(0xFA00, EMERGENCY), b"\x06\xfa\0\x80\0"):
        assert code_of(await made.connect().ask(1, pdu)) == 1
    assert made.door.asked == []
    master = made.connect("10.0.0.9")
    master.send(1, several(0xFA00, STOP))
    assert made.sent().words == (STOP,)


@pytest.mark.hazard("H28")
async def test_rights_by_address_know_ipv4_over_ipv6() -> None:
    """One right for one machine, however it comes."""
    made = Guarded({"addresses": ["10.0.0.7"]})
    assert code_of(await made.connect("::ffff:10.0.0.7").ask(255, bytes.fromhex("0300000001"))) == 0
    assert code_of(await made.connect("10.0.0.8").ask(255, bytes.fromhex("0300000001"))) == 1


@pytest.mark.hazard("H28")
async def test_a_request_that_was_refused_is_refused_again_and_one_that_was_answered_is_not_for_others() -> None:
    """Answers are remembered for clients with the same rights only."""
    made = Guarded({"addresses": ["10.0.0.7"]}, {"addresses": ["10.0.0.8"], "units": [1]})
    ours, theirs = made.connect("10.0.0.7"), made.connect("10.0.0.8")
    for _ in range(3):
        assert code_of(await ours.ask(255, bytes.fromhex("0300000001"))) == 0
        assert code_of(await theirs.ask(255, bytes.fromhex("0300000001"))) == 1
    assert made.stats.tcp.denied == 3


@pytest.mark.hazard("H28")
@pytest.mark.parametrize("function", range(1, 128))
async def test_whatever_the_function_nobody_without_a_right_is_answered_otherwise_than_by_01(function: int) -> None:
    """Every function under units that are there and that are not."""
    made = Guarded({"addresses": ["10.9.9.9"]})
    master = made.connect()
    for unit in (0, 1, 2, 99, 255):
        assert await master.ask(unit, bytes((function,)) + bytes(4)) == bytes((function | 0x80, 1))
    assert made.door.asked == []


@pytest.mark.hazard("H32")
@pytest.mark.parametrize("is_trusted", [True, False])
async def test_a_role_writes_nothing_while_the_gateways_certificate_does_not_hold(is_trusted: bool) -> None:
    """It reads on; a stop is a write."""
    made = Guarded()
    tls = {"certificate": "a", "key": "b", "ca": "c"}
    right = {"role": "operator", "functions": ["read", "write"]}
    grants = Grants(ModbusTcpSection.model_validate({"tls": tls, "right": [right]}))
    own = made.server._reception
    reception = Reception(own._units, identify, made.stats.tcp, own._wards, grants, made.door)
    served = reception.secured("operator", "10.0.0.7", is_trusted=is_trusted)
    places = made.server._places
    master = Master(Connection(served.responder, made.clock, places, served.writers, served.source), "10.0.0.7")
    assert code_of(await master.ask(255, bytes.fromhex("0300000001"))) == 0
    number = master.send(1, several(0xFA00, STOP))
    if is_trusted:
        assert made.sent().source == Source(Channel.MODBUS_TCP, "operator@10.0.0.7")
    assert code_of(await told(master, number)) == (0 if is_trusted else 1)
    assert made.door.asked == []


def test_the_mirror_shows_the_address_of_an_owner_with_a_role() -> None:
    """Whatever the role is; addresses that are not IPv4 are shown as 0."""
    for name, words in (
        ("10.0.0.7", (0x0A00, 7)),
        (source_name("operator", "10.0.0.7"), (0x0A00, 7)),
        (source_name("me@home", "10.0.0.7"), (0x0A00, 7)),
        (source_name("operator", "fd00::7"), (0, 0)),
    ):
        assert _address(Source(Channel.MODBUS_TCP, name)) == words
