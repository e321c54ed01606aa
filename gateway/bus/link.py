"""The state of the link to a drive: a table of what is heard and what follows."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gateway.image import LinkState

SILENCES_TO_OFFLINE = 3  # in a row; a single lost frame is no lost drive


class Heard(Enum):
    """What an exchange with a drive came to."""

    REPLY = "reply"
    SILENCE = "silence"
    STRANGER = "stranger"
    READY = "ready"
    LINE_LOST = "line lost"


TRANSITIONS: dict[tuple[LinkState, Heard], LinkState] = {
    (LinkState.STARTING, Heard.REPLY): LinkState.STARTING,  # answers, but is not yet known well enough
    (LinkState.STARTING, Heard.SILENCE): LinkState.STARTING,  # counted; offline past the limit
    (LinkState.STARTING, Heard.READY): LinkState.ONLINE,
    (LinkState.ONLINE, Heard.REPLY): LinkState.ONLINE,
    (LinkState.ONLINE, Heard.SILENCE): LinkState.SUSPECT,
    (LinkState.ONLINE, Heard.READY): LinkState.ONLINE,
    (LinkState.SUSPECT, Heard.REPLY): LinkState.ONLINE,
    (LinkState.SUSPECT, Heard.SILENCE): LinkState.SUSPECT,
    (LinkState.SUSPECT, Heard.READY): LinkState.ONLINE,
    (LinkState.OFFLINE, Heard.REPLY): LinkState.STARTING,  # identify and observe before it is believed
    (LinkState.OFFLINE, Heard.SILENCE): LinkState.OFFLINE,
    (LinkState.OFFLINE, Heard.READY): LinkState.ONLINE,
    (LinkState.STRANGER, Heard.REPLY): LinkState.STRANGER,
    (LinkState.STRANGER, Heard.SILENCE): LinkState.STRANGER,  # counted; offline past the limit
    (LinkState.STRANGER, Heard.READY): LinkState.ONLINE,
    (LinkState.LINE_DOWN, Heard.REPLY): LinkState.STARTING,
    (LinkState.LINE_DOWN, Heard.SILENCE): LinkState.OFFLINE,
    (LinkState.LINE_DOWN, Heard.READY): LinkState.ONLINE,
    **{(state, Heard.STRANGER): LinkState.STRANGER for state in LinkState},
    **{(state, Heard.LINE_LOST): LinkState.LINE_DOWN for state in LinkState},
}


@dataclass(slots=True)
class Link:
    """The link to one drive; `silences` counts those in a row."""

    state: LinkState = LinkState.STARTING
    silences: int = 0

    def hear(self, heard: Heard) -> LinkState:
        """Take what was heard and return the state that follows."""
        self.state = TRANSITIONS[self.state, heard]
        self.silences = self.silences + 1 if heard is Heard.SILENCE else 0
        if self.silences >= SILENCES_TO_OFFLINE and self.state is not LinkState.LINE_DOWN:
            self.state = LinkState.OFFLINE
        return self.state
