"""The file of a backlog as a state machine: whatever is done and whenever it is killed, what it holds is known."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from gateway.backlog import HistoricalReading
from gateway.store.backlog_file import BacklogFile
from gateway.store.backlog_schema import PAGE, SPARE, Limits, size_of
from tests.soak import FACTOR
from tests.store.backlogs import left_by_a_killed_process, reading

SMALL = Limits(6 * SPARE * PAGE, 3600.0, is_synced=False)
DRIVES = ("pump", "fan", "mixer")


class Machine(RuleBasedStateMachine):
    """A file, and beside it a list of what it has to hold: numbers and readings, the oldest first."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory(prefix="backlog-")
        self.path = Path(self.folder.name) / "backlog.sqlite"
        self.file = BacklogFile.open(self.path, SMALL)
        self.model: dict[int, HistoricalReading] = {}
        self.made = self.copies = 0
        self.last_number = 0

    def teardown(self) -> None:
        """Close the file."""
        self.file.close()
        self.folder.cleanup()

    @rule(
        count=st.integers(1, 40),
        drive=st.sampled_from(DRIVES),
        size=st.sampled_from([10, 300, 5000]),
        age=st.integers(0, 100),
    )
    def append(self, count: int, drive: str, size: int, age: int) -> None:
        """Write a batch: the oldest go where there is no room, and only then."""
        batch = []
        for _ in range(count):
            self.made += 1
            batch.append(reading(self.made, drive, ms=1000 - age, body=f"{self.made}:{'x' * size}"))
        done = self.file.append(batch)
        held = {kept.number: kept.reading for kept in self.file.take(0, 100_000)[0]}
        new = {number: one for number, one in held.items() if number > self.last_number}
        assert list(new.values()) == batch[len(batch) - done.stored :]
        before = [*self.model, *new]
        assert list(held) == before[len(before) - len(held) :], "the oldest go first"
        assert len(self.model) + count - len(held) == done.dropped
        if done.dropped:
            size_before = sum(map(size_of, [*self.model.values(), *batch]))
            assert size_before > SMALL.max_bytes // 5, "nothing goes while there is room"
        self.model = held
        self.last_number = max(new, default=self.last_number)

    @rule(every=st.integers(1, 4), first=st.integers(0, 20))
    def let_go(self, every: int, first: int) -> None:
        """Let some go, here and there, and one that is not there at all."""
        numbers = list(self.model)[first::every]
        assert self.file.let_go([*numbers, 10**9]) == len(numbers)
        for number in numbers:
            del self.model[number]

    @rule(age=st.integers(0, 100))
    def drop_older(self, age: int) -> None:
        """Let go what is too old."""
        young = {number: one for number, one in self.model.items() if one.ms >= 1000 - age}
        assert self.file.drop_older(1000 - age) == len(self.model) - len(young)
        self.model = young

    @rule()
    def shrink(self) -> None:
        """Give pages back: nothing else changes."""
        self.file.shrink()

    @rule()
    def restart(self) -> None:
        """Close it, and open it again."""
        origin = self.file.origin
        self.file.close()
        self.file = BacklogFile.open(self.path, SMALL)
        assert self.file.origin == origin

    @rule()
    def die(self) -> None:
        """Be killed, and go on with what is on the disk."""
        self.copies += 1
        copy = left_by_a_killed_process(self.path, Path(self.folder.name) / str(self.copies))
        self.file.close()
        self.path = copy
        self.file = BacklogFile.open(copy, SMALL)

    @invariant()
    def it_holds_what_it_has_to(self) -> None:
        """Nothing more, nothing less, in order, within its size."""
        found, damaged = self.file.take(0, 100_000)
        assert {kept.number: kept.reading for kept in found} == self.model
        assert [kept.number for kept in found] == sorted(self.model)
        assert not damaged
        assert self.file.rows == len(self.model)
        assert self.path.stat().st_size <= SMALL.max_bytes

    @rule(after=st.integers(0, 60), count=st.integers(1, 10), without=st.frozensets(st.sampled_from(DRIVES)))
    def take(self, after: int, count: int, without: frozenset[str]) -> None:
        """Ask for a part."""
        wanted = [n for n, one in self.model.items() if n > after and one.drive not in without][:count]
        assert [kept.number for kept in self.file.take(after, count, without)[0]] == wanted


Machine.TestCase.settings = settings(max_examples=12 * FACTOR, stateful_step_count=20, deadline=None)
TestBacklogFile = Machine.TestCase
