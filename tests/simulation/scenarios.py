"""The scenarios: each a set-up that is drawn by chance, and what then happens, by chance too."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from random import Random

from gateway.control.command import Verb
from gateway.sim.condition import TripCode
from gateway.sim.faults import Fault, Kind
from tests import soak
from tests.simulation import scripts
from tests.simulation.broker import Message
from tests.simulation.controllers import Controller, MqttController
from tests.simulation.orders import Order
from tests.simulation.plant import Plant
from tests.simulation.setup import ROOT, Setup, drawn

LONG_DAY = 120.0  # seconds, times the factor of the long search
SETTLING = 1.0  # seconds beyond the last bound, in which nothing may start again
AT_WORK = (1.0, 4.0)  # seconds after the start, between which most things happen
NOISE = (
    Kind.CUT,
    Kind.REQUEST_FLIP,
    Kind.DROP,
    Kind.LATE,
    Kind.DUPLICATE,
    Kind.TRUNCATE,
    Kind.SPLIT,
    Kind.FLIP,
    Kind.BABBLE,
)


@dataclass(frozen=True, slots=True)
class Scenario:
    """One scenario. `play` returns when the trial is over; the gateway is ended then."""

    setup: Callable[[Random], Setup]
    play: Callable[[Plant], Awaitable[None]]


# ---- what scenarios have in common


def at_work(plant: Plant, *, by_mqtt: bool = False) -> list[Controller]:
    """Give every drive to a controller of its own, which operates it."""
    made: list[Controller] = []
    for place, drive in enumerate(plant.drives):
        controller = plant.mqtt(f"scada-{place}") if by_mqtt else plant.anybody(place)
        controller.play(controller.beat_for(drive))
        controller.play(scripts.operate(controller, drive, plant.hertz))
        made.append(controller)
    return made


def some_die(plant: Plant, earliest: float, latest: float, share: float = 0.6) -> None:
    """Let some controllers die, each at a time of its own."""
    for controller in plant.controllers:
        if plant.chance.random() < share:
            plant.world.after(plant.chance.uniform(earliest, latest), controller.die)


async def over(plant: Plant) -> None:
    """Let whoever lives die, and everything come to its end."""
    for controller in plant.controllers:
        if controller.is_alive:
            controller.die()
    await plant.last(plant.setup.lease + plant.setup.timeout + SETTLING)


# ---- the scenarios


async def death_in_every_state(plant: Plant) -> None:
    """Let each controller die in some state of its drive, at any moment of it."""
    plant.start()
    for place, drive in enumerate(plant.drives):
        controller = plant.anybody(place)
        state = plant.chance.choice(scripts.STATES)

        def reached(controller: Controller = controller) -> None:
            plant.world.after(plant.chance.uniform(0.0, 0.25), controller.die)

        controller.play(controller.beat_for(drive))
        controller.play(scripts.up_to(state, controller, drive, plant.hertz, reached))
    end = plant.world.now + 8.0
    while any(controller.is_alive for controller in plant.controllers) and plant.world.now < end:
        await plant.last(0.1)
    await over(plant)


async def noise_on_the_line(plant: Plant) -> None:
    """Lose, damage, delay, split, double any share of requests and answers, while controllers die."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK)
    for kind in chance.sample(NOISE, chance.choice((1, 2, 3))):
        begin, share = chance.uniform(0.0, 4.0), chance.choice((0.02, 0.1, 0.3, 0.6, 1.0))
        length = chance.choice((0.3, 1.0, 3.0, 10.0))
        drive = chance.choice((None, *plant.drives.values()))
        fault = Fault(kind, drive, probability=share, until=plant.world.now + begin + length)
        plant.world.after(begin, partial(plant.fault, fault))
    await plant.last(4.5)
    await over(plant)


