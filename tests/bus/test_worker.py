"""The line worker against simulated drives in virtual time: reading, faults, silence, replugging."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from gateway.errors import BadReply
from gateway.image import LinkState
from gateway.sim.faults import Fault, Kind
from tests.bus.rig import FIVE, Bench, bench, nc3, run
from tests.soak import FACTOR


def test_a_drive_is_identified_and_read_by_the_block() -> None:
    """Online within a second; amperes and volts from FE70 and FE71; one exchange brings all five."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(2.0)
        assert stage.link("d1") is LinkState.ONLINE
        image = stage.image.by_name["d1"]
        assert image.identity["device"].startswith("VFnC3")
        assert stage.value("d1", "output_frequency") == "50.00"
        assert float(stage.value("d1", "output_current_amps")) > 0
        status = int(stage.value("d1", "status"))
        assert status & 0x400
        assert not status & 0x8000
        answers = [names for drive, names, _ in stage.applied if len(names) >= 5]
        assert set(FIVE) <= set(answers[-1])

    run(lambda: bench([nc3(running_at=50.0)]), play)


def test_a_drive_as_shipped_is_read_without_the_block() -> None:
    """All selectors 0: direct blocks or single reads, the same values."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.value("d1", "output_frequency") == "40.00"
        assert stage.value("d1", "output_voltage") not in ("never_read", "stale")

    run(lambda: bench([{"number": 1, "model": "vf-nc3", "running_at": 40.0}]), play)


@pytest.mark.parametrize("accepts", [True, False])
def test_drives_of_either_reading_of_direct_blocks_are_served(accepts: bool) -> None:
    """Where FD00 with two words is refused with error 03, and where it is not."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert all(stage.value("d1", name) not in ("never_read", "stale") for name in FIVE)
        assert stage.drive_stats["d1"].refusals < 8

    run(lambda: bench([{"number": 1, "model": "vf-nc3", "direct_blocks": accepts}]), play)


def test_selectors_in_any_order_are_mapped_as_set() -> None:
    """Words follow F875-F879, not their usual order; 0 is skipped."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.value("d1", "output_frequency") == "30.00"
        assert 0 < float(stage.value("d1", "output_voltage")) <= 100
        assert int(stage.value("d1", "status")) & 0x400

    run(lambda: bench([nc3(block_read=[4, 0, 2, 1, 9], running_at=30.0)]), play)


def test_a_selector_changed_and_not_yet_in_force_does_not_mix_up_values() -> None:
    """The parameter reads back new at once; the block carries the old until a reset, and then the new."""

    async def play(stage: Bench) -> None:
        drive = stage.wire.drives[0]
        drive.set_by_panel("block_read_1", 2)
        drive.set_by_panel("block_read_2", 1)
        await asyncio.sleep(3.0)
        assert stage.value("d1", "output_frequency") == "50.00"
        assert int(stage.value("d1", "status")) & 0x400
        drive.inverter.reset(asyncio.get_running_loop().time(), off=0.0)
        await asyncio.sleep(10.0)
        assert stage.link("d1") is LinkState.ONLINE
        status = int(stage.value("d1", "status"))
        assert status & ~0x7FFF == 0
        assert float(stage.value("d1", "output_frequency")) <= 50.0

    run(lambda: bench([nc3(running_at=50.0)]), play)


def test_several_groups_keep_their_own_periods() -> None:
    """100 ms, 1 s, and nothing of one in the other's time."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        stage.applied.clear()
        await asyncio.sleep(10.0)
        fast = [t for _, names, t in stage.applied if "output_frequency" in names]
        slow = [t for _, names, t in stage.applied if "trip_code" in names]
        assert len(fast) == pytest.approx(100, abs=6)
        assert len(slow) == pytest.approx(10, abs=1)

    polls = [{"values": FIVE, "every": "100ms"}, {"values": ["trip_code"], "every": "1s"}]
    run(lambda: bench([nc3()], polls), play)


