"""A store's file that is damaged, not ours, or from another version: what is done, and what is never done."""

from __future__ import annotations

import random
import shutil
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from pathlib import Path

import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway.control.ledger import Entry
from gateway.control.wear import Key, Wear
from gateway.store.errors import StoreAway, StoreDamaged
from gateway.store.schema import VERSION
from gateway.store.state_file import StateFile, begin_anew, look
from gateway.store.store import NOT_YET
from tests.soak import FACTOR
from tests.store.rig import WALL, audit, counted, open_store, reserved, running, until

PAGE = 4096  # bytes


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return where the file of a test is."""
    return tmp_path / "state.sqlite"


def overwrite(path: Path, start: int, rubbish: bytes) -> None:
    """Write over a part of a file."""
    content = bytearray(path.read_bytes())
    content[start : start + len(rubbish)] = rubbish
    path.write_bytes(content)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "rubbish": lambda path: path.write_bytes(random.Random(1).randbytes(20_000)),
    "zeros": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "no header": lambda path: overwrite(path, 0, bytes(100)),
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: 2 * PAGE]),
    "a page of rubbish": lambda path: overwrite(path, 2 * PAGE, random.Random(2).randbytes(PAGE)),
    "no tables": lambda path: overwrite(path, 100, bytes(PAGE - 100)),
}


def set_aside(path: Path) -> list[Path]:
    """Return the files that were set aside."""
    return sorted(one for one in path.parent.glob(f"{path.name}.damaged-*") if one.name[-4:] not in ("-wal", "-shm"))


@pytest.mark.hazard("H35")
@pytest.mark.parametrize("damage", list(DAMAGES))
async def test_a_damaged_file_is_set_aside_and_no_count_is_taken_to_be_0(path: Path, damage: str) -> None:
    """It is kept as it was; stored writes are refused, all else goes on, until an operator accepts a count."""
    await counted(path, 7)
    DAMAGES[damage](path)
    damaged = path.read_bytes()
    async with running(path) as store:
        await until(lambda: "store accept" in store.problem)
        assert await reserved(store) == store.problem
        store.note("fan", 0x20)
        store.record(Entry.of_event("pump", "armed", "control goes on", WALL))
    (kept,) = set_aside(path)
    assert kept.read_bytes() == damaged
    assert str(kept) in look(path).lost
    assert audit(path) == [("armed", "control goes on")]
    async with running(path) as store:
        await until(lambda: "store accept" in store.problem)
    state = StateFile.open(path, 1000, WALL)
    state.accept(1500)
    state.close()
    async with open_store(path) as store:
        assert not await reserved(store)
        counts = (store.count("pump", 0x10), store.count("fan", 0x20), store.count("fan", 0x21))
        assert counts == (1501, 1500, 1500)
        assert not await reserved(store, "fan", 0x21)
        assert store.count("fan", 0x21) == 1501


@pytest.mark.hazard("H35")
async def test_what_a_damaged_file_still_tells_is_taken_over(path: Path) -> None:
    """A broken audit leaves the counts readable: they are more than an operator may remember."""
    await counted(path, 2000)
    with closing(sqlite3.connect(path)) as connection:
        (page,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = 'audit'").fetchone()
    overwrite(path, (page - 1) * PAGE, random.Random(3).randbytes(PAGE))
    async with running(path) as store:
        await until(lambda: "1 counts could be read from it, the highest 2000" in store.problem)
        assert store.count("pump", 0x10) == 2000
        assert await reserved(store)
    state = StateFile.open(path, 1000, WALL)
    state.accept(1500)
    state.close()
    async with open_store(path) as store:
        assert (store.count("pump", 0x10), store.count("pump", 0x11)) == (2000, 1500)


@pytest.mark.hazard("H35")
async def test_a_file_that_is_damaged_while_it_is_open_costs_no_count(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are known in memory, and written anew: nothing has to be accepted."""

    def write(_file: StateFile, _counts: Mapping[Key, Wear]) -> None:
        raise StoreDamaged("database disk image is malformed")

    await counted(path, 7)
    async with open_store(path) as store:
        store.note("fan", 0x20)
        with monkeypatch.context() as patch:
            patch.setattr(StateFile, "write", write)
            assert "malformed" in await reserved(store)
        await until(lambda: not store.problem)
        assert store.count("pump", 0x10) == 8
        assert not await reserved(store)
    assert len(set_aside(path)) == 1
    saved = look(path)
    assert (saved.lost, saved.wear["pump", 0x10].writes, saved.wear["fan", 0x20].writes) == ("", 9, 1)


@pytest.mark.hazard("H35")
async def test_counts_that_were_lost_stay_lost_when_the_new_file_is_damaged_too(path: Path) -> None:
    """Known are only those since the first loss."""
    await counted(path, 7)
    path.write_bytes(b"")
    async with running(path) as store:
        await until(lambda: "store accept" in store.problem)
    path.write_bytes(b"rubbish" * 1000)
    async with running(path) as store:
        await until(lambda: "store accept" in store.problem)
    assert len(set_aside(path)) == 2