async def adapter_unplugged(plant: Plant) -> None:
    """Pull the adapter out while motors run, and put it back sooner or later."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK)
    begin = chance.uniform(*AT_WORK)
    for _ in range(chance.choice((1, 1, 2))):
        away = chance.choice((0.05, 0.3, 1.0, 2.5))
        plant.world.after(begin, partial(plant.unplug, away))
        begin += away + chance.uniform(0.3, 2.0)
    await plant.last(4.5)
    await over(plant)


async def drives_fail(plant: Plant) -> None:
    """Cut the power of drives, reset or trip them while they run."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK, share=0.4)
    for _ in range(chance.choice((1, 2, 3))):
        name, when = chance.choice(list(plant.drives)), chance.uniform(*AT_WORK)
        off = chance.choice((0.0, 0.0, 0.2, 1.5))
        if chance.random() < 0.3:
            plant.world.after(when, partial(plant.trip, name, TripCode.EMERGENCY))
        else:
            plant.world.after(when, partial(plant.power_cycle, name, off))
    await plant.last(5.0)
    await over(plant)


async def gateway_killed(plant: Plant) -> None:
    """Kill the gateway, perhaps start it again, while drives go on and controllers live, or do not."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK, share=0.5)
    begin = chance.uniform(1.2, 3.5)
    for _ in range(chance.choice((1, 1, 2))):
        plant.world.after(begin, plant.kill)
        begin += chance.choice((0.05, 0.4, 1.0, 2.5))
        plant.world.after(begin, plant.start)
        begin += chance.uniform(0.2, 2.0)
    if chance.random() < 0.3:
        plant.world.after(begin, plant.kill)
    await plant.last(6.0)
    await over(plant)


async def broker_fails(plant: Plant) -> None:
    """Part the broker from the gateway, end it, have it double what it delivers and keep what nobody wants."""
    chance = plant.chance
    plant.broker.duplicates = chance.choice((0.0, 0.2, 0.8))
    plant.broker.is_hoarding = chance.random() < 0.3
    plant.network.latency = chance.choice((0.001, 0.01, 0.1))
    _leave_behind(plant)
    plant.start()
    at_work(plant, by_mqtt=True)
    some_die(plant, *AT_WORK)
    for _ in range(chance.choice((1, 1, 2))):
        when, away = chance.uniform(0.5, 5.0), chance.choice((0.1, 0.6, 1.5, 3.0))
        if chance.random() < 0.5:
            is_lost = chance.random() < 0.5
            plant.world.after(when, partial(plant.network.partition, away, is_lost=is_lost))
        else:
            is_forgetful = chance.random() < 0.5
            plant.world.after(when, partial(plant.network.take_down, away, is_forgetful=is_forgetful))
    await plant.last(4.5)
    await over(plant)


def _leave_behind(plant: Plant) -> None:
    """Have the broker keep run commands, from days when there were controllers of the same names, who gave no ids."""
    for place, drive in enumerate(plant.drives):
        order = Order(f"scada-{place}", drive, Verb.RUN, "", plant.hertz())
        ghost = MqttController.payload_of(order)
        plant.broker.publish(Message(f"{ROOT}/{drive}/command", ghost, 1, is_retained=True))


async def two_fight(plant: Plant) -> None:
    """Let two controllers want the same drives, and a third one stop them from time to time."""
    chance = plant.chance
    plant.start()
    for place in range(2):
        controller = plant.tcp(f"10.0.0.{place + 1}") if chance.random() < 0.5 else plant.mqtt(f"scada-{place}")
        for drive in plant.drives:
            controller.play(controller.beat_for(drive))
            controller.play(scripts.operate(controller, drive, plant.hertz))
    some_die(plant, *AT_WORK)
    third = plant.anybody(7)
    for _ in range(3):
        drive, verb = chance.choice(list(plant.drives)), chance.choice((Verb.STOP, Verb.COAST, Verb.EMERGENCY_STOP))
        when = chance.uniform(*AT_WORK)
        plant.world.after(when, third.stop_line if chance.random() < 0.2 else partial(_ask, third, drive, verb))
    await plant.last(4.5)
    await over(plant)


def _ask(controller: Controller, drive: str, verb: Verb) -> None:
    if controller.is_alive:
        controller.order(drive, verb)


async def flood(plant: Plant) -> None:
    """Let one source flood a drive while another one has it, and a third one stop it in the middle of that."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    flooding = plant.mqtt("flood") if chance.random() < 0.6 else plant.tcp("10.0.0.99")
    drive, begin = chance.choice(list(plant.drives)), chance.uniform(0.0, 3.0)

    def pour() -> None:
        flooding.play(scripts.ask_again_and_again(flooding, drive, plant.hertz, 0.006))

    plant.world.after(begin, pour)
    plant.world.after(begin + chance.uniform(0.3, 0.6), flooding.die)
    third = plant.anybody(7)
    plant.world.after(begin + chance.uniform(0.0, 0.8), lambda: _ask(third, drive, Verb.STOP))
    some_die(plant, begin, begin + 2.0)
    await plant.last(begin + 2.0)
    await over(plant)


