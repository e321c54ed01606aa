"""What the registers of the mirror ask for: once for the same words, again for others, and never what has ended."""

from __future__ import annotations

from typing import Any

import pytest

from gateway.control.command import Command, Reason, Source, Status, Verb
from gateway.control.state import Standing
from gateway.modbus_tcp.connection import source_of
from gateway.modbus_tcp.mirror import SHEETS, Sheets
from gateway.modbus_tcp.mirror_map import LINE_ORDERS, ORDERS, Place
from tests.modbus_tcp.plant import CODES, UNIT, Listening, Master, exchange, mirror, several

PLC = source_of(("10.0.0.7", "1"))
OTHER = source_of(("10.0.0.8", "1"))
RUN_WORD, STOP_WORD = 0xC400, 0x8000


def owned(**facts: int) -> Listening:
    """Return a server whose drive d1 is online, armed, and owned by the PLC."""
    made = Listening()
    state = made.door.state("d1")
    state.is_online = state.is_heard = True
    state.standing = Standing.ARMED
    state.facts |= facts
    state.lease.take(PLC, made.clock.now())
    return made


async def asked(made: Listening) -> tuple[Verb, float | None] | None:
    """Return verb and value of the one command that was asked for since, and let it be done; None without one."""
    assert len(made.door.asked) <= 1
    if not made.door.asked:
        return None
    command = await made.end()
    return command.verb, None if command.value is None else float(command.value)


def write(master: Master, *words: int, at: Place = Place.COMMAND) -> int:
    """Write registers of d1 by 10H; return the transaction."""
    return master.send(UNIT, several(mirror(at), *words))


def code(master: Master, transaction: int) -> int | None:
    """Return the exception code of an answer, 0 for a good one, None while there is none."""
    told = master.told(transaction)
    return None if told is None else told[1] if told[0] & 0x80 else 0


@pytest.mark.parametrize(("number", "word"), [(number, order.word) for number, order in ORDERS.items()])
async def test_every_code_is_one_command(number: int, word: str) -> None:
    """With its direction, and its number where it has one; the deadline is the drive's, the source the host."""
    made = owned()
    master = made.connect()
    write(master, 7, at=Place.PARAMETER)
    write(master, number)
    ((command, _),) = made.door.asked
    assert ("reverse" in word) is command.is_reverse
    assert str(command.verb) == word.removesuffix("_reverse")
    assert command.value == (7 if command.verb in (Verb.PRESET, Verb.ACCELERATION) else None)
    assert (command.drive, command.source) == ("d1", PLC)
    assert command.deadline == made.clock.now() + 1.0


def test_a_line_register_only_stops() -> None:
    """By the same codes."""
    assert {order.word for order in LINE_ORDERS.values()} == {"stop", "coast", "emergency_stop"}


