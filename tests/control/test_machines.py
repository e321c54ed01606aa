"""The command path, the lease and the ownership as a state machine: whatever happens, the rules hold."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from gateway import site
from gateway.control.budget import Budget
from gateway.control.command import Channel, Command, Result, Source, Status, Verb
from gateway.control.composing import runs
from gateway.control.drive_control import DriveControl
from gateway.control.ledger import MemoryLedger
from gateway.control.settings import settings_of
from gateway.control.state import DriveState, Errand, Standing
from gateway.control.stored import StoredWrites
from gateway.errors import Refusal, Refused
from gateway.protocol.pdu import ReadWords, Words, WriteRam, WriteStored, Written
from tests import soak
from tests.control.test_control_line import CONTROL

SOURCES = (Source(Channel.MQTT, "panel"), Source(Channel.MODBUS_TCP, "10.0.0.7"))
MOVING = (Verb.RUN, Verb.JOG, Verb.FREQUENCY, Verb.PRESET)
OTHERS = (Verb.RESET, Verb.TAKE, Verb.ARM, Verb.RELEASE)
STEPS = st.sampled_from([0.01, 0.1, 0.5, 1.1, 3.0])
NUMBER = 1


def controlled(on_loss: object = "stop", mode: str = "leased") -> DriveControl:
    """Return the control of one VF-nC3 with a lease of 2 s and F803 = 1.5 s."""
    who = {"name": "d1", "number": NUMBER, "model": "vf-nc3"}
    drive_table = {**who, **CONTROL, "control": mode, "on_loss": on_loss}
    table = {
        "gateway": {"name": "t"},
        "line": [{"name": "a", "port": "/dev/null", "drive": [drive_table]}],
    }
    drive = site.build(table, "test", Path()).drives[0]
    assert drive.section is not None
    made = settings_of(drive.section)
    assert made is not None
    stored = StoredWrites("d1", MemoryLedger(), Budget(10, 20, 1000, 5000), lambda: None, _untold)
    return DriveControl(DriveState(drive, made, _untold), stored)


def _untold(_event: str, _reason: str) -> None:
    """Take an event."""


class CommandPath(RuleBasedStateMachine):
    """Controllers, a clock and a drive that answers, is silent, refuses, trips, is reset or is gone."""

    def __init__(self) -> None:
        super().__init__()
        self.control = controlled()
        self.now = 100.0
        self.words: dict[int, int] = {0x0803: 15, 0x0804: 2, 0x0808: 1}
        self.asked: list[Command] = []
        self.results: list[Result] = []
        self.stopped_at = -1  # how many commands had been asked when the last stop was admitted
        self.permitted_until = 0.0  # reckoned apart from the gateway's own lease
        self.owner: Source | None = None
        self.beats = 0
        self._come()

    # ---- what happens

    def _come(self) -> None:
        names = {r.name: r for r in self.control.drive.model.registers.values()}
        wanted = ("command", "communication_timeout", "timeout_action", "timeout_detection", "reset_detection")
        facts = {name: self.words.get(names[name].address, 0) for name in wanted}
        self.control.presence.on_online(facts, {"trip_code": bool(self.words.get(0xFC90))}, self.now)

    @rule(source=st.sampled_from(SOURCES), verb=st.sampled_from([*MOVING, *OTHERS]))
    def command(self, source: Source, verb: Verb) -> None:
        """Command as a controller."""
        self._ask(source, verb)

    @rule(source=st.sampled_from(SOURCES), verb=st.sampled_from([Verb.STOP, Verb.COAST, Verb.EMERGENCY_STOP]))
    def stop(self, source: Source, verb: Verb) -> None:
        """Stop the drive as a controller."""
        before = len(self.results)
        self._ask(source, verb)
        mine = [r for r in self.results[before:] if r.command is self.asked[-1]]
        if not mine:
            self.stopped_at = len(self.asked) - 1

    @rule(source=st.sampled_from(SOURCES))
    def start(self, source: Source) -> None:
        """Do all that it takes to run."""
        for verb in (Verb.TAKE, Verb.ARM):
            self._ask(source, verb)
            self._serve("answer", 6)
        self._ask(source, Verb.RUN)

    def _ask(self, source: Source, verb: Verb) -> None:
        value = Decimal(1 if verb is Verb.PRESET else 30) if verb in (Verb.RUN, Verb.FREQUENCY, Verb.PRESET) else None
        command = Command("d1", verb, source, self.now, self.now + 1.0, value=value)
        self.asked.append(command)
        self.control.submit(command, self.results.append, self.now)
        result = next((r for r in self.results if r.command is command), None)
        is_admitted = result is None or result.status is Status.DONE
        if is_admitted and verb is Verb.TAKE:
            self.owner = source
        if is_admitted and source == self.owner:
            self.permitted_until = max(self.permitted_until, self.now + 2.0)
        if is_admitted and verb is Verb.RELEASE:
            self.permitted_until, self.owner = self.now, None

    @rule(source=st.sampled_from(SOURCES), is_changed=st.booleans())
    def beat(self, source: Source, is_changed: bool) -> None:
        """Send a heartbeat."""
        self.beats += is_changed
        if self.control.beat(source, self.beats, self.now):
            assert source == self.owner
            assert is_changed or self.control.lease.owner == source
            self.permitted_until = max(self.permitted_until, self.now + 2.0)

    @rule(seconds=STEPS)
    def wait(self, seconds: float) -> None:
        """Time passes; whoever serves the line looks at it."""
        self.now += seconds
        self.control.tick(self.now)

    @rule(outcome=st.sampled_from(["answer", "silence", "refusal", "lost answer"]), count=st.integers(1, 5))
    def serve(self, outcome: str, count: int) -> None:
        """Carry what waits."""
        self._serve(outcome, count)

    def _serve(self, outcome: str, count: int) -> None:
        for _ in range(count):
            self.control.tick(self.now)
            if self.control.state.needs_set_up:
                self.control.presence.on_offline("it is set up anew", self.now)
                self._come()
            errand = self.control.errands.next(self.now)
            if errand is None:
                return
            self._check(errand)
            self.control.errands.sending(errand)
            self._exchange(errand, outcome)
            self.now += 0.02

    def _exchange(self, errand: Errand, outcome: str) -> None:
        request = errand.request
        if outcome in ("answer", "lost answer") and isinstance(request, WriteRam | WriteStored):
            self.words[request.address] = request.word
            if request.address == 0xFA00 and request.word & 1 << 13:
                self.words = {0x0803: 15, 0x0804: 2, 0x0808: 1}
                self.control.errands.on_reply(errand, None, self.now)
                return
        if outcome == "answer" and isinstance(request, ReadWords):
            self.control.errands.on_reply(errand, Words((self.words.get(request.address, 0),)), self.now)
        elif outcome == "answer":
            self.control.errands.on_reply(errand, Written(), self.now)
        elif outcome == "refusal":
            self.control.errands.on_refused(errand, Refused("no", Refusal.UNABLE), self.now)
        else:
            self.control.errands.on_silence(errand, "no answer", self.now)

    @rule(code=st.sampled_from([0, 24]))
    def trip(self, code: int) -> None:
        """Let the drive trip, or be no longer tripped."""
        self.words[0xFC90] = code
        if self.control.state.is_online:
            self.control.presence.on_trip(is_tripped=code != 0)

    @precondition(lambda self: self.control.state.is_online)
    @rule()
    def vanish(self) -> None:
        """Lose the link."""
        self.control.presence.on_offline("no answer", self.now)

    @precondition(lambda self: not self.control.state.is_online and not self.control.is_quiet)
    @rule(is_reset=st.booleans())
    def come(self, is_reset: bool) -> None:
        """Bring the drive back, as it was or reset."""
        if is_reset:
            self.words = {0x0803: 15, 0x0804: 2, 0x0808: 1}
        self._come()

    # ---- what must hold

    def _check(self, errand: Errand) -> None:
        """Look at a frame before it leaves."""
        assert not self.control.is_quiet, "a drive that is left alone is sent nothing"
        request = errand.request
        execution = errand.execution
        if execution is None or not isinstance(request, WriteRam | WriteStored):
            return
        command = execution.command
        if self.control.is_exclusive:
            assert execution.is_stop
        if command in self.asked and not execution.is_stop:
            assert self.asked.index(command) > self.stopped_at, "nothing older is sent after a stop"
            assert self.now <= command.deadline, "nothing is sent after its deadline"
        register = self.control.drive.model.registers["command"]
        if request.address == register.address and runs(register, request.word) and not execution.is_stop:
            assert self.control.standing is Standing.ARMED
            assert command.source == self.owner
            assert self.now <= self.permitted_until

    @invariant()
    def every_command_has_at_most_one_result(self) -> None:
        """And it is one that was asked for."""
        assert len({id(r.command) for r in self.results}) == len(self.results)

    @invariant()
    def the_queue_is_bounded(self) -> None:
        """Whatever comes."""
        assert len(self.control.state.queue.executions) <= 17

    @invariant()
    def only_the_owner_has_a_lease(self) -> None:
        """And no longer than its signs of life allow."""
        if self.control.lease.is_held(self.now):
            assert self.control.lease.owner == self.owner
            assert self.control.lease.until <= self.permitted_until + 1e-9

    def teardown(self) -> None:
        """In the end every command has exactly one result."""
        for _ in range(200):
            self.now += 0.5
            self._serve("answer", 3)
            if self.control.is_quiet:
                continue
            if not self.control.state.is_online:
                self._come()
        assert {id(r.command) for r in self.results} == {id(c) for c in self.asked}


TestCommandPath = pytest.mark.unmeasured(pytest.mark.hazard("H04", "H10", "H11")(CommandPath.TestCase))
TestCommandPath.settings = settings(max_examples=120 * soak.FACTOR, stateful_step_count=40, deadline=None)
