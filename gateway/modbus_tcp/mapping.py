"""The registers that MODBUS-TCP shows: each drive's own numbers, and the compact map of the gateway's unit."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

from gateway.image import DriveImage, Image, LinkState, Quality
from gateway.metrics import Stats
from gateway.site import Site

GATEWAY_UNIT = 255
DRIVE_WORDS = 16  # registers a drive in the compact map: seven drives fit one request of 125
COUNTERS = 0xF000  # where the gateway's own counters begin
NO_VALUE = 0x8000  # stands for a value that is not read, stale or offline
MOST = 0xFFFF  # an age of 65535 ms or more

STATE_WORDS = (
    ("link_state", "link: " + ", ".join(f"{state.value} {state.word}" for state in LinkState)),
    ("quality", "worst of the drive's values: " + ", ".join(f"{q.value} {q.word}" for q in Quality)),
    ("age", "age of the last answer in ms; 65535: that or more, or never"),
)
VALUES = (
    "status",
    "output_frequency",
    "output_current",
    "output_voltage",
    "alarm",
    "trip_code",
    "frequency_command_value",
    "input_voltage",
    "torque",
    "output_power",
    "input_terminals",
    "output_terminals",
)
COUNTER_WORDS = (
    ("uptime", 2, "s"),
    ("drives", 1, "configured"),
    ("drives_online", 1, ""),
    ("lines", 1, "configured"),
    ("lines_up", 1, ""),
    ("exchanges", 2, "requests sent on all lines"),
    ("errors", 2, "exchanges without a good answer on all lines"),
    ("mqtt_connected", 1, "1: connected to the broker"),
    ("tcp_connections", 1, "open now"),
    ("tcp_requests", 2, "answered since the start"),
)


def compact(image: DriveImage, now: float) -> bytes:
    """Return the 16 registers of one drive as they stand on a MODBUS wire; they can always be read."""
    samples = {name: image.sample(name, now) for name in image.points}
    worst = max((sample.quality for sample in samples.values()), default=Quality.NEVER_READ)
    age = now - image.changed_at
    words = [image.link, worst, min(MOST, int(age * 1000)) if age < MOST else MOST]
    for name in VALUES:
        sample = samples.get(name)
        words.append(sample.word if sample is not None and sample.quality is Quality.GOOD else NO_VALUE)
    words.append(image.drive.unit)
    return b"".join(word.to_bytes(2, "big") for word in words)


def counters(image: Image, stats: Stats, wall: float) -> bytes:
    """Return the gateway's counters as they stand on a MODBUS wire; two words: the high one first."""
    errors = ("no_reply", "bad_reply")
    values = {
        "uptime": int(wall - stats.started),
        "drives": len(image.drives),
        "drives_online": sum(drive.link is LinkState.ONLINE for drive in image.drives),
        "lines": len(stats.lines),
        "lines_up": sum(line.is_up for line in stats.lines.values()),
        "exchanges": sum(line.exchanges for line in stats.lines.values()),
        "errors": sum(line.errors[kind] for line in stats.lines.values() for kind in errors),
        "mqtt_connected": int(stats.mqtt.is_connected),
        "tcp_connections": stats.tcp.connections,
        "tcp_requests": sum(stats.tcp.requests.values()),
    }
    return b"".join(
        (max(0, values[name]) % (1 << 16 * size)).to_bytes(2 * size, "big") for name, size, _ in COUNTER_WORDS
    )