@pytest.mark.hazard("H35")
@pytest.mark.parametrize("rest", ["write-ahead log", "set aside"])
async def test_a_file_that_was_there_before_is_not_begun_with_0(path: Path, rest: str) -> None:
    """As after a loss of power between setting it aside and beginning anew, or a deletion of one file of two."""
    await counted(path, 7)
    if rest == "set aside":
        path.rename(path.with_name("state.sqlite.damaged-20260101T000000Z-1"))
    else:
        path.with_name("state.sqlite-wal").write_bytes(b"some frames")
        path.unlink()
    async with running(path) as store:
        await until(lambda: "store accept" in store.problem)
        assert store.count("pump", 0x10) == (7 if rest == "set aside" else 0)
        assert await reserved(store) == store.problem


@pytest.mark.hazard("H35")
def test_a_new_file_that_cannot_be_begun_leaves_no_file_that_counts_from_0(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full after the old file was set aside: at the next try counts are still lost."""
    path.write_bytes(b"rubbish" * 1000)

    def full(_path: Path, _saved: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("gateway.store.state_file._create", full)
        with pytest.raises(StoreAway, match="No space left"):
            begin_anew(path, WALL, None)
    assert not path.exists()
    with pytest.raises(StoreDamaged, match="missing, though it was there"):
        StateFile.open(path, 1000, WALL)
    begin_anew(path, WALL, None)
    assert look(path).lost
    assert len(set_aside(path)) == 1


@pytest.mark.parametrize("kind", ["newer", "foreign", "foreign and empty"])
async def test_a_file_that_is_not_for_us_is_left_as_it_is(path: Path, kind: str) -> None:
    """A database of another program, or of a newer gateway, is neither written to nor set aside."""
    if kind == "newer":
        await counted(path, 7)
    with closing(sqlite3.connect(path, isolation_level=None)) as connection:
        if kind == "newer":
            connection.execute(f"PRAGMA user_version = {VERSION + 1}")
        elif kind == "foreign":
            connection.execute("CREATE TABLE addresses (name TEXT)")
        else:
            connection.execute("PRAGMA user_version = 3")
    before = path.read_bytes()
    async with running(path) as store:
        words = "another version" if kind == "newer" else "no store of this gateway"
        await until(lambda: words in store.problem)
        assert await reserved(store) == store.problem
    assert path.read_bytes() == before
    assert not set_aside(path)


@pytest.mark.hazard("H35")
@pytest.mark.parametrize("place", ["anywhere", "in the count"])
async def test_whatever_is_wrong_in_a_file_no_count_is_lower_without_a_word(path: Path, place: str) -> None:
    """Some bytes are changed: either the count is there still, or the file is said to be damaged or not ours."""
    chance = random.Random(place)
    whole = path.with_name("whole.sqlite")
    await counted(whole, 7)
    content = whole.read_bytes()
    heard = set()
    for number in range(60 * FACTOR):
        changed = path.with_name(f"{number}.sqlite")
        shutil.copy(whole, changed)
        start, length = chance.randrange(len(content)), chance.randrange(1, 2 * PAGE)
        if place == "in the count":
            start, length = content.index(b"pump") + chance.randrange(-8, 32), chance.randrange(1, 3)
        overwrite(changed, start, chance.randbytes(length)[: len(content) - start])
        async with running(changed) as store:
            await until(lambda: store.problem != NOT_YET)
            assert store.problem or store.count("pump", 0x10) == 7
            heard.add(bool(store.problem))
    assert heard == {True, False}


def command(*arguments: str) -> tuple[int, str]:
    """Run the command line; return its exit code, and what it printed or why it failed."""
    done = CliRunner().invoke(app, arguments)
    return done.exit_code, done.output + (f"{done.exception}" if done.exception else "")


@pytest.fixture
def configuration(path: Path) -> str:
    """Return a configuration file beside the store's."""
    file = path.with_name("gateway.toml")
    file.write_text(
        '[gateway]\nname = "g"\n[[line]]\nname = "a"\nport = "/dev/ttyA"\n'
        '[[line.drive]]\nname = "pump"\nnumber = 1\nmodel = "vf-nc3"\ncontrol = "leased"\n'
    )
    return str(file)


async def test_counts_are_shown_while_the_gateway_has_the_file(path: Path, configuration: str) -> None:
    """Each parameter by its communication number, and what is taken for the others."""
    async with open_store(path) as store:
        for _ in range(3):
            await reserved(store, "pump", 0x0803)
        code, text = command("store", "show", configuration)
    assert code == 0
    assert "0803       3 writes, last 2023-11-14T22:13:20.000Z" in text
    assert "every other was written 0 times at most" in text


@pytest.mark.hazard("H35")
async def test_an_operator_accepts_a_count_by_a_command(path: Path, configuration: str) -> None:
    """Only where counts were lost, and only while no gateway has the file."""
    assert command("store", "accept", configuration, "--writes", "5") == (
        1,
        f"{path}: there is no such file, and so nothing is lost; the gateway makes it when it starts",
    )
    await counted(path, 7)
    code, text = command("store", "accept", configuration, "--writes", "5")
    assert (code, "no counts are lost" in text) == (1, True)
    path.write_bytes(b"")
    async with running(path) as store:
        await until(lambda: "store accept" in store.problem)
        code, text = command("store", "accept", configuration, "--writes", "300")
        assert (code, "in use by another process" in text) == (1, True)
        code, text = command("store", "show", configuration)
        assert (code, "was damaged and is kept as" in text) == (1, True)
    code, text = command("store", "accept", configuration, "--writes", "300")
    assert (code, "300 times at least" in text) == (0, True)
    async with open_store(path) as store:
        assert store.count("pump", 0x10) == 300
