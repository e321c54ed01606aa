"""The line worker with drives of every protocol, alone and mixed on one line, in virtual time."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

import pytest

from gateway.image import LinkState
from gateway.sim.condition import TripCode
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import FIVE, SELECTED, Bench, bench, run

PROTOCOLS = ("modbus-rtu", "toshiba-ascii", "toshiba-binary")
TOSHIBA = PROTOCOLS[1:]
NOW = 0.25  # seconds: a few exchanges


def one(
    protocol: str, polls: Any = None, drive: dict[str, Any] | None = None, seed: int = 1, **sim: Any
) -> Bench:
    """Return a line with one VF-nC3 that runs at 40 Hz, its selectors set."""
    spoken = "modbus-rtu" if protocol == "modbus-rtu" else "toshiba"
    simulated = {"number": 1, "model": "vf-nc3", "running_at": 40.0, "block_read": SELECTED, "protocol": spoken}
    return bench([simulated | sim], polls, drive={"protocol": protocol, **(drive or {})}, seed=seed)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_drive_is_identified_and_read(protocol: str) -> None:
    """Type form and version are known, and five values are right."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert stage.value("d1", "output_frequency") == "40.00"
        assert float(stage.value("d1", "output_current_amps")) > 0
        assert stage.image.by_name["d1"].identity["type_form"].startswith("VFnC3")
        assert stage.line_stats.errors.total() - stage.line_stats.errors["refused"] == 0

    run(lambda: one(protocol), play)


@pytest.mark.parametrize(("protocol", "words"), [("modbus-rtu", 5), ("toshiba-ascii", 1), ("toshiba-binary", 5)])
def test_a_protocol_without_a_block_reads_word_by_word(protocol: str, words: int) -> None:
    """X and 1875H bring five at once, ASCII one."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        brought = [len(set(names) & set(FIVE)) for _, names, _ in stage.applied[-20:]]
        assert max(brought) == words

    run(lambda: one(protocol), play)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_trip_is_known_at_the_next_exchange(protocol: str) -> None:
    """TOSHIBA: from any answer, though only the frequency is polled; MODBUS: where the status is polled."""
    values = ["output_frequency", "status"] if protocol == "modbus-rtu" else ["output_frequency"]
    polls = [{"values": values, "every": "50ms"}, {"values": ["trip_code"], "every": "60s"}]

    async def play(stage: Bench) -> None:
        image = stage.image.by_name["d1"]
        await asyncio.sleep(3.0)
        assert image.is_tripped is False
        stage.drive.inverter.trip(TripCode.COMMUNICATION)
        await asyncio.sleep(NOW)
        assert image.is_tripped is True
        assert stage.value("d1", "trip_code") == "24"
        assert stage.value("d1", "output_frequency") == "0.00"
        stage.drive.inverter.reset(asyncio.get_running_loop().time())
        await asyncio.sleep(5.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert image.is_tripped is False
        assert stage.value("d1", "trip_code") == "0"

    run(lambda: one(protocol, polls), play)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_trip_of_a_drive_that_comes_is_told_once(protocol: str, caplog: pytest.LogCaptureFixture) -> None:
    """TOSHIBA says so in every answer, also while the drive is set up: one warning, and nothing that flutters."""
    told: list[bool | None] = []

    def made() -> Bench:
        stage = one(protocol)
        stage.drive.inverter.trip(TripCode.COMMUNICATION)
        stage.image.subscribe(lambda image, _: told.append(image.is_tripped))
        return stage

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.image.by_name["d1"].is_tripped is True

    with caplog.at_level("WARNING", "gateway.bus"):
        run(made, play)
    assert [record.message for record in caplog.records].count("d1 is tripped") == 1
    changes = [now for before, now in pairwise([None, *told]) if now is not before]
    assert changes == [True, None]  # when it is online, and when the gateway ends


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_lost_drive_is_not_called_sound(protocol: str) -> None:
    """Whether it is tripped is not known while it is silent."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        stage.wire.faults.add(Fault(Kind.CUT, 1))
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.OFFLINE
        assert stage.image.by_name["d1"].is_tripped is None

    run(lambda: one(protocol), play)


@pytest.mark.parametrize("protocol", TOSHIBA)
def test_another_series_is_a_stranger(protocol: str) -> None:
    """FB07 says another series code: nothing of it is believed."""

    async def play(stage: Bench) -> None:
        stage.drive.force("series_code", 7)
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.STRANGER
        assert "series code 208, 7 answers" in stage.image.by_name["d1"].reason
        assert stage.value("d1", "output_frequency") == "never_read"
        stage.drive.force("series_code", None)
        await asyncio.sleep(10.0)
        assert stage.link("d1") is LinkState.ONLINE

    run(lambda: one(protocol), play)


