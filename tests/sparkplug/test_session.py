"""What may be sent in which phase, and the numbers of messages and connections."""

from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from gateway.sparkplug.session import IN_SESSION, TRANSITIONS, Happening, Phase, Session
from tests.sparkplug.rig import Plant


def test_every_phase_knows_every_happening() -> None:
    """A table without a hole."""
    assert set(TRANSITIONS) == {(phase, happening) for phase in Phase for happening in Happening}


def test_births_come_in_their_order() -> None:
    """The host, the node, the devices, and only then data."""
    session = Session()
    order = [Happening.CONNECTED, Happening.HOST_ONLINE, Happening.NODE_BORN, Happening.DEVICES_BORN]
    phases = []
    for happening in order:
        session.take(happening)
        phases.append(session.phase)
    assert phases == [Phase.WAITING, Phase.NODE_BIRTH, Phase.DEVICE_BIRTHS, Phase.LIVE]


@pytest.mark.parametrize("phase", Phase)
def test_a_rebirth_begins_anew_where_there_is_a_session_and_nowhere_else(phase: Phase) -> None:
    """Before the first birth, and while the host is away, nobody may be told anything."""
    session = Session(phase, seq=17)
    session.take(Happening.REBIRTH)
    expected = (Phase.NODE_BIRTH, 0) if phase in IN_SESSION else (phase, 17)
    assert (session.phase, session.seq) == expected


@pytest.mark.parametrize("phase", Phase)
def test_a_host_that_goes_offline_ends_a_session_and_is_waited_for_without_one(phase: Phase) -> None:
    """It may come back on this connection where nothing was told by it."""
    session = Session(phase)
    session.take(Happening.HOST_OFFLINE)
    assert session.phase is (Phase.LEAVING if phase in IN_SESSION else phase)


def test_bd_seq_counts_connects_from_0_to_255() -> None:
    """Whether the broker accepted them or not."""
    session = Session()
    wills = []
    for _ in range(258):
        wills.append(session.next_bd_seq)
        session.connecting()
        assert session.bd_seq == wills[-1]
    assert wills == [*range(256), 0, 1]


def test_seq_counts_messages_from_0_to_255() -> None:
    """An NBIRTH begins with 0."""
    session = Session(Phase.WAITING, seq=99)
    session.take(Happening.HOST_ONLINE)
    numbers = []
    for _ in range(258):
        numbers.append(session.seq)
        session.sent()
    assert numbers == [*range(256), 0, 1]


class Anything(RuleBasedStateMachine):
    """A node to which anything happens in any order; a host would see each of its messages."""

    def __init__(self) -> None:
        super().__init__()
        self.plant = Plant()
        self.seen = 0
        self.next_seq: int | None = None
        self.is_pump_born = False
        self.deaths_owed = 0

    @rule()
    def connects(self) -> None:
        """Connect, if it is away."""
        if self.plant.node.session.phase is Phase.AWAY:
            self.plant.connect(host=False)
            self.next_seq = None

    @rule()
    def loses_the_connection(self) -> None:
        """Lose it."""
        self.plant.node.take(Happening.LOST)
        self.next_seq, self.is_pump_born = None, False

    @rule()
    def hears_that_the_host_is_online(self) -> None:
        """Hear it."""
        self.plant.node.take(Happening.HOST_ONLINE)

    @rule()
    def hears_that_the_host_is_offline(self) -> None:
        """Hear it."""
        self.plant.node.take(Happening.HOST_OFFLINE)

    @rule()
    def is_asked_for_a_rebirth(self) -> None:
        """Hear a request."""
        self.plant.node.rebirth()

    @rule()
    def reads_a_value(self) -> None:
        """Read a value that differs each time."""
        self.plant.read(output_frequency=round(self.plant.now * 7) % 8000)

    @rule()
    def loses_the_drive(self) -> None:
        """Lose it."""
        self.plant.pump.set_link(type(self.plant.pump.link).OFFLINE, "no answer")

    @rule()
    def finds_the_drive(self) -> None:
        """Find it again."""
        self.plant.pump.set_link(type(self.plant.pump.link).ONLINE)

    @rule()
    def runs_out_of_room(self) -> None:
        """Let the broker be slow."""
        self.plant.back.room = 0

    @rule()
    def has_room(self) -> None:
        """Let it take as much as there is."""
        self.plant.back.room = 100

    @rule()
    def settles(self) -> None:
        """Send what is owed."""
        self.plant.now += 0.3
        self.plant.settle()

    @invariant()
    def every_message_is_what_a_host_expects(self) -> None:
        """NBIRTH first and with 0, then no number is left out; a drive is born before its data, and dies once."""
        for sent in self.plant.back.sent[self.seen :]:
            if sent.kind == "NBIRTH":
                assert sent.payload.seq == 0
                self.next_seq, self.is_pump_born = 1, False
                continue
            assert self.next_seq is not None, sent
            assert sent.payload.seq == self.next_seq
            self.next_seq = (self.next_seq + 1) % 256
            if sent.kind == "DBIRTH":
                assert not self.is_pump_born
                self.is_pump_born = True
            elif sent.device:
                assert self.is_pump_born, sent
                self.is_pump_born = sent.kind != "DDEATH"
        self.seen = len(self.plant.back.sent)

    @invariant()
    def nothing_is_sent_where_nothing_may(self) -> None:
        """Neither while waiting for the host nor when the session is to end."""
        node = self.plant.node
        if node.session.phase in (Phase.AWAY, Phase.WAITING, Phase.LEAVING):
            assert not node.is_owing(self.plant.now)


TestAnything = Anything.TestCase
TestAnything.settings = settings(stateful_step_count=40)
