"""What the lines tell goes where it is wanted; what goes wrong there ends nothing."""

from __future__ import annotations

import asyncio
import logging
import re
from pathlib import Path

import pytest

from gateway import logs
from gateway.errors import GatewayError
from gateway.image import Image, LinkState
from gateway.trace import files, place
from gateway.trace.faults import FOLLOWING
from gateway.trace.files import Recording, name_of, prune
from gateway.trace.meaning import Meaning
from gateway.trace.tracing import Tracing
from tests.trace.plays import ANSWER, READ, answered
from tests.trace.rig import NOWHERE, SetClock, configured
from tests.trace.test_pcapng import blocks, options

PACKET = 6


def tracing(folder: Path, clock: SetClock | None = None, **trace: object) -> Tracing:
    """Return a trace of the site, without a socket."""
    return Tracing(configured(folder, serve=False, **trace), clock or SetClock(), environment=NOWHERE)


def packets(path: Path) -> list[bytes]:
    """Return the packets of a capture."""
    return [body for kind, body in blocks(path.read_bytes()) if kind == PACKET]


def comment(path: Path) -> str:
    """Return what a capture says of itself."""
    _, body = next(iter(blocks(path.read_bytes())))
    return options(body[16:])[1].decode()


def test_where_nobody_wants_to_know_there_is_no_tap(tmp_path: Path) -> None:
    """The line then asks nobody."""
    assert tracing(tmp_path, frames=0).tap("a") is None
    assert tracing(tmp_path, frames=2).tap("a") is not None


def test_a_part_that_fails_is_left_out_and_the_line_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Said once; the other parts go on too."""
    made = tracing(tmp_path)

    def broken(line: str, told: object) -> None:
        raise ValueError(line)

    made._consumers.insert(0, broken)
    tap = made.tap("a")
    assert tap is not None
    tap(answered())
    tap(answered())
    assert len(made.ring.all()) == 2
    assert caplog.text.count("is left out from now on") == 1


async def test_a_lost_drive_writes_the_ring(tmp_path: Path) -> None:
    """What was before it and what followed, under the name of the gateway, with the reason."""
    clock, site = SetClock(), configured(tmp_path)
    made, image = tracing(tmp_path, clock), Image(site.drives)
    made.watch(image)
    tap = made.tap("a")
    assert tap is not None
    image.drives[0].set_link(LinkState.ONLINE)
    tap(answered(clock.time))
    image.drives[0].set_link(LinkState.OFFLINE, "no answer")
    tap(answered(clock.time + 1))
    await made._write_due(clock.time + FOLLOWING)
    (path,) = (tmp_path / "traces").iterdir()
    assert re.fullmatch(r"hall-3-20260301T\d{6}\.\d{3}Z\.pcapng", path.name)
    assert comment(path) == "pump-1: offline"
    assert len(packets(path)) == 4
    assert all(any(frame in packet for packet in packets(path)) for frame in (READ, ANSWER))


@pytest.mark.parametrize(("event", "is_fault"), [("lease_lost", True), ("quiesced", True), ("armed", False)])
async def test_the_loss_of_a_controller_writes_the_ring(tmp_path: Path, event: str, is_fault: bool) -> None:
    """What the door says of it; and what is due is written when the gateway ends."""
    made = tracing(tmp_path)
    made.on_event("pump-1", event, "heartbeat missing")
    await made.stop()
    found = list((tmp_path / "traces").glob("*"))
    assert bool(found) is is_fault
    if found:
        assert comment(found[0]) == f"pump-1: {event.replace('_', ' ')}: heartbeat missing"


async def test_without_on_fault_only_a_signal_writes(tmp_path: Path) -> None:
    """SIGUSR1 writes at any time."""
    made = tracing(tmp_path, on_fault=False)
    made.on_event("pump-1", "lease_lost", "")
    await made.stop()
    assert not (tmp_path / "traces").exists()
    made.write_now()
    await made.stop()
    (path,) = (tmp_path / "traces").iterdir()
    assert comment(path) == "asked for by SIGUSR1"


async def test_a_folder_that_cannot_be_written_is_only_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The gateway goes on."""
    (tmp_path / "traces").write_text("a file")
    made = tracing(tmp_path)
    made.write_now()
    await made.stop()
    assert "cannot be written: File exists (asked for by SIGUSR1)" in caplog.text


def test_the_oldest_files_go_and_none_of_others(tmp_path: Path) -> None:
    """Of this gateway only, and only its captures."""
    own = [tmp_path / name_of("hall", 1_772_357_400.0 + second) for second in range(5)]
    others = [tmp_path / name_of("hall-3", 0.0), tmp_path / "hall-notes.pcapng", tmp_path / "hall-1.txt"]
    for path in (*own, *others):
        path.touch()
    prune(tmp_path, "hall", 2)
    assert sorted(tmp_path.iterdir()) == sorted([*own[3:], *others])


# ---- recording