@pytest.mark.hazard("H07")
@pytest.mark.parametrize("protocol", TOSHIBA)
@pytest.mark.parametrize(
    ("configured", "there", "capacity", "says"),
    [
        ("vf-nc3", "vf-mb1", "VFMB1S-2007PL", "VF-MB1: its input VIC answers"),
        ("vf-nc3", "vf-mb1", "VFMB1-4007PL", "identity mismatch"),
        ("vf-mb1", "vf-nc3", "VFnC3S-2007PL", "VF-nC3: its series code answers"),
        ("vf-mb1", "vf-nc3", "VFnC3S-1001P", "identity mismatch"),
    ],
)
def test_the_other_family_is_a_stranger(configured: str, there: str, capacity: str, says: str, protocol: str) -> None:
    """Told by FB07, by what the other one alone knows, and by FB05; also where both have the capacity code."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.STRANGER
        assert says in stage.image.by_name["d1"].reason
        assert stage.value("d1", "output_frequency") == "never_read"

    simulated = {"number": 1, "model": there, "configured": configured, "protocol": "toshiba", "capacity": capacity}
    run(lambda: bench([simulated], drive={"protocol": protocol}), play)


@pytest.mark.parametrize("protocol", TOSHIBA)
@pytest.mark.parametrize("model", ["vf-nc3", "vf-mb1"])
def test_a_drive_that_knows_no_series_code_is_believed_where_nothing_speaks_against_it(
    model: str, protocol: str
) -> None:
    """A master that has not got FB07, FB05 and FE08 must still be able to be read: a refusal proves nothing alone."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.ONLINE

    def made() -> Bench:
        stage = bench([{"number": 1, "model": model, "protocol": "toshiba"}], drive={"protocol": protocol})
        for address in (0xFB05, 0xFB07, 0xFE08):
            stage.wire.drives[0].inverter.memory._by_address.pop(address, None)
        return stage

    run(made, play)


@pytest.mark.unmeasured
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_bad_line_brings_no_wrong_value(protocol: str, seed: int) -> None:
    """One answer in twenty is cut short, one has noise in front, one is late: the frequency is right or absent."""

    async def play(stage: Bench) -> None:
        image = stage.image.by_name["d1"]
        seen: set[int] = set()

        def look(_image: object, names: object) -> None:
            seen.add(image.sample("output_frequency", asyncio.get_running_loop().time()).word)

        await asyncio.sleep(3.0)
        image.subscribe(look)
        for kind in (Kind.TRUNCATE, Kind.BABBLE, Kind.DROP):
            stage.wire.faults.add(Fault(kind, 1, probability=0.05))
        stage.wire.faults.add(Fault(Kind.LATE, 1, value=0.2, probability=0.02))
        await asyncio.sleep(60.0)
        assert seen <= {4000}
        assert stage.drive_stats["d1"].timeouts > 0

    run(lambda: one(protocol, seed=seed), play)


def test_three_protocols_share_a_line() -> None:
    """MODBUS-RTU, ASCII and binary drives are served in turn; no gap is too short, none disturbs another."""
    spoken = {1: "modbus-rtu", 2: "toshiba", 3: "toshiba"}
    simulated = [
        {"number": n, "model": "vf-nc3", "running_at": 10.0 * n, "block_read": SELECTED, "protocol": p}
        for n, p in spoken.items()
    ]

    async def play(stage: Bench) -> None:
        await asyncio.sleep(10.0)
        for number in spoken:
            assert stage.link(f"d{number}") is LinkState.ONLINE
            assert stage.value(f"d{number}", "output_frequency") == f"{10 * number}.00"
        assert stage.line_stats.errors["no_reply"] == stage.line_stats.errors["bad_reply"] == 0

    protocols = dict(zip((1, 2, 3), PROTOCOLS, strict=True))
    polls = [{"values": FIVE, "every": "500ms"}]
    run(lambda: bench(simulated, polls, protocols=protocols), play)


@pytest.mark.parametrize("protocol", ["toshiba-binary"])
def test_selectors_are_provisioned_by_w_once(protocol: str) -> None:
    """Five words in the EEPROM, the reset mark in RAM; the block by X after the reset."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(5.0)
        assert stage.image.by_name["d1"].is_reset_needed
        memory = stage.drive.inverter.memory
        assert memory.eeprom_writes == dict.fromkeys(range(0x0875, 0x087A), 1)
        assert memory.word("reset_detection") == 1
        stage.drive.inverter.reset(asyncio.get_running_loop().time())
        await asyncio.sleep(3.0)
        stage.drive.inverter.run_by_panel(20.0)
        await asyncio.sleep(20.0)
        assert not stage.image.by_name["d1"].is_reset_needed
        assert any(set(FIVE) <= set(names) for _, names, _ in stage.applied[-10:])
        assert memory.eeprom_writes == dict.fromkeys(range(0x0875, 0x087A), 1)

    run(lambda: one(protocol, drive={"provision": True}, block_read=[]), play)


@pytest.mark.parametrize("protocol", TOSHIBA)
def test_a_request_damaged_on_its_way_is_no_refusal(protocol: str) -> None:
    """N0004 says that the drive heard something else: it counts as a bad reply, and no value is given up."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        refusals = stage.drive_stats["d1"].refusals
        stage.wire.faults.add(Fault(Kind.REQUEST_FLIP, 1, probability=0.2))
        await asyncio.sleep(20.0)
        stage.wire.faults.clear()
        assert stage.drive_stats["d1"].bad_replies > 0
        assert stage.drive_stats["d1"].refusals == refusals
        await asyncio.sleep(5.0)
        assert stage.value("d1", "output_frequency") == "40.00"

    run(lambda: one(protocol), play)