class TestCyclicImage:
    """[command, heartbeat, frequency] in every cycle."""

    async def test_the_same_words_are_one_command(self) -> None:
        """Run at 30 Hz, once; the heartbeat is taken each time; every write is answered."""
        made = owned()
        master = made.connect()
        first = write(master, CODES["run"], 1, 3000)
        assert await asked(made) == (Verb.RUN, 30)
        made.door.state("d1").facts["command"] = RUN_WORD
        for beat in range(2, 100):
            again = write(master, CODES["run"], beat, 3000)
            assert await asked(made) is None
            assert code(master, again) == 0
        assert code(master, first) == 0
        assert [beat for _, _, beat in made.door.beats] == list(range(1, 100))

    async def test_another_frequency_is_a_setpoint(self) -> None:
        """Not another run command."""
        made = owned()
        master = made.connect()
        write(master, CODES["run"], 1, 3000)
        await asked(made)
        made.door.state("d1").facts["command"] = RUN_WORD
        write(master, CODES["run"], 2, 3500)
        assert await asked(made) == (Verb.FREQUENCY, 35)
        write(master, CODES["run"], 3, 3500)
        assert await asked(made) is None

    async def test_another_sequence_is_another_command(self) -> None:
        """The same code, with the frequency."""
        made = owned(command=RUN_WORD)
        master = made.connect()
        write(master, CODES["run"], 1, 3000, 0, 1)
        assert await asked(made) == (Verb.RUN, 30)
        write(master, CODES["run"], 2, 3000, 0, 1)
        assert await asked(made) is None
        write(master, CODES["run"], 3, 3000, 0, 2)
        assert await asked(made) == (Verb.RUN, 30)

    async def test_command_nothing_and_zeros_ask_for_nothing(self) -> None:
        """The image of a PLC that has just started."""
        made = owned()
        master = made.connect()
        for beat in range(5):
            assert code(master, write(master, 0, beat, 0, 0, 0)) == 0
        assert await asked(made) is None

    async def test_a_frequency_of_one_that_is_not_the_owner_waits_for_a_command(self) -> None:
        """Nothing is asked and nothing refused, until it has the lease: then it is sent by itself."""
        made = owned()
        state = made.door.state("d1")
        state.lease.end()
        master = made.connect()
        assert code(master, write(master, 0, 1, 3000)) == 0
        assert await asked(made) is None
        write(master, CODES["take"], 2, 3000)
        assert await asked(made) == (Verb.TAKE, None)
        state.lease.take(PLC, made.clock.now())
        write(master, CODES["take"], 3, 3000)
        assert await asked(made) == (Verb.FREQUENCY, 30)
        write(master, CODES["arm"], 4, 3000)
        assert await asked(made) == (Verb.ARM, None)

    async def test_a_frequency_beside_another_command_is_sent_in_the_next_cycle(self) -> None:
        """It is not lost; beside a stop it waits for a run command."""
        made = owned()
        master = made.connect()
        write(master, CODES["acceleration"], 1, 3000, 2)
        assert await asked(made) == (Verb.ACCELERATION, 2)
        write(master, CODES["acceleration"], 2, 3000, 2)
        assert await asked(made) == (Verb.FREQUENCY, 30)
        made.door.state("d1").facts["command"] = STOP_WORD
        write(master, CODES["stop"], 3, 1000, 2)
        assert await asked(made) == (Verb.STOP, None)
        write(master, CODES["stop"], 4, 1000, 2)
        assert await asked(made) is None
        write(master, CODES["run"], 5, 1000, 2)
        assert await asked(made) == (Verb.RUN, 10)

    async def test_a_frequency_does_not_go_out_while_a_command_is_under_way(self) -> None:
        """A drive that is being reset takes none; it is sent when that has ended."""
        made = owned()
        master = made.connect()
        write(master, CODES["reset"], 1, 3000)
        write(master, CODES["reset"], 2, 3000)
        assert await asked(made) == (Verb.RESET, None)
        write(master, CODES["reset"], 3, 3000)
        assert await asked(made) == (Verb.FREQUENCY, 30)

    async def test_another_sequence_without_a_command_sends_the_frequency_anew(self) -> None:
        """With a command it goes with that, or not at all."""
        made = owned()
        master = made.connect()
        for sequence in (1, 2):
            write(master, 0, 1, 3000, 0, sequence)
            assert await asked(made) == (Verb.FREQUENCY, 30)
        write(master, CODES["arm"], 1, 3000, 0, 3)
        assert await asked(made) == (Verb.ARM, None)
        made.door.state("d1").standing = Standing.ARMED
        write(master, CODES["arm"], 1, 3000, 0, 3)
        assert await asked(made) is None

    async def test_another_number_is_another_preset(self) -> None:
        """For the codes that have one; for the others the parameter says nothing."""
        made = owned(command=RUN_WORD)
        master = made.connect()
        write(master, CODES["preset"], 1, 0, 3)
        assert await asked(made) == (Verb.PRESET, 3)
        write(master, CODES["preset"], 2, 0, 4)
        assert await asked(made) == (Verb.PRESET, 4)
        write(master, CODES["run"], 3, 0, 4)
        assert await asked(made) == (Verb.RUN, 0)
        write(master, CODES["run"], 4, 0, 5)
        assert await asked(made) is None

    async def test_a_refusal_stands_as_long_as_the_words(self) -> None:
        """The same words get the same exception, and are not tried again; command 0 ends that."""
        made = owned()
        master = made.connect()
        first = write(master, CODES["run"], 1, 3000)
        await made.end(Status.REFUSED, Reason.NOT_ARMED)
        again = write(master, CODES["run"], 2, 3000)
        assert (code(master, first), code(master, again)) == (6, 6)
        assert made.door.asked == []
        assert code(master, write(master, 0, 3, 3000)) == 0
        assert made.door.asked == []

    async def test_words_that_come_again_while_they_are_carried_out_are_under_way(self) -> None:
        """05 at once, or by 17H what is read, with that status: one command, and its end for who asked first."""
        made = owned()
        first, second = made.connect(), made.connect()
        one = write(first, CODES["run"], 1, 3000)
        assert code(second, write(second, CODES["run"], 2, 3000)) == 5
        both = second.send(UNIT, exchange(mirror(Place.RESULT), 1, mirror(Place.COMMAND), CODES["run"], 3, 3000))
        assert second.told(both) == b"\x17\x02\x00\x05"
        assert len(made.door.asked) == 1
        await made.end(Status.UNKNOWN, Reason.NO_ANSWER)
        assert code(first, one) == 0x0B
        assert code(second, write(second, CODES["run"], 4, 3000)) == 0x0B


