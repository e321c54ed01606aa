"""What a master reads of the registers that it writes, though nobody polls them."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import pytest

from gateway.control.command import Command, Result, Status, Verb
from gateway.image import LinkState, Missing
from gateway.modbus_tcp.connection import source_of
from gateway.modbus_tcp.read_back import FRESH_FOR, HARMLESS, CommandedUnit, commanded_registers
from gateway.site import Drive
from tests.modbus_tcp.plant import Listening, site_of

COMMAND, FREQUENCY, TERMINALS, OUTPUT, STATUS = 0xFA00, 0xFA01, 0xFA50, 0xFD00, 0xFD01


def unit() -> tuple[Listening, CommandedUnit]:
    """Return a server, and its first drive as it is read."""
    made = Listening()
    found = made.server._reception.free._units[1]
    assert isinstance(found, CommandedUnit)
    return made, found


def learn(
    made: Listening, read_back: Mapping[str, int], raw: Mapping[str, int] | None = None, drive: str = "d1"
) -> None:
    """Let a command of anybody end."""
    command = Command(drive, Verb.SET, source_of(("10.0.0.9", "1")), 0.0, 1.0)
    written = read_back if raw is None else raw
    made.door.tell_result(Result(command, Status.DONE, raw=written, read_back=read_back))


def words(*numbers: int) -> bytes:
    """Return words as they stand on the wire."""
    return struct.pack(f">{len(numbers)}H", *numbers)


def test_what_may_be_written_is_mapped_and_nothing_else() -> None:
    """0BH until it was read back; 02 for holes, read-only and forbidden numbers, and what would wear the EEPROM."""
    made, found = unit()
    now = made.clock.now()
    mapped = {register.address for register in commanded_registers(made.site.drives[0])}
    assert {COMMAND, FREQUENCY, TERMINALS} <= mapped
    assert not mapped & {0x0802, 0x0800, 0xFA10, 0xFD00, 0x0009}
    polled = {point.register.address for point in made.image.by_name["d1"].points.values()}
    for address in range(0x10000):
        answer = found.read(address, 1, now)
        assert (answer is Missing.UNMAPPED) is (address not in mapped | polled)


@pytest.mark.parametrize(
    ("more", "has_stored"),
    [({}, False), ({"allow_stored": True}, True), ({"protocol": "toshiba-ascii"}, True)],
    ids=["modbus", "stored writes allowed", "TOSHIBA"],
)
def test_stored_parameters_are_mapped_where_they_may_be_written(more: dict[str, object], has_stored: bool) -> None:
    """TOSHIBA writes them to RAM."""
    drive: Drive = site_of([more]).drives[0]
    assert any(register.address < 0x1000 for register in commanded_registers(drive)) is has_stored


def test_a_drive_that_is_not_controlled_has_none() -> None:
    """Its registers are those that are polled."""
    assert commanded_registers(site_of([{"control": "off"}]).drives[0]) == ()


@pytest.mark.hazard("H19")
def test_what_was_read_back_is_known_for_a_while() -> None:
    """Five seconds, whoever wrote it, and by its own address."""
    made, found = unit()
    begin = made.clock.now()
    learn(made, {"command": 0x8000, "frequency_command": 2500})
    learn(made, {"command": 0x1234}, drive="d2")
    assert found.read(COMMAND, 2, begin + FRESH_FOR) == words(0x8000, 2500)
    assert found.read(COMMAND, 2, begin + FRESH_FOR + 0.01) is Missing.NOT_FRESH
    assert found.read(TERMINALS, 1, begin) is Missing.NOT_FRESH


@pytest.mark.hazard("H19")
def test_what_was_written_and_not_read_back_is_not_known() -> None:
    """Nor is what it was before."""
    made, found = unit()
    learn(made, {"frequency_command": 2500, "command": 0x8000})
    learn(made, {"command": 0xC400}, raw={"command": 0xC400, "frequency_command": 3000})
    assert found.read(COMMAND, 1, made.clock.now()) == words(0xC400)
    assert found.read(FREQUENCY, 1, made.clock.now()) is Missing.NOT_FRESH


@pytest.mark.hazard("H19")
@pytest.mark.parametrize("event", ["lease_lost", "disarmed", "quiesced", "on_loss", "something new"])
def test_what_the_gateway_or_the_drive_may_have_changed_is_forgotten(event: str) -> None:
    """Any event but being taken and being armed; of this drive."""
    made, found = unit()
    learn(made, {"command": 0xC400})
    made.door._tell("d2", event, "")
    for harmless in HARMLESS:
        made.door._tell("d1", harmless, "")
    assert found.read(COMMAND, 1, made.clock.now()) == words(0xC400)
    made.door._tell("d1", event, "")
    assert found.read(COMMAND, 1, made.clock.now()) is Missing.NOT_FRESH


@pytest.mark.hazard("H19")
@pytest.mark.parametrize(
    ("link", "why"), [(LinkState.OFFLINE, Missing.NOT_FRESH), (LinkState.LINE_DOWN, Missing.LINE_DOWN)]
)
def test_a_lost_link_ends_it_for_good(link: LinkState, why: Missing) -> None:
    """Also when the drive is back; what is not mapped is still told as that."""
    made, found = unit()
    learn(made, {"command": 0xC400})
    image = made.image.by_name["d1"]
    image.set_link(link, "lost")
    assert found.read(COMMAND, 1, made.clock.now()) is why
    assert found.read(0xFA02, 1, made.clock.now()) is Missing.UNMAPPED
    assert found.link is link
    image.set_link(LinkState.ONLINE, "")
    assert found.read(COMMAND, 1, made.clock.now()) is Missing.NOT_FRESH


@pytest.mark.hazard("H19")
def test_a_trip_ends_it() -> None:
    """What the drive does with its command word then is not known."""
    made, found = unit()
    learn(made, {"command": 0xC400})
    made.image.by_name["d1"].set_tripped(True)
    assert found.read(COMMAND, 1, made.clock.now()) is Missing.NOT_FRESH


def test_an_answer_without_any_value_ends_nothing() -> None:
    """As those by which the gateway looks after a drive that is armed: registers that nobody polls."""
    made, found = unit()
    made.image.by_name["d1"].set_link(LinkState.ONLINE)
    learn(made, {"command": 0xC400})
    made.image.by_name["d1"].apply([(0xFA87, 1)], made.clock.now(), 0.0)
    assert found.read(COMMAND, 1, made.clock.now()) == words(0xC400)


def test_polled_and_commanded_registers_are_read_together() -> None:
    """Where they stand side by side; one that is stale refuses all."""
    made = Listening({"poll": [{"values": ["frequency_command"], "every": "1s", "max_age": "2s"}]})
    found = made.server._reception.free._units[1]
    image, now = made.image.by_name["d1"], made.clock.now()
    both, polled = found.reading(COMMAND, 2), found.reading(FREQUENCY, 1)
    learn(made, {"command": 0x8000})
    assert found.read(COMMAND, 2, now) is both(now) is polled(now) is Missing.NOT_FRESH
    image.apply([(FREQUENCY, 1000)], now, 0.0)
    assert both(now) == words(0x8000, 1000)
    assert polled(now) == words(1000)
    assert polled(now + 2.1) is Missing.NOT_FRESH
    assert found.read(COMMAND, 2, now) == words(0x8000, 1000)
    assert found.read(COMMAND, 2, now + 2.1) is Missing.NOT_FRESH
    assert found.read(COMMAND, 3, now) is Missing.UNMAPPED


def test_what_is_polled_is_read_as_before() -> None:
    """At once, from the image; with the identity of the drive."""
    made, found = unit()
    image = made.image.by_name["d1"]
    image.apply([(OUTPUT, 5000), (STATUS, 0x0400)], made.clock.now(), 0.0)
    assert found.read(OUTPUT, 2, made.clock.now()) == words(5000, 0x0400)
    image.identity = {"vendor": "TOSHIBA"}
    assert found.identity == {"vendor": "TOSHIBA"}