def test_a_silent_drive_goes_offline_and_the_others_keep_their_rate() -> None:
    """H19: offline, not the old number; seven tenths silent or one, the neighbour is read as before."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(2.0)
        stage.wire.faults.add(Fault(Kind.CUT, 2))
        await asyncio.sleep(2.0)
        assert stage.link("d2") is LinkState.OFFLINE
        assert stage.value("d2", "output_frequency") == "offline"
        stage.applied.clear()
        await asyncio.sleep(20.0)
        assert len([1 for drive, names, _ in stage.applied if drive == "d1" and names]) >= 0.9 * 200

    run(lambda: bench([nc3(1), nc3(2)]), play)


@pytest.mark.hazard("H07")
def test_another_model_under_the_number_is_not_believed() -> None:
    """A VF-MB1 where a VF-nC3 is configured."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(3.0)
        assert stage.link("d1") is LinkState.STRANGER
        assert "VFMB1" in stage.image.by_name["d1"].reason
        assert stage.value("d1", "status") == "never_read"

    run(lambda: bench([{"number": 1, "model": "vf-mb1", "configured": "vf-nc3"}]), play)


@pytest.mark.hazard("H14")
def test_the_adapter_may_be_unplugged_and_plugged_again() -> None:
    """Every value offline at once, line down; afterwards read anew, and identified first."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(2.0)
        stage.unplug()
        await asyncio.sleep(0.5)
        assert stage.link("d1") is LinkState.LINE_DOWN
        assert stage.value("d1", "status") == "offline"
        assert not stage.line_stats.is_up
        stage.is_plugged = True
        await asyncio.sleep(12.0)
        assert stage.link("d1") is LinkState.ONLINE
        assert stage.value("d1", "status").isdigit()
        assert stage.line_stats.opened == 2

    run(lambda: bench([nc3()]), play)


KINDS = [Kind.DROP, Kind.LATE, Kind.TRUNCATE, Kind.FLIP, Kind.ECHO, Kind.DUPLICATE, Kind.BABBLE]
VALUE = {Kind.LATE: 0.08, Kind.TRUNCATE: 4.0, Kind.FLIP: 3.0}


@pytest.mark.unmeasured
@pytest.mark.hazard("H16")
@pytest.mark.hazard("H17")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.value)
@pytest.mark.parametrize("seed", range(2 * FACTOR))
def test_no_fault_of_the_line_gives_a_wrong_value(kind: Kind, seed: int) -> None:
    """One exchange in five disturbed for a minute: what is read as good is right."""

    async def play(stage: Bench) -> None:
        wrong: list[tuple[str, str]] = []

        def look(image: Any, names: Any) -> None:
            for name in names:
                if name == "output_frequency" and stage.value(image.drive.name, name) not in right[image.drive.name]:
                    wrong.append((image.drive.name, stage.value(image.drive.name, name)))

        right = {"d1": ("50.00", "offline", "stale"), "d2": ("25.00", "offline", "stale")}
        await asyncio.sleep(2.0)
        stage.image.subscribe(look)
        stage.wire.faults.add(Fault(kind, None, VALUE.get(kind), 0.2))
        await asyncio.sleep(60.0)
        assert wrong == []
        assert stage.line_stats.exchanges > 200

    polls = [{"values": ["output_frequency", "status"], "every": "50ms"}, {"values": ["trip_code"], "every": "200ms"}]
    run(lambda: bench([nc3(1, running_at=50.0), nc3(2, running_at=25.0)], polls, seed=seed), play)


def test_a_drive_that_returns_is_read_again_soon() -> None:
    """Within one interval of tries."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(2.0)
        drive = stage.wire.drives[0]
        drive.inverter.reset(asyncio.get_running_loop().time(), off=0.0)
        await asyncio.sleep(0.8)
        assert stage.link("d1") is LinkState.OFFLINE
        await asyncio.sleep(8.0)
        assert stage.link("d1") is LinkState.ONLINE

    run(lambda: bench([nc3()]), play)


@pytest.mark.unmeasured
@pytest.mark.hazard("H16")
@pytest.mark.parametrize("late", [0.12, 0.15, 0.2, 0.3])
def test_a_late_answer_is_not_taken_for_another_registers(late: float) -> None:
    """Single reads of one form after each other, one answer in five late: every value good is its own."""

    async def play(stage: Bench) -> None:
        hours = "cumulative_operation_time"
        bounds = {"output_frequency": (49.9, 50.1), "input_voltage": (80, 200), hours: (1000, 1001)}
        wrong: list[tuple[str, str]] = []

        def look(image: Any, names: Any) -> None:
            for name in names:
                value = stage.value("d1", name)
                low, high = bounds.get(name, (float("-inf"), float("inf")))
                if value[0].isdigit() and not low <= float(value) <= high:
                    wrong.append((name, value))

        await asyncio.sleep(3.0)
        stage.image.subscribe(look)
        stage.wire.faults.add(Fault(Kind.LATE, None, late, 0.2))
        await asyncio.sleep(120.0)
        assert wrong == []
        assert stage.line_stats.exchanges > 200

    polls = [{"values": ["output_frequency", "input_voltage", "cumulative_operation_time"], "every": "50ms"}]
    run(lambda: bench([{"number": 1, "model": "vf-nc3", "running_at": 50.0}], polls), play)