async def gateway_frozen(plant: Plant) -> None:
    """Let the gateway's process stand still for any time, while its sockets fill and controllers die."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    begin = chance.uniform(0.5, 4.0)
    for _ in range(chance.choice((1, 1, 2))):
        seconds = chance.choice((0.05, 0.35, 0.8, 1.5, 3.0, 5.0))
        stop = chance.choice((plant.freeze, plant.nap))
        plant.world.after(begin, partial(stop, seconds))
        some_die(plant, begin - 0.3, begin + seconds, share=0.4)
        begin += seconds + chance.uniform(0.1, 1.5)
    await plant.last(begin)
    await over(plant)


async def most_drives_dead(plant: Plant) -> None:
    """Let seven of eight drives be dead: the eighth is still stopped in time."""
    chance = plant.chance
    names = list(plant.drives)
    alive = chance.choice(names)
    dead = [name for name in names if name != alive]
    when = chance.choice((0.0, 0.0, chance.uniform(0.0, 6.0)))
    for name in dead:
        plant.world.after(when, partial(plant.fault, Fault(Kind.CUT, plant.drives[name])))
    plant.start()
    controller = plant.anybody()
    controller.play(controller.beat_for(alive))
    controller.play(scripts.operate(controller, alive, plant.hertz))
    third = plant.anybody(7)
    for _ in range(2):
        plant.world.after(chance.uniform(3.0, 5.0), lambda: _ask(third, alive, Verb.STOP))
    some_die(plant, 3.0, 5.0, share=0.5)
    await plant.last(5.0)
    await over(plant)


async def echo(plant: Plant) -> None:
    """Have the adapter hand back what it sends, all the time or by fits, while drives go silent."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK)
    begin = chance.choice((0.0, chance.uniform(1.0, 4.0)))
    plant.world.after(begin, lambda: plant.fault(Fault(Kind.ECHO, probability=chance.choice((1.0, 0.5)))))
    silent = chance.choice(list(plant.drives.values()))
    fault = Fault(chance.choice((Kind.CUT, Kind.DROP)), silent)
    plant.world.after(chance.uniform(*AT_WORK), lambda: plant.fault(fault))
    await plant.last(4.5)
    await over(plant)


async def stranger(plant: Plant) -> None:
    """Have a drive of another model answer to the number of one that was switched off."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK, share=0.3)
    name = chance.choice(list(plant.drives))
    plant.world.after(chance.uniform(*AT_WORK), lambda: plant.swap(name, away=chance.choice((1.0, 2.5))))
    await plant.last(5.0)
    await over(plant)


async def terminated(plant: Plant) -> None:
    """Ask the gateway to end, in any state; `on_exit` says whether the motors are stopped before."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK, share=0.3)
    if chance.random() < 0.3:
        kind = chance.choice((Kind.CUT, Kind.DROP, Kind.FLIP))
        fault = Fault(kind, probability=chance.choice((0.3, 1.0)))
        plant.world.after(chance.uniform(*AT_WORK), lambda: plant.fault(fault))
    plant.world.after(chance.uniform(*AT_WORK), plant.terminate)
    await plant.last(4.5)
    await over(plant)