class TestWhatHasEnded:
    """Words that stand there while the world goes on."""

    @pytest.mark.hazard("H12")
    @pytest.mark.parametrize("word", ["run", "run_reverse", "jog"])
    async def test_motion_that_has_ended_is_not_taken_up_again(self, word: str) -> None:
        """06 in every cycle: by a lost lease, a trip, somebody's stop; neither an answer as if it still held."""
        endings: list[Any] = [
            lambda state: state.lease.end(),
            lambda state: setattr(state, "standing", Standing.DISARMED),
            lambda state: setattr(state, "is_online", False),
            lambda state: setattr(state, "is_tripped", True),
            lambda state: state.facts.update(command=STOP_WORD),
        ]

        for end in endings:
            made = owned()
            master = made.connect()
            write(master, CODES[word], 1, 0)
            await asked(made)
            made.door.state("d1").facts["command"] = RUN_WORD
            assert code(master, write(master, CODES[word], 2, 0)) == 0
            end(made.door.state("d1"))
            for beat in range(3, 6):
                assert code(master, write(master, CODES[word], beat, 0)) == 6
            assert made.door.asked == []

    @pytest.mark.parametrize("word", ["take", "arm"])
    async def test_permission_that_was_lost_is_not_taken_again(self, word: str) -> None:
        """It takes another word, or another sequence."""
        made = owned()
        master = made.connect()
        write(master, CODES[word], 1, 0)
        await asked(made)
        assert code(master, write(master, CODES[word], 2, 0)) == 0
        made.door.state("d1").lease.end()
        assert code(master, write(master, CODES[word], 3, 0)) == 6
        assert made.door.asked == []
        write(master, CODES[word], 4, 0, 0, 1)
        assert await asked(made) == (Verb(word), None)

    @pytest.mark.hazard("H29")
    @pytest.mark.parametrize("word", ["stop", "coast", "emergency_stop"])
    async def test_a_stop_that_stands_there_is_made_again_as_soon_as_the_drive_may_move(self, word: str) -> None:
        """And sends nothing while it holds."""
        made = owned(command=STOP_WORD)
        master, state = made.connect(), made.door.state("d1")
        write(master, CODES[word], 1, 0)
        assert await asked(made) == (Verb(word), None)
        assert code(master, write(master, CODES[word], 2, 0)) == 0
        assert made.door.asked == []
        for key, value in (("is_online", False), ("standing", Standing.LOST)):
            before = getattr(state, key)
            setattr(state, key, value)
            write(master, CODES[word], 3, 0)
            assert await asked(made) == (Verb(word), None)
            setattr(state, key, before)
        waiting: Any = object()  # a run command of somebody else, on its way
        state.queue.executions.append(waiting)
        write(master, CODES[word], 3, 0)
        assert await asked(made) == (Verb(word), None)
        state.queue.executions.clear()
        for held in (RUN_WORD, 0):  # it runs by command; the panel may start it
            state.facts["command"] = held
            write(master, CODES[word], 4, 0)
            assert await asked(made) == (Verb(word), None)
        state.is_tripped = True
        assert code(master, write(master, CODES[word], 5, 0)) == 0
        assert made.door.asked == []

    @pytest.mark.hazard("H29")
    @pytest.mark.parametrize("status", [Status.REFUSED, Status.FAILED, Status.UNKNOWN])
    async def test_a_stop_that_did_not_succeed_is_made_again(self, status: Status) -> None:
        """In every cycle, until the drive is stopped: a silent drive may come back running."""
        made = owned(command=RUN_WORD)
        master, state = made.connect(), made.door.state("d1")
        for beat in range(3):
            last = write(master, CODES["stop"], beat, 0)
            assert (await made.end(status, Reason.OFFLINE)).verb is Verb.STOP
            assert code(master, last) == 0x0B
        write(master, CODES["stop"], 4, 0)
        second = made.connect()
        assert code(second, write(second, CODES["stop"], 5, 0)) == 5
        state.facts["command"] = STOP_WORD
        assert await asked(made) == (Verb.STOP, None)
        assert code(master, write(master, CODES["stop"], 6, 0)) == 0