def test_a_mapping_that_agreed_only_at_0_shows_no_wrong_value_when_the_motor_starts() -> None:
    """Selectors swapped at the panel and not in force: the words that leave 0 are confirmed first."""

    async def play(stage: Bench) -> None:
        drive = stage.wire.drives[0]
        drive.set_by_panel("block_read_2", 3)
        drive.set_by_panel("block_read_3", 2)
        await asyncio.sleep(5.0)
        wrong: list[str] = []

        def look(image: Any, names: Any) -> None:
            motor = drive.inverter.condition.motor.frequency
            value = stage.value("d1", "output_frequency")
            if "output_frequency" in names and value[0].isdigit() and abs(float(value) - motor) > 2.0:
                wrong.append(value)

        stage.image.subscribe(look)
        drive.inverter.run_by_panel(50.0, is_reverse=False)
        await asyncio.sleep(30.0)
        assert wrong == []
        assert stage.value("d1", "output_frequency") == "50.00"

    run(lambda: bench([nc3()]), play)


def test_one_lost_answer_of_many_does_not_take_a_drive_offline() -> None:
    """One answer in ten lost for five minutes: connected nearly all the time, from the start."""

    async def play(stage: Bench) -> None:
        stage.wire.faults.add(Fault(Kind.DROP, None, None, 0.1))
        await asyncio.sleep(10.0)
        connected = 0
        for _ in range(3000):
            await asyncio.sleep(0.1)
            connected += stage.link("d1").is_connected
        assert connected > 0.95 * 3000

    run(lambda: bench([nc3()]), play)


def test_a_stranger_is_asked_ever_more_seldom_and_reported_once(caplog: pytest.LogCaptureFixture) -> None:
    """One warning in ten minutes."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(600.0)
        assert stage.line_stats.exchanges < 150

    run(lambda: bench([{"number": 1, "model": "vf-mb1", "configured": "vf-nc3"}]), play)
    assert len([record for record in caplog.records if "mismatch" in record.getMessage()]) == 1


def test_a_port_that_opens_and_is_lost_at_once_is_tried_ever_more_seldom() -> None:
    """A serial server that has another client may accept and close; only a drive's answer proves a port."""

    async def play(stage: Bench) -> None:
        loop = asyncio.get_running_loop()
        stage.wire.faults.add(Fault(Kind.CUT))
        end = loop.time() + 120
        while loop.time() < end:
            opened = len(stage.twins)
            while len(stage.twins) == opened:
                await asyncio.sleep(0.01)
            await asyncio.sleep(0.3)  # it is up by then
            stage.twins[-1].unplug()
        assert 10 <= len(stage.twins) <= 17
        stage.wire.faults.clear()
        await asyncio.sleep(15)
        assert stage.link("d1") is LinkState.ONLINE
        stage.twins[-1].unplug()
        lost = len(stage.twins)
        await asyncio.sleep(1.0)
        assert len(stage.twins) == lost + 1

    run(lambda: bench([nc3()]), play)


def test_a_line_that_babbles_costs_each_poll_one_wait() -> None:
    """Who has waited a second for silence in vain does not wait for it once more before the frame."""

    async def play(stage: Bench) -> None:
        await asyncio.sleep(2.0)

        async def never_quiet() -> float:
            await asyncio.sleep(1.0)
            raise BadReply("babble")

        stage.twins[-1].quiet = never_quiet  # type: ignore[method-assign]
        stage.line_stats.errors.clear()
        begun = asyncio.get_running_loop().time()
        while stage.link("d1") is not LinkState.OFFLINE:
            await asyncio.sleep(0.01)
        passed = asyncio.get_running_loop().time() - begun
        assert passed == pytest.approx(stage.line_stats.errors["bad_reply"], abs=0.2)

    run(lambda: bench([nc3()]), play)