async def wall_clock_jumps(plant: Plant) -> None:
    """Set the machine's clock: nothing but commands that say when they were issued goes by it."""
    chance = plant.chance
    plant.start()
    at_work(plant, by_mqtt=True)
    some_die(plant, *AT_WORK)
    for _ in range(2):
        jump = chance.choice((-86_400.0, -3.0, -0.5, 0.5, 3.0, 86_400.0))
        plant.world.after(chance.uniform(*AT_WORK), partial(plant.set_clock, jump))
    await plant.last(4.5)
    await over(plant)


async def all_at_once(plant: Plant) -> None:
    """Let anything go wrong at any time, one thing upon the other."""
    plant.start()
    at_work(plant)
    some_die(plant, *AT_WORK, share=0.5)
    for _ in range(4):
        plant.world.after(plant.chance.uniform(0.5, 5.0), lambda: mishap(plant))
    await plant.last(5.0)
    await over(plant)


async def long_day(plant: Plant) -> None:
    """Let it all go on for long, one mishap after another; controllers die and come back."""
    chance = plant.chance
    plant.start()
    at_work(plant)
    end = plant.world.now + LONG_DAY * soak.FACTOR
    while plant.world.now < end:
        await plant.last(chance.uniform(1.0, 15.0))
        if chance.random() < 0.6:
            mishap(plant)
            continue
        place = chance.randrange(len(plant.controllers))
        controller, drive = plant.controllers[place], list(plant.drives)[place]
        if controller.is_alive:
            controller.die()
        else:
            controller.revive()
            controller.play(controller.beat_for(drive))
            controller.play(scripts.operate(controller, drive, plant.hertz))
    await over(plant)


def mishap(plant: Plant) -> None:
    """Let something go wrong."""
    chance = plant.chance
    seconds = chance.choice((0.05, 0.3, 1.0, 2.0))
    name = chance.choice(list(plant.drives))
    fault = Fault(
        chance.choice(NOISE),
        chance.choice((None, plant.drives[name])),
        probability=chance.choice((0.1, 0.5, 1.0)),
        until=plant.world.now + seconds,
    )
    chance.choice(
        (
            lambda: plant.fault(fault),
            lambda: plant.unplug(seconds),
            lambda: plant.power_cycle(name, seconds),
            lambda: plant.trip(name, TripCode.EMERGENCY),
            lambda: plant.restart(seconds),
            lambda: plant.network.partition(seconds, is_lost=chance.random() < 0.5),
            lambda: plant.network.take_down(seconds, is_forgetful=chance.random() < 0.5),
            lambda: plant.freeze(seconds),
            lambda: plant.nap(seconds),
            lambda: plant.set_clock(chance.choice((-100.0, 100.0))),
        )
    )()


def eight(chance: Random) -> Setup:
    """Draw a set-up of eight drives."""
    return drawn(chance).but(drives=8, baud=chance.choice((19200, 38400)), is_as_shipped=False, poll=1.0)


def leaving(chance: Random) -> Setup:
    """Draw a set-up that says what is done when the gateway ends."""
    return drawn(chance).but(on_exit=chance.choice(("stop", "stop", "hold")))


LONG = {"long day": Scenario(drawn, long_day)}
SCENARIOS = {
    "death in every state": Scenario(drawn, death_in_every_state),
    "noise on the line": Scenario(drawn, noise_on_the_line),
    "adapter unplugged": Scenario(drawn, adapter_unplugged),
    "drives fail": Scenario(drawn, drives_fail),
    "gateway killed": Scenario(drawn, gateway_killed),
    "broker fails": Scenario(drawn, broker_fails),
    "two fight": Scenario(drawn, two_fight),
    "flood": Scenario(drawn, flood),
    "gateway frozen": Scenario(drawn, gateway_frozen),
    "most drives dead": Scenario(eight, most_drives_dead),
    "echo": Scenario(drawn, echo),
    "stranger": Scenario(drawn, stranger),
    "terminated": Scenario(leaving, terminated),
    "wall clock jumps": Scenario(drawn, wall_clock_jumps),
    "all at once": Scenario(drawn, all_at_once),
}
