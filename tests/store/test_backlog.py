"""The backlog of a broker: what it keeps, what it drops and says so, and that nothing of its disk stops anything."""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gateway import site
from gateway.backlog import Loss
from gateway.config import SparkplugSection
from gateway.site import Site
from gateway.store import backlog_inbox
from gateway.store.backlog import backlog_name, backlog_path, summary
from gateway.store.backlog_file import BacklogFile
from gateway.store.backlog_schema import PAGE, SPARE, Limits, fitting, kept_of, row_of, size_of, to_drop
from gateway.store.place import beside
from tests.mqtt.rig import section
from tests.store.backlogs import LIMITS, asked, reading, running
from tests.store.rig import until
from tests.store.test_processes import unprivileged
from tests.web.rig import table


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return where the file of a test is."""
    return tmp_path / "backlog.sqlite"


async def test_readings_come_back_in_order_and_until_they_are_let_go(path: Path) -> None:
    """Also after a restart; their numbers go on, and their file is told from any other."""
    async with running(path) as backlog:
        for number in range(5):
            backlog.put(reading(number))
        first = await asked(backlog)
        assert [kept.reading.body for kept in first] == [reading(number).body for number in range(5)]
        backlog.let_go([kept.number for kept in first])
        origin = backlog.origin
        assert backlog.stats.stored == 5
    async with running(path) as backlog:
        backlog.put(reading(9))
        (kept,) = await asked(backlog)
        assert kept.number == first[-1].number + 1
        assert backlog.origin == origin
        assert backlog.stats.waiting == 1


async def test_some_drives_can_be_passed_over(path: Path) -> None:
    """Theirs stay, and are given when they are asked for."""
    async with running(path) as backlog:
        for number, drive in enumerate(("pump", "fan", "pump", "fan")):
            backlog.put(reading(number, drive))
        some = await asked(backlog, without=frozenset({"pump"}))
        assert [kept.reading.drive for kept in some] == ["fan", "fan"]
        assert len(await asked(backlog)) == 4
        assert [kept.number for kept in await asked(backlog, after=some[0].number, count=1)] == [some[0].number + 1]


async def test_no_file_is_made_while_there_is_nothing_to_keep(path: Path) -> None:
    """A gateway whose broker is always there writes nothing."""
    async with running(path) as backlog:
        assert await asked(backlog) == []
    assert not list(path.parent.iterdir())


async def test_the_oldest_give_way_and_are_counted(path: Path) -> None:
    """By size; the newest are there."""
    async with running(path, Limits(6 * SPARE * PAGE, 3600.0)) as backlog:
        for number in range(300):
            backlog.put(reading(number, body=f"{number}:".ljust(1000)))
            if not number % 20:
                await until(lambda: not backlog._thread.inbox.waiting)
        await until(lambda: backlog.stats.stored == 300)
        kept = await asked(backlog, count=1000)
    assert [each.reading.body[:3] for each in kept][-1] == "299"
    assert backlog.stats.dropped == {Loss.SIZE: 300 - len(kept)}
    assert path.stat().st_size <= 6 * SPARE * PAGE


async def test_what_is_too_old_is_dropped_and_counted(path: Path) -> None:
    """Whether it was stored by this process or by one before."""
    old = int((time.time() - 100) * 1000)
    async with running(path, Limits(LIMITS.max_bytes, 1000.0)) as backlog:
        backlog.put(reading(1, ms=old))
        await until(lambda: backlog.stats.stored)
    async with running(path, Limits(LIMITS.max_bytes, 60.0)) as backlog:
        await until(lambda: backlog.stats.dropped)
        backlog.put(reading(2))
        backlog.put(reading(3, ms=old))
        await until(lambda: backlog.stats.dropped[Loss.AGE] == 2)
        assert [kept.reading.body for kept in await asked(backlog)] == [reading(2).body]


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "rubbish": lambda path: path.write_bytes(random.Random(1).randbytes(20_000)),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:PAGE]),
}


@pytest.mark.hazard("H35")
@pytest.mark.parametrize("damage", list(DAMAGES))
async def test_a_damaged_file_is_set_aside_and_a_new_one_begun(path: Path, damage: str) -> None:
    """One of them is kept, so that a bad disk is not filled with them; the numbers are of another origin."""
    origins = set()
    for _ in range(3):
        async with running(path) as backlog:
            backlog.put(reading(1))
            await until(lambda: backlog.stats.stored)
            origins.add(backlog.origin)
        DAMAGES[damage](path)
    async with running(path) as backlog:
        backlog.put(reading(2))
        await until(lambda: backlog.stats.stored)
        assert [kept.reading.body for kept in await asked(backlog)] == [reading(2).body]
        origins.add(backlog.origin)
    assert len(origins) == 4
    assert len([name for name in path.parent.glob("*.damaged-*") if not name.name.endswith(("-wal", "-shm"))]) == 1


@pytest.mark.hazard("H35")
async def test_a_row_that_is_not_as_it_was_written_is_never_sent(path: Path) -> None:
    """It is dropped and counted; the others are whole."""
    async with running(path) as backlog:
        for number in range(3):
            backlog.put(reading(number))
        await until(lambda: backlog.stats.stored == 3)
    content = path.read_bytes()
    wal = beside(path, "-wal")
    assert not wal.exists() or not wal.stat().st_size
    path.write_bytes(content.replace(b'"output_frequency":"1"', b'"output_frequency":"7"'))
    async with running(path) as backlog:
        left = await asked(backlog)
        assert [kept.reading.body for kept in left] == [reading(0).body, reading(2).body]
        await until(lambda: backlog.stats.dropped == {Loss.DAMAGED: 1})
        backlog.let_go([])
        assert len(await asked(backlog)) == 2
        await until(lambda: backlog.stats.waiting == 2)


@pytest.mark.hazard("H35")
async def test_a_file_of_another_program_is_left_alone(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It is said; readings wait in memory, within bounds."""
    with caplog.at_level(logging.WARNING):
        file = BacklogFile.open(path, LIMITS)
        file._connection.execute("PRAGMA application_id = 7")
        file.close()
        before = path.read_bytes()
        async with running(path) as backlog:
            backlog.put(reading(1))
            await until(lambda: backlog.stats.has_problem)
            assert await asked(backlog) == []
        await until(lambda: backlog.stats.dropped == {Loss.DISK: 1})
    assert path.read_bytes() == before
    assert caplog.text.count("is no backlog of this gateway") == 1


