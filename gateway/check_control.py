"""What `check` says of the drives that may be commanded: by whom, what stops them, and what does not."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.bus import arming
from gateway.bus.refresh import WorstCase, refreshes, worst_case
from gateway.config import DriveSection, FallbackSection
from gateway.control.settings import TIMEOUT_ACTIONS, TIMEOUT_DETECTIONS
from gateway.site import Drive, Line

OWN = "the drive's own"  # what is not configured is left as it is set in the drive
GOES_ON = {
    "hold": "the motor runs on when its controller is lost, until somebody stops it",
    "on_exit": "the motor runs on when the gateway ends, until its F803 acts",
    "direct": "there is no lease, so a controller that dies is not noticed: polling keeps F803 satisfied,"
    " and the motor runs on until somebody stops it",
    "unwatched": "run commands are taken though F803 or F804 may not stop the motor: a broken wire, or the end of the"
    " gateway, may leave it running for ever",
    "alarm": "the drive only shows an alarm when nobody talks to it: run commands are refused (no_watchdog)",
}


def line(of: Line) -> Iterator[str]:
    """Yield how the time-outs of a line are kept; nothing where no drive is commanded."""
    if not any(drive.is_controlled for drive in of.drives):
        return
    yield f"  communication time-outs: F803 from {worst_case(of).least_timeout} s on can be kept on this line"
    for refresh in refreshes(of):
        yield f"    {refresh.drive}: {refresh}"


def drive(of: Drive, on: Line, worst: WorstCase) -> Iterator[str]:
    """Yield how a drive may be commanded, and in words what is dangerous about that."""
    section = of.section
    if section is None or not of.is_controlled:
        return
    lease = f"lease {section.lease:g} s, then {_loss(section)}; " if section.control == "leased" else "no lease; "
    sources = ", ".join(section.sources)
    yield f"    control {section.control} by {sources}: {lease}when the gateway ends: {section.on_exit}"
    yield f"    {_timeouts(section)}"
    if section.right:
        yield f"    rights: {len(section.right)}, all else is refused"
    if section.communication_timeout is None:
        zero = "" if section.unwatched else " where it is 0 in the drive, run commands are refused;"
        yield f"    F803 is not configured:{zero} below {worst.least_timeout} s it cannot be kept"
    for warning in _warnings(section):
        yield f"    WARNING: {warning}"
    if hasty := arming.objection(on, of):
        yield f"    WARNING: command_timeout {hasty}"


def _loss(section: DriveSection) -> str:
    loss = section.on_loss
    return f"on at {loss.frequency:g} Hz" if isinstance(loss, FallbackSection) else loss


def _timeouts(section: DriveSection) -> str:
    """Say what F803, F804 and F808 are to be, as the drive's panel shows them."""
    timeout, action, detection = section.communication_timeout, section.timeout_action, section.timeout_detection
    return ", ".join(
        (
            f"F803 = {OWN if timeout is None else f'{timeout:.1f} s'}",
            f"F804 = {OWN if action is None else f'{TIMEOUT_ACTIONS[action]} ({action})'}",
            f"F808 = {OWN if detection is None else f'{TIMEOUT_DETECTIONS[detection]} ({detection})'}",
        )
    )


def _warnings(section: DriveSection) -> Iterator[str]:
    is_leased, loss = section.control == "leased", section.on_loss
    if not is_leased:
        yield f'control = "direct": {GOES_ON["direct"]}'
    if is_leased and loss == "hold":
        yield f'on_loss = "hold": {GOES_ON["hold"]}'
    if is_leased and isinstance(loss, FallbackSection):
        yield f"on_loss = {{ frequency = {loss.frequency:g} }}: {GOES_ON['hold']}"
    if section.on_exit == "hold":
        yield f'on_exit = "hold": {GOES_ON["on_exit"]}'
    if section.unwatched:
        yield f"unwatched = true: {GOES_ON['unwatched']}"
    elif section.timeout_action == "alarm":
        yield f'timeout_action = "alarm": {GOES_ON["alarm"]}'