def test_a_recording_has_everything_and_can_be_continued(tmp_path: Path) -> None:
    """After a reload a new section follows, with its own lines."""
    path = tmp_path / "all.pcapng"
    for is_continued in (False, True):
        recording = Recording(path, {"a": Meaning()}, SetClock(), is_continued=is_continued)
        for second in range(3):
            recording.take("a", answered(float(second)))
        recording.close()
    assert [kind for kind, _ in blocks(path.read_bytes())] == [0x0A0D0D0A, 1, *[PACKET] * 6] * 2


def test_a_recording_that_cannot_begin_says_why(tmp_path: Path) -> None:
    """Before anything runs."""
    with pytest.raises(GatewayError, match=r"--trace .*none/all\.pcapng: No such file or directory"):
        Recording(tmp_path / "none" / "all.pcapng", {"a": Meaning()}, SetClock(), is_continued=False)


def test_a_recording_ends_where_it_would_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """And says so; who tells does not notice."""
    monkeypatch.setattr(files, "LARGEST", 0)
    recording = Recording(tmp_path / "all.pcapng", {"a": Meaning()}, SetClock(), is_continued=False)
    recording.take("a", answered())
    recording.close()
    recording.take("a", answered())
    assert "the capture of --trace ends here: it has 0 MiB" in caplog.text


def test_what_waits_for_a_slow_disk_is_bounded_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A capture with holes says so."""
    monkeypatch.setattr(files, "QUEUE", 10)
    monkeypatch.setattr(files, "EVERY", 3600.0)
    recording = Recording(tmp_path / "all.pcapng", {"a": Meaning()}, SetClock(), is_continued=False)
    for second in range(15):
        recording.take("a", answered(float(second)))
    recording.close()
    assert len(packets(tmp_path / "all.pcapng")) == 20
    assert "5 exchanges are missing" in caplog.text


# ---- log channels


@pytest.mark.parametrize(
    ("channel", "lines"),
    [
        (
            logs.FRAMES,
            [
                "a -> pump-1 read FD00 output_frequency, gap 2.50 ms: answered",
                "a <- pump-1 output_frequency 60.00 Hz, 15.00 ms after the request",
            ],
        ),
        (logs.BYTES, ["a tx 01 03 FD 00 00 01 B5 A6", "a rx 01 03 02 17 70 B6 50 at 20.00 ms"]),
        (logs.POINTS, ["pump-1 output_frequency = 60.00 Hz (good)", "pump-1 output_current = 0.00 % (good)"]),
    ],
)
def test_each_channel_says_what_it_is_for(
    tmp_path: Path, channel: str, lines: list[str], caplog: pytest.LogCaptureFixture
) -> None:
    """Frames in words, bytes as they came, values as they are decoded; one alone, at any level."""
    with caplog.at_level(logging.DEBUG, channel):
        site = configured(tmp_path)
        made, image = tracing(tmp_path), Image(site.drives)
        made.watch(image)
        tap = made.tap("a")
        assert tap is not None
        tap(answered())
        image.drives[0].set_link(LinkState.ONLINE)
        image.drives[0].apply([(0xFD00, 6000), (0xFD03, 0)], 1000.0, 0.0)
    assert [record.getMessage() for record in caplog.records if record.name in logs.CHANNELS] == lines


def test_a_channel_that_is_off_is_asked_nothing(tmp_path: Path) -> None:
    """Neither per frame nor per value: only the ring and the search for bursts are told."""
    made, image = tracing(tmp_path), Image(configured(tmp_path).drives)
    made.watch(image)
    assert len(made._consumers) == 2
    assert len(image.drives[0]._listeners) == 1


def test_every_channel_can_be_named_in_the_configuration() -> None:
    """gateway.log.show has all three."""
    assert set(logs.SHOWN.values()) == set(logs.CHANNELS)


# ---- places


def test_socket_and_files_are_in_the_service_s_folders_or_beside_the_file(tmp_path: Path) -> None:
    """As configured before all; what systemd names before what is beside the file."""
    site = configured(tmp_path)
    service = {"RUNTIME_DIRECTORY": "/run/x:/run/y", "STATE_DIRECTORY": "/var/lib/x"}
    assert place.socket_path(site, NOWHERE) == tmp_path / "trace-hall-3.sock"
    assert place.socket_path(site, service) == Path("/run/x/trace-hall-3.sock")
    assert place.directory(site, NOWHERE) == tmp_path / "traces"
    assert place.directory(site, service) == Path("/var/lib/x/traces")
    site = configured(tmp_path, socket="s", directory="/d")
    assert place.socket_path(site, service) == tmp_path / "s"
    assert place.directory(site, service) == Path("/d")
    assert list(place.sockets_to_try(site, NOWHERE)) == [tmp_path / "s"]
    assert Path("/run/tosvert-gateway/trace-hall-3.sock") in place.sockets_to_try(configured(tmp_path), NOWHERE)


async def test_a_file_is_written_when_it_is_due_while_the_gateway_runs(tmp_path: Path) -> None:
    """Without anybody asking."""
    clock = SetClock()
    made = tracing(tmp_path, clock)
    made.on_event("pump-1", "lease_lost", "gone")
    clock.time += FOLLOWING
    running = asyncio.create_task(made.run())
    while not list(tmp_path.glob("traces/*.pcapng")):
        await asyncio.sleep(0.01)
    running.cancel()
    await asyncio.gather(running, return_exceptions=True)