def gateway_words(start: int, count: int, image: Image, stats: Stats, now: float, wall: float) -> bytes | None:
    """Return `count` registers of unit 255 from `start`; None where some of them do not exist."""
    if start >= COUNTERS:
        words = counters(image, stats, wall)
        end = 2 * (start - COUNTERS + count)
        return words[2 * (start - COUNTERS) : end] if end <= len(words) else None
    first, last = start // DRIVE_WORDS, (start + count - 1) // DRIVE_WORDS
    if last >= len(image.drives):
        return None
    words = b"".join(compact(drive, now) for drive in image.drives[first : last + 1])
    offset = 2 * (start - first * DRIVE_WORDS)
    return words[offset : offset + 2 * count]


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the map. `address` counts from 0, as on the wire; `words` is 1 or 2 (high word first)."""

    unit: int
    drive: str
    address: int
    name: str
    title: str = ""
    unit_of_measure: str = ""
    scale: str = "1"
    signed: bool = False
    words: int = 1
    note: str = ""
    max_age: float | None = None

    @property
    def hexadecimal(self) -> str:
        """Return the address as the drive manual writes it."""
        return f"{self.address:04X}"

    @property
    def one_based(self) -> int:
        """Return the register number of tools that count from 1."""
        return self.address + 1


def register_map(site: Site) -> tuple[Entry, ...]:
    """Return every register that this site's MODBUS-TCP server answers."""
    return (*_drives_own(site), *_compact_map(site), *_counters())


def _drives_own(site: Site) -> Iterator[Entry]:
    for drive in site.drives:
        for point in sorted(drive.points.values(), key=lambda point: point.register.address):
            register = point.register
            note = ", ".join(f"bit {bit}: {name}" for bit, name in register.bits.items())
            if register.enumeration is not None:
                texts = register.enumeration.texts.items()
                note = ", ".join(f"{code}: {text}" for code, text in texts)
            yield Entry(
                drive.unit, drive.name, register.address, register.name, register.title, register.unit,
                str(register.scaling.scale), register.scaling.signed, 1, note, point.max_age,
            )  # fmt: skip


def _compact_map(site: Site) -> Iterator[Entry]:
    for index, drive in enumerate(site.drives):
        base = index * DRIVE_WORDS
        for offset, (name, note) in enumerate(STATE_WORDS):
            yield Entry(GATEWAY_UNIT, drive.name, base + offset, name, note=note)
        for offset, name in enumerate(VALUES, len(STATE_WORDS)):
            point = drive.points.get(name)
            if point is None:
                yield Entry(GATEWAY_UNIT, drive.name, base + offset, name, note="not read: always 8000H")
                continue
            register = point.register
            yield Entry(
                GATEWAY_UNIT, drive.name, base + offset, name, register.title, register.unit,
                str(register.scaling.scale), register.scaling.signed, note="8000H: no good value",
            )  # fmt: skip
        yield Entry(GATEWAY_UNIT, drive.name, base + DRIVE_WORDS - 1, "unit", note="unit id of this drive")


def _counters() -> Iterator[Entry]:
    address = COUNTERS
    for name, size, note in COUNTER_WORDS:
        yield Entry(GATEWAY_UNIT, "", address, name, words=size, note=note)
        address += size


COLUMNS = (
    "unit", "drive", "address", "hex", "1-based", "words", "name", "unit of measure", "scale", "signed", "note",
)  # fmt: skip


def _row(entry: Entry) -> tuple[str, ...]:
    signed = "yes" if entry.signed else "no"
    return (
        str(entry.unit), entry.drive, str(entry.address), entry.hexadecimal, str(entry.one_based), str(entry.words),
        entry.name, entry.unit_of_measure, entry.scale, signed, entry.note or entry.title,
    )  # fmt: skip


def as_markdown(entries: Sequence[Entry]) -> str:
    """Return the map as a Markdown table; long notes are cut."""
    rows = [COLUMNS, tuple("---" for _ in COLUMNS)]
    rows += [(*row[:-1], row[-1] if len(row[-1]) <= 120 else row[-1][:117] + "...") for row in map(_row, entries)]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)


def as_csv(entries: Sequence[Entry]) -> str:
    """Return the map as CSV (RFC 4180), with a heading."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(COLUMNS)
    writer.writerows(map(_row, entries))
    return text.getvalue()


def as_json(entries: Sequence[Entry]) -> str:
    """Return the map as a JSON list."""
    return json.dumps([{**asdict(entry), "hex": entry.hexadecimal} for entry in entries], indent=1)
