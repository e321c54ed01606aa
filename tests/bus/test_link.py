"""The table of the link to a drive."""

from __future__ import annotations

import pytest

from gateway.bus.link import SILENCES_TO_OFFLINE, TRANSITIONS, Heard, Link
from gateway.image import LinkState


def test_the_table_is_complete() -> None:
    """Whatever is heard in whatever state, something follows."""
    assert set(TRANSITIONS) == {(state, heard) for state in LinkState for heard in Heard}


@pytest.mark.parametrize("state", list(LinkState))
def test_a_lost_line_is_seen_from_every_state(state: LinkState) -> None:
    """Nothing keeps a drive online without its line."""
    assert Link(state).hear(Heard.LINE_LOST) is LinkState.LINE_DOWN


def test_one_lost_frame_is_no_lost_drive() -> None:
    """Online, one silence, an answer: online."""
    link = Link(LinkState.ONLINE)
    assert link.hear(Heard.SILENCE) is LinkState.SUSPECT
    assert link.hear(Heard.REPLY) is LinkState.ONLINE
    assert link.silences == 0


@pytest.mark.parametrize("state", [LinkState.STARTING, LinkState.ONLINE, LinkState.SUSPECT, LinkState.STRANGER])
def test_silences_in_a_row_end_offline(state: LinkState) -> None:
    """The last of them, not before."""
    link = Link(state)
    states = [link.hear(Heard.SILENCE) for _ in range(SILENCES_TO_OFFLINE)]
    assert states[-1] is LinkState.OFFLINE
    assert LinkState.OFFLINE not in states[:-1]


def test_a_returning_drive_is_identified_before_it_is_believed() -> None:
    """Offline, an answer: starting; ready: online."""
    link = Link(LinkState.OFFLINE)
    assert link.hear(Heard.REPLY) is LinkState.STARTING
    assert not link.state.is_connected
    assert link.hear(Heard.READY) is LinkState.ONLINE


@pytest.mark.hazard("H07")
@pytest.mark.parametrize("state", list(LinkState))
def test_a_stranger_is_not_believed(state: LinkState) -> None:
    """Another drive under the number: no value counts, whatever it goes on answering."""
    link = Link(state)
    assert link.hear(Heard.STRANGER) is LinkState.STRANGER
    assert link.hear(Heard.REPLY) is LinkState.STRANGER
    assert not link.state.is_connected