class TestOneRegister:
    """Registers that are written alone, as by hand."""

    async def test_a_command_is_made_each_time(self) -> None:
        """Twice the same is twice asked."""
        made = owned()
        master = made.connect()
        for _ in range(2):
            write(master, CODES["take"])
            assert await asked(made) == (Verb.TAKE, None)

    async def test_a_frequency_is_made_each_time_it_is_not_held(self) -> None:
        """What the drive holds is not sent again; after a reset, which forgets it, it is."""
        made = owned()
        master, state = made.connect(), made.door.state("d1")
        write(master, 3000, at=Place.FREQUENCY)
        assert await asked(made) == (Verb.FREQUENCY, 30)
        state.facts["frequency_command"] = 3000
        assert code(master, write(master, 3000, at=Place.FREQUENCY)) == 0
        assert made.door.asked == []
        del state.facts["frequency_command"]
        write(master, 3000, at=Place.FREQUENCY)
        assert await asked(made) == (Verb.FREQUENCY, 30)

    async def test_a_frequency_without_a_right_to_it_is_refused_each_time(self) -> None:
        """Also where the drive happens to hold it."""
        made = owned(frequency_command=3000)
        master = made.connect("10.0.0.8")
        for _ in range(2):
            last = write(master, 3000, at=Place.FREQUENCY)
            assert (await made.end(Status.REFUSED, Reason.NOT_OWNER)).value == 30
            assert code(master, last) == 6

    async def test_a_run_command_alone_has_no_frequency(self) -> None:
        """The drive goes on with what it holds; one that was written and not sent goes along."""
        made = owned()
        master = made.connect()
        write(master, CODES["run"])
        assert await asked(made) == (Verb.RUN, None)
        made.door.state("d1").lease.end()
        write(master, 0, 0, 2000)
        assert await asked(made) is None
        write(master, CODES["run"])
        assert await asked(made) == (Verb.RUN, 20)

    async def test_heartbeat_parameter_and_sequence_ask_for_nothing(self) -> None:
        """They are answered well, whoever writes them."""
        made = owned()
        master = made.connect("10.0.0.8")
        for place in (Place.HEARTBEAT, Place.PARAMETER, Place.SEQUENCE):
            assert code(master, write(master, 5, at=place)) == 0
        assert made.door.asked == []
        assert made.door.beats == [("d1", OTHER, 5)]


@pytest.mark.hazard("H04")
async def test_two_hosts_have_registers_of_their_own() -> None:
    """The words of one are no repetition for the other."""
    made = owned()
    for peer, source in (("10.0.0.7", PLC), ("10.0.0.8", OTHER), ("10.0.0.7", None)):
        write(made.connect(peer), CODES["run"], 1, 3000)
        commands: list[Command] = [command for command, _ in made.door.asked]
        assert [command.source for command in commands] == ([source] if source else [])
        if commands:
            await made.end()
        made.door.state("d1").facts["command"] = RUN_WORD


def test_the_sheets_are_bounded() -> None:
    """The longest unwritten goes first: whose words then come again, has them taken as new."""
    sheets = Sheets()
    first = sheets.of("d1", PLC)
    for i in range(SHEETS - 1):
        sheets.of("d1", Source(PLC.channel, str(i)))
    assert sheets.of("d1", PLC) is first
    sheets.of("d1", OTHER)
    assert sheets.of("d1", PLC) is first
    assert len(sheets._sheets) == SHEETS
