"""What goes to the broker of two stories, message by message: topic, payload, whether retained, expiry in seconds.

Every rule of publishing has its part in it: order, retained or not, deadbands, intervals, words, derived values, what
is owed and settled, what is taken back. A change of approved_messages.txt is a change for every subscriber.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path

from gateway.config import MqttSection
from gateway.image import LinkState
from gateway.metrics import MqttStats
from gateway.mqtt.outlet import PER_VALUE
from gateway.mqtt.publisher import Publisher
from tests.mqtt import drives

APPROVED = Path(__file__).with_name("approved_messages.txt")
ROOT = "tosvert/hall-3/pump-1/"
DESCRIPTION = "description"  # has tests of its own


@dataclass
class Wire:
    """Writes down what is sent."""

    room: int = 100
    sent: list[str] = field(default_factory=list)

    def send(self, topic: str, text: str, *, retain: bool, expiry: int) -> None:
        """Take a message."""
        self.room -= 1
        name = topic.removeprefix(ROOT)
        if name != DESCRIPTION:
            kept, ends = " retained" if retain else "", f" {expiry}" if expiry else ""
            self.sent.append(f"  {name} = {text or '(nothing)'}{kept}{ends}")


class Story:
    """A drive with every kind of value, what happens to it, and what is sent of that."""

    def __init__(self, title: str, **settings: object) -> None:
        self.image = drives.image()
        self.pump = self.image.drives[0]
        self.wire = Wire()
        self.now = 0.0
        self.told = [title]
        section = MqttSection.model_validate({"url": "mqtt://localhost", **settings})
        self.publisher = Publisher(section, "hall-3", self.image, MqttStats())
        self.image.subscribe(lambda image, names: self.publisher.tell(self.wire, image, names, self.now))

    def read(self, now: float, **words: int) -> None:
        """Read values at a time."""
        self.now = now
        drives.read(self.pump, now, **words)

    def look(self, now: float) -> None:
        """Let time pass, and send what need not wait any longer."""
        self.now = now
        self.publisher.look(now)
        self.settle()

    def sweep(self, now: float) -> None:
        """Let time pass, and tell what has turned stale."""
        self.now = now
        self.image.sweep(now)

    def settle(self) -> None:
        """Send what is owed."""
        while self.publisher.is_owing and self.wire.room >= PER_VALUE:
            self.publisher.settle(self.wire, self.now, 1)

    def tells(self, heading: str) -> None:
        """Write down under a heading what was sent since the last one."""
        sent, self.wire.sent = self.wire.sent, []
        self.told += [f"{self.now:g} s: {heading}", *(sent or ["  (no message)"])]


FILTERS = [
    {"values": ["output_frequency"], "deadband": 0.5},
    {"values": ["torque"], "min_interval": "1s"},
    {"values": ["output_current"], "deadband_percent": 10.0},
    {"values": ["trip_code"], "max_interval": "2s"},
]


def read_every(story: Story, now: float) -> None:
    """Read all values."""
    story.read(
        now, output_frequency=6000, torque=0xFFFB, status=0b11101, trip_code=1, command=0, output_current_rate=5000
    )


def of_values() -> Story:
    """Tell of values, from the first reading to the end of the gateway."""
    story = Story("VALUES", publish=["values"], filter=FILTERS)
    read_every(story, 0.0)
    story.tells("first reading")
    story.publisher.owe_everything()
    story.settle()
    story.tells("connected")
    story.read(0.1, output_frequency=6050, torque=0xFFFC, status=0b00101, command=0)
    story.tells("within the deadband, sooner than its interval, an undefined bit, no change")
    story.read(0.2, output_frequency=5949, torque=0xFFFB, output_current_rate=5500)
    story.tells("beyond the deadband, as it was, a rate, a current beyond its share")
    story.read(0.3, output_current_rate=5501, torque=7, status=0)
    story.tells("a current within its share, sooner than its interval, no bit")
    story.look(1.05)
    story.tells("its interval is over")
    story.read(1.1, trip_code=2)
    story.tells("an unknown code")
    story.sweep(1.35)
    story.tells("what turned stale")
    story.read(3.1, trip_code=2, output_frequency=5949)
    story.tells("silent for as long as it may be, and not yet")
    story.wire.room = 2
    story.read(3.2, output_frequency=1, torque=8, status=2)
    story.tells("no room")
    story.wire.room = 100
    story.settle()
    story.tells("room again")
    of_a_lost_link(story)
    return story


def of_a_lost_link(story: Story) -> None:
    """Tell of what is lost, comes back, trips and ends."""
    story.pump.set_link(LinkState.OFFLINE, "silent")
    story.tells("lost")
    story.read(3.3, torque=9)
    story.tells("an answer of a lost drive")
    story.pump.set_link(LinkState.ONLINE)
    story.tells("back")
    story.pump.bases.clear()
    read_every(story, 3.4)
    story.tells("read, with a base that is not known any more")
    story.pump.set_tripped(True)
    story.tells("tripped")
    story.publisher.leave(story.wire, 3.5)
    story.tells("the gateway goes")


def of_states() -> Story:
    """Tell of states: not retained, at most one in half a second."""
    story = Story("STATES", publish=["state"], retain=False, state_interval="500ms")
    read_every(story, 0.0)
    story.tells("first reading")
    story.publisher.owe_everything()
    story.settle()
    story.tells("connected")
    story.read(0.1, output_frequency=6001)
    story.tells("too soon")
    story.look(0.6)
    story.tells("its interval is over")
    story.read(0.7, torque=1, status=0)
    story.tells("too soon")
    story.pump.bases["rated_current"] = Decimal(25)
    story.read(1.2004, output_current_rate=5000)
    story.tells("another base, late enough")
    story.sweep(1.4)
    story.tells("what turned stale")
    story.pump.set_tripped(True)
    story.settle()
    story.tells("tripped")
    story.pump.set_link(LinkState.LINE_DOWN, "unplugged")
    story.settle()
    story.tells("the line is down")
    story.publisher.leave(story.wire, 3.5)
    story.tells("the gateway goes")
    return story


def test_the_messages_of_two_stories_are_the_approved_ones() -> None:
    """To the byte; print `messages()` into the file where a difference is meant."""
    assert messages() == APPROVED.read_text(encoding="utf-8")


def messages() -> str:
    """Return what both stories send."""
    return "\n".join([*of_values().told, *of_states().told, ""])