@pytest.mark.hazard("H35")
async def test_in_a_folder_that_is_read_only_readings_are_dropped_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing waits for it, and nothing stops."""
    monkeypatch.setattr(backlog_inbox, "WAITING", 10 * size_of(reading(10)))
    with unprivileged() as folder:
        async with running(folder / "backlog.sqlite") as backlog:
            for number in range(10, 40):
                backlog.put(reading(number))
            await until(lambda: backlog.stats.has_problem)
            assert backlog.stats.dropped[Loss.DISK] >= 19
            assert await asked(backlog) == []
        assert not list(folder.iterdir())


@pytest.mark.hazard("H35")
async def test_as_soon_as_there_is_a_folder_what_waits_is_written(tmp_path: Path) -> None:
    """A disk that comes later is found."""
    path = tmp_path / "later" / "backlog.sqlite"
    async with running(path) as backlog:
        backlog.put(reading(1))
        await until(lambda: backlog.stats.has_problem)
        path.parent.mkdir()
        await until(lambda: backlog.stats.stored == 1)
        assert not backlog.stats.has_problem
        assert len(await asked(backlog)) == 1


async def test_two_gateways_do_not_share_a_file(path: Path) -> None:
    """The second says who has it."""
    async with running(path) as first:
        first.put(reading(1))
        await until(lambda: first.stats.stored)
        async with running(path) as second:
            second.put(reading(2))
            await until(lambda: second.stats.has_problem)
        assert len(await asked(first)) == 1


def configured(folder: Path, **keys: object) -> Site:
    """Return a site with further keys in its configuration."""
    return site.build(table(**keys), "gateway.toml", folder)


def test_the_file_is_where_it_is_configured_to_be(tmp_path: Path) -> None:
    """Else in the folder of the store: as configured, in the state directory, or beside the configuration."""
    environment = {"STATE_DIRECTORY": "/var/lib/gateway:/other"}
    own = section(store={"path": "x.sqlite"})
    plain, placed = configured(tmp_path), configured(tmp_path, store={"path": "/var/lib/store/state.sqlite"})
    name = f"backlog-{plain.config.gateway.name}-mqtt.sqlite"
    assert backlog_path(plain, own, environment) == tmp_path / "x.sqlite"
    assert backlog_path(plain, section(), environment) == Path("/var/lib/gateway") / name
    assert backlog_path(plain, section(), {}) == tmp_path / name
    assert backlog_path(placed, section(), environment) == Path("/var/lib/store") / name


def test_each_broker_has_a_file_of_its_own(tmp_path: Path) -> None:
    """By the names of gateway and broker; `check` says which, and how much it may hold."""
    cloud = section(name="cloud")
    edge = SparkplugSection.model_validate({"url": "mqtt://broker", "group_id": "g", "store": {"enabled": False}})
    names = [backlog_name("hall-3", each) for each in (section(), cloud, edge)]
    assert names == ["hall-3-mqtt", "hall-3-mqtt-cloud", "hall-3-sparkplug"]
    plain = configured(tmp_path)
    path = backlog_path(plain, cloud, {})
    assert summary(plain, cloud, {}) == f"kept while the broker is away: {path}, at most 64 MiB and 168 h"
    assert summary(plain, edge, {}) == "nothing is kept while the broker is away"


def test_a_row_is_as_it_was_written_or_nothing() -> None:
    """Every column counts."""
    row = (1, *row_of(reading(1, ms=5)))
    kept = kept_of(row)
    assert kept is not None
    assert (kept.number, kept.reading) == (1, reading(1, ms=5))
    for place, wrong in ((1, "fan"), (2, "event"), (2, "command"), (3, 6), (3, "5"), (4, "{}"), (5, 0), (4, None)):
        assert kept_of((*row[:place], wrong, *row[place + 1 :])) is None


def test_what_can_never_fit_is_not_tried() -> None:
    """Of a batch larger than the file its newest part is written."""
    limits = Limits(2 * SPARE * PAGE, 60.0)
    batch = [reading(number, body="x" * 4000) for number in range(20)]
    assert len(fitting(batch, limits)) == 6
    assert fitting(batch, limits)[-1] is batch[-1]
    assert to_drop(batch, 0, 0, limits) == 0
    assert to_drop([], 10, 2 * SPARE, limits) == 5
