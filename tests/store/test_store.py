"""What outlives the process: counts of writes to the EEPROM, and the audit."""

from __future__ import annotations

import dataclasses
import json
import logging
import sqlite3
import threading
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

import pytest

from gateway import site
from gateway.control.command import Channel, Command, Reason, Result, Source, Status, Verb
from gateway.control.ledger import Entry
from gateway.control.wear import Key, Wear
from gateway.store import inbox, state_file, store
from gateway.store.errors import StoreAway
from gateway.store.schema import Saved
from gateway.store.state_file import StateFile, look
from gateway.store.store import Store, needs_store, store_path
from tests.store.rig import QUICK, WALL, HandClock, audit, counted, open_store, reserved, rows_of, running, until
from tests.web.rig import drive, table


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return where the file of a test is."""
    return tmp_path / "state.sqlite"


def event(text: str) -> Entry:
    """Return a row of the audit."""
    return Entry.of_event("pump", "armed", text, WALL)


@pytest.mark.hazard("H08")
async def test_a_write_is_in_the_file_before_it_is_permitted(path: Path) -> None:
    """Whoever is told "" finds the count in the file already, by any other reader."""
    seen = []
    async with open_store(path) as opened:
        for _ in range(3):
            opened.reserve("pump", 0x10, lambda problem: seen.append((problem, look(path).wear["pump", 0x10].writes)))
            await until(lambda: len(seen) == opened.count("pump", 0x10))
    assert seen == [("", 1), ("", 2), ("", 3)]


@pytest.mark.hazard("H08")
async def test_counts_go_on_after_a_restart(path: Path) -> None:
    """By drive and by number; each start adds to what was."""
    for start in range(3):
        async with open_store(path) as opened:
            assert opened.count("pump", 0x10) == start
            assert not await reserved(opened, "pump", 0x10)
            assert not await reserved(opened, "fan", 0x0875)
    assert {key: wear.writes for key, wear in look(path).wear.items()} == {("pump", 0x10): 3, ("fan", 0x0875): 3}


@pytest.mark.hazard("H08")
async def test_nothing_is_permitted_before_the_file_is_open_and_nothing_forgotten(path: Path) -> None:
    """A write that is made all the same is added to what the file turns out to hold."""
    await counted(path, 5)
    early = Store(path, 1000, HandClock())
    early.note("pump", 0x10)
    early.note("pump", 0x11)
    assert await reserved(early) == "the store is not open yet"
    early.start()
    await until(lambda: not early.problem)
    assert (early.count("pump", 0x10), early.count("pump", 0x11)) == (6, 1)
    await early.close()
    assert look(path).wear["pump", 0x10].writes == 6


async def test_short_texts_of_others_are_kept(path: Path) -> None:
    """The newest of each, also where the file was not open yet; nothing of them is taken for the store's own."""
    early = Store(path, 1000, HandClock(), QUICK)
    early.keep("audit_rows", "one")
    assert await early.recalled("audit_rows", 0.001) == "one"
    early.start()
    assert await early.recalled("other", 10) == ""
    early.keep("audit_rows", "two")
    await early.close()
    assert look(path).kept == {"audit_rows": "two"}
    async with running(path) as again:
        assert await again.recalled("audit_rows", 10) == "two"
        assert again._thread._audit_rows == 1000


