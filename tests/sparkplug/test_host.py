"""Whether the primary host is online: by its newest word, and by nothing older."""

from __future__ import annotations

import random

import pytest

from gateway.mqtt.exact import NotExact
from gateway.sparkplug import host
from gateway.sparkplug.host import PrimaryHost
from tests import soak


def heard(*states: tuple[bool, int]) -> PrimaryHost:
    """Return what is known after these (online, timestamp)."""
    primary = PrimaryHost("scada")
    for is_online, timestamp in states:
        text = f'{{"online": {str(is_online).lower()}, "timestamp": {timestamp}}}'
        primary.hear(host.read(text.encode()))
    return primary


def test_its_topic_is_that_of_the_specification() -> None:
    """The host id as the last level."""
    assert PrimaryHost("scada").topic == "spBv1.0/STATE/scada"


@pytest.mark.parametrize(
    ("states", "is_online"),
    [
        ([], None),
        ([(False, 5)], False),  # the first one counts, whatever its time
        ([(True, 5)], True),
        ([(True, 5), (False, 5)], False),  # the will of this session: the same time
        ([(True, 5), (False, 6)], False),
        ([(True, 5), (False, 4)], True),  # the will of an older session, delivered late
        ([(False, 5), (True, 4)], False),
        ([(False, 5), (True, 5)], True),
    ],
)
def test_an_older_word_counts_for_nothing(states: list[tuple[bool, int]], is_online: bool | None) -> None:
    """Equal or newer does."""
    assert heard(*states).is_online is is_online


def test_after_a_connect_it_must_be_heard_anew_but_not_older() -> None:
    """It may have gone meanwhile; what it said before it still said."""
    primary = heard((True, 5))
    primary.forget()
    assert primary.is_online is None
    assert not primary.hear(host.read(b'{"online": true, "timestamp": 4}'))
    assert primary.is_online is None
    assert primary.hear(host.read(b'{"online": true, "timestamp": 5}'))


WRONG = [b"", b"ONLINE", b"[]", b"{}", b'{"online": true}', b'{"online": 1, "timestamp": 1}', b"\xff",
         b'{"online": "true", "timestamp": 1}', b'{"online": true, "timestamp": "1"}',
         b'{"online": true, "timestamp": NaN}', b'{"online": true, "online": false, "timestamp": 1}',
         b'{"online": true, "timestamp": 1' + b" " * 5000 + b"}"]  # fmt: skip


@pytest.mark.parametrize("payload", WRONG)
def test_what_is_no_state_is_refused(payload: bytes) -> None:
    """A host that cannot be understood is not believed to be online."""
    with pytest.raises(NotExact):
        host.read(payload)


def test_whatever_bytes_come_they_are_a_state_or_refused() -> None:
    """Nothing else comes of them."""
    chance = random.Random(7)
    seed = b'{"online": true, "timestamp": 1772366400250}'
    for _ in range(5000 * soak.FACTOR):
        text = bytearray(seed)
        for _ in range(chance.randrange(1, 4)):
            text[chance.randrange(len(text))] = chance.randrange(256)
        try:
            assert host.read(bytes(text)).is_online in (True, False)
        except NotExact:
            continue