async def test_texts_are_kept_when_the_file_is_back(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that says no once loses none."""
    async with open_store(path) as opened:
        monkeypatch.setattr(StateFile, "keep", _away)
        opened.keep("key", "text")
        await until(lambda: opened.problem)
        monkeypatch.undo()
        await until(lambda: not opened.problem)
    assert look(path).kept == {"key": "text"}


def _away(_file: StateFile, _texts: object) -> None:
    raise StoreAway("away")


async def test_after_the_end_nothing_is_permitted(path: Path) -> None:
    """The file is closed: another process may have it."""
    async with open_store(path) as opened:
        pass
    assert await reserved(opened) == "the gateway ends"


async def test_pace_and_last_write_are_kept_over_a_restart(path: Path) -> None:
    """By UTC in the file, by monotonic time in the process: they begin anew with each boot."""
    clock = HandClock()
    async with open_store(path, clock) as opened:
        assert opened.last("pump") == float("-inf")
        opened.note("pump", 0x10)
        before = opened.wear["pump", 0x10]
    after_boot = HandClock(moment=20.0, utc=WALL + 3600)
    async with open_store(path, after_boot) as opened:
        assert opened.last("pump") == 20.0 - 3600
        assert opened.last("fan") == float("-inf")
        assert opened.wear["pump", 0x10].pace == before.pace


async def test_a_clock_that_was_set_back_makes_the_last_write_now(path: Path) -> None:
    """A computer without a battery starts in the past: the budget must not count on a pause that was not."""
    await counted(path, 1)
    async with open_store(path, HandClock(moment=20.0, utc=1000.0)) as opened:
        assert opened.last("pump") == 20.0


@pytest.mark.hazard("H35")
async def test_while_the_folder_is_away_control_goes_on_and_stored_writes_are_refused(tmp_path: Path) -> None:
    """It is said why, tried again and again, and what was written all the same is in the file when it is back."""
    path = tmp_path / "mount" / "state.sqlite"
    async with running(path) as opened:
        await until(lambda: "no folder" in opened.problem)
        assert await reserved(opened) == opened.problem
        assert opened.count("pump", 0x10) == 0
        opened.note("pump", 0x10)
        opened.record(event("while it was away"))
        path.parent.mkdir()
        await until(lambda: not opened.problem)
        assert not await reserved(opened)
    assert look(path).wear["pump", 0x10].writes == 2
    assert audit(path) == [("armed", "while it was away")]


@pytest.mark.hazard("H35")
async def test_a_folder_in_the_place_of_the_file_is_said(path: Path) -> None:
    """And left as it is."""
    path.mkdir()
    async with running(path) as opened:
        await until(lambda: "is not a file" in opened.problem)
    assert path.is_dir()


@pytest.mark.hazard("H35")
async def test_another_program_that_writes_does_not_hold_up_the_loop(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The write is refused with the reason; when the other is done, the next is permitted, and none is uncounted."""
    monkeypatch.setattr(state_file, "BUSY_WAIT", 0.01)
    async with open_store(path) as opened:
        other = sqlite3.connect(path, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        assert "another program is writing to it" in await reserved(opened)
        other.execute("ROLLBACK")
        other.close()
        await until(lambda: not opened.problem)
        assert not await reserved(opened)
    assert look(path).wear["pump", 0x10].writes == 2


@pytest.mark.hazard("H35")
async def test_a_second_gateway_is_told_who_has_the_file(path: Path) -> None:
    """The first is not disturbed; when it ends, the second has all of its counts."""
    async with running(path) as second:
        await until(lambda: not second.problem)
        async with running(path) as first:
            await until(lambda: "in use by another process" in first.problem)
            assert not await reserved(second)
            assert "in use" in await reserved(first)
            await second.close()
            await until(lambda: not first.problem)
            assert first.count("pump", 0x10) == 1


@pytest.mark.hazard("H35")
async def test_a_disk_that_hangs_holds_up_neither_commands_nor_the_end(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The write is refused in time, and the next at once; when the disk is back, writes are permitted again."""
    monkeypatch.setattr(store, "CLOSE_WITHIN", 0.01)
    monkeypatch.setattr(store, "ANSWER_WITHIN", 0.01)
    told: list[str] = []
    goes_on, really_write = threading.Event(), StateFile.write

    def hang(file: StateFile, counts: Mapping[Key, Wear]) -> None:
        goes_on.wait()
        really_write(file, counts)

    async with open_store(path) as opened:
        monkeypatch.setattr(StateFile, "write", hang)
        opened.reserve("pump", 0x10, told.append)
        await until(lambda: told)
        assert told == ["the disk does not answer"]
        assert await reserved(opened) == opened.problem == f"{path}: the disk does not answer"
        goes_on.set()
        await until(lambda: not opened.problem)
        monkeypatch.setattr(store, "ANSWER_WITHIN", 10.0)
        assert not await reserved(opened)
        goes_on.clear()
        opened.note("pump", 0x10)
        await opened.close()
        assert "the last rows of the audit may be lost" in caplog.text
        goes_on.set()
    assert told == ["the disk does not answer"]


async def test_a_mistake_of_ours_is_told_and_does_not_end_the_thread(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Whatever it is: the write is refused, the log has the traceback, and it is tried again."""
    mistakes = [ValueError("a mistake")]

    def write(_file: StateFile, _counts: Mapping[Key, Wear]) -> None:
        raise mistakes.pop()

    async with open_store(path) as opened:
        with monkeypatch.context() as patch:
            patch.setattr(StateFile, "write", write)
            assert "a mistake" in await reserved(opened)
        await until(lambda: not opened.problem)
        assert not await reserved(opened)
    assert "the store has failed" in caplog.text
    assert look(path).wear["pump", 0x10].writes == 2


async def test_a_command_is_audited_with_all_that_was_asked_and_became_of_it(path: Path) -> None:
    """One row; words by register name as four hexadecimal digits; half a character does no harm."""
    source = Source(Channel.MQTT, "plc \ud800")
    command = Command("pump", Verb.FREQUENCY, source, 1.0, 2.0, id="c-7", value=Decimal("12.5"))
    result = Result(command, Status.FAILED, Reason.NOT_READ_BACK, "why", {"f": 0x4E2}, {"f": 1}, {"f": 0xBEEF})
    async with open_store(path) as opened:
        opened.record(Entry.of_result(result, WALL))
    columns = "time, drive, kind, source, verb, command_id, value, status, reason, text"
    assert audit(path, columns) == [
        (
            "2023-11-14T22:13:20.000Z",
            "pump",
            "command",
            "mqtt plc \\ud800",
            "frequency",
            "c-7",
            "12.5",
            "failed",
            "not_read_back",
            "why",
        )
    ]
    ((before, words, read_back),) = audit(path, "before, words, read_back")
    assert [json.loads(text) for text in (before, words, read_back)] == [{"f": "BEEF"}, {"f": "04E2"}, {"f": "0001"}]


async def test_the_audit_keeps_its_order_and_lets_the_oldest_go(path: Path) -> None:
    """So many rows as are configured, in a row."""
    async with open_store(path, rows=100) as opened:
        for number in range(2500):
            opened.record(event(str(number)))
    assert [int(text) for _, text in audit(path)] == list(range(2400, 2500))


async def test_the_audit_is_appended_to_only(path: Path) -> None:
    """Neither rows nor counts can be put right in silence, not even by hand with the sqlite3 shell."""
    async with open_store(path) as opened:
        opened.record(event("as it was"))
        await reserved(opened)
    with sqlite3.connect(path) as connection:
        for change in (
            "UPDATE audit SET text = 'otherwise'",
            "DELETE FROM audit",
            "UPDATE eeprom_writes SET writes = 0",
            "DELETE FROM eeprom_writes",
        ):
            with pytest.raises(sqlite3.IntegrityError):
                connection.execute(change)
    connection.close()
    assert audit(path) == [("armed", "as it was")]
    assert look(path).wear["pump", 0x10].writes == 1


@pytest.mark.hazard("H35")
async def test_rows_that_find_no_room_are_counted_and_the_audit_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the file is away only so many wait; the gap is in the audit itself afterwards."""
    monkeypatch.setattr(inbox, "WAITING", 3)
    path = tmp_path / "mount" / "state.sqlite"
    async with running(path) as opened:
        for number in range(5):
            opened.record(event(str(number)))
        assert opened.dropped == 2
        path.parent.mkdir()
        await until(lambda: not opened.problem)
    kept = [("armed", "0"), ("armed", "1"), ("armed", "2")]
    assert audit(path) == [*kept, ("audit_dropped", "2 rows were dropped: the store did not take them")]


@pytest.mark.hazard("H12")
async def test_no_setpoint_comes_back_from_the_store(path: Path) -> None:
    """What is read at a start are counts alone, whatever was commanded before: the audit is for people."""
    async with open_store(path) as opened:
        for verb, value in ((Verb.RUN, None), (Verb.FREQUENCY, Decimal(50))):
            command = Command("pump", verb, Source(Channel.MQTT, "plc"), 1.0, 2.0, value=value)
            opened.record(Entry.of_result(Result(command, Status.DONE, raw={"command": 0xC400}), WALL))
    assert len(audit(path)) == 2
    assert look(path) == Saved()
    assert {field.name for field in dataclasses.fields(Saved)} == {"wear", "begins_at", "lost", "kept"}
    tables = {name for (name,) in rows_of(path, "SELECT name FROM sqlite_master WHERE type = 'table'")}
    assert tables - {"sqlite_sequence"} == {"meta", "eeprom_writes", "audit"}
    assert {key for (key,) in rows_of(path, "SELECT key FROM meta")} == {"opened", "audit_rows", "begins_at"}


def test_the_file_is_where_it_is_configured(tmp_path: Path) -> None:
    """As given; else in the first of the folders that systemd names; else beside the configuration file."""
    section = site.build(table(store={"path": "x/own.sqlite"}), "test", tmp_path).config.store
    assert store_path(section, tmp_path, {"STATE_DIRECTORY": "/var/lib/a"}) == tmp_path / "x" / "own.sqlite"
    section = site.build(table(), "test", tmp_path).config.store
    assert store_path(section, tmp_path, {"STATE_DIRECTORY": "/var/lib/a:/b"}) == Path("/var/lib/a/state.sqlite")
    assert store_path(section, tmp_path, {}) == tmp_path / "state.sqlite"


@pytest.mark.parametrize("more", [{"control": "leased"}, {"control": "direct"}, {"provision": True}])
async def test_only_a_gateway_that_writes_has_a_store(tmp_path: Path, more: dict[str, object]) -> None:
    """Reading alone leaves no file behind; Sparkplug counts its connections in one."""
    lines = [{"name": "a", "port": "/dev/ttyA", "drive": [drive("pump", 1), drive("fan", 2, **more)]}]
    writes = site.build(table(line=lines, sparkplug=None), "test", tmp_path)
    made = Store.of(writes, HandClock(), {})
    assert made is not None
    assert made.path == tmp_path / "state.sqlite"
    reads = site.build(table(sparkplug=None), "test", tmp_path)
    assert needs_store(site.build(table(), "test", tmp_path))
    assert needs_store(writes)
    assert not needs_store(reads)
    assert Store.of(reads, HandClock(), {}) is None


async def test_the_problem_is_logged_once_and_so_is_its_end(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """However often it is tried."""
    path = tmp_path / "mount" / "state.sqlite"
    with caplog.at_level(logging.INFO, "gateway.store"):
        async with running(path) as opened:
            await until(lambda: "no folder" in opened.problem)
            path.parent.mkdir()
            await until(lambda: not opened.problem)
    said = [record.getMessage() for record in caplog.records]
    assert said == [
        f"{path}: there is no folder {path.parent}: writes to the EEPROM are refused, all else goes on",
        f"{path} is open again",
    ]
