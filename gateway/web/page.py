"""Says how healthy the gateway is, judged by the freshness of its data, and writes the start page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from typing import Any

from gateway import __version__
from gateway.control.ledger import Ledger
from gateway.image import DriveImage, Image, LinkState, Quality
from gateway.metrics import LineStats, Stats
from gateway.site import Site
from gateway.web import certificates

NAMED_VALUES = 5  # a reason names so many values and counts the rest


@dataclass(frozen=True, slots=True)
class LineHealth:
    """One line: whether its port is open, the share of time that it is busy, and why it is not well."""

    name: str
    is_up: bool
    load: float
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DriveHealth:
    """One drive. `age` is seconds since its last answer, None before the first; `quality` is its worst value's."""

    name: str
    line: str
    link: LinkState
    quality: Quality
    age: float | None
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Health:
    """The verdict: well when every line is up and every value of every drive is good, and else why not."""

    lines: tuple[LineHealth, ...]
    drives: tuple[DriveHealth, ...]

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return every reason in words, with the line or drive that it is about."""
        lines = (f"line {line.name}: {reason}" for line in self.lines for reason in line.reasons)
        drives = (f"drive {drive.name}: {reason}" for drive in self.drives for reason in drive.reasons)
        return (*lines, *drives)

    @property
    def is_well(self) -> bool:
        """Say whether there is no reason against it."""
        return not self.reasons


def judge(site: Site, image: Image, stats: Stats, now: float) -> Health:
    """Judge the freshness of all that is configured, at `now` (monotonic seconds)."""
    lines = tuple(_judge_line(line.name, stats.lines.get(line.name) or LineStats()) for line in site.lines)
    return Health(lines, tuple(_judge_drive(drive, now) for drive in image.drives))


def _judge_line(name: str, stats: LineStats) -> LineHealth:
    why = "down" if stats.opened else "not opened yet"
    return LineHealth(name, stats.is_up, stats.load, () if stats.is_up else (why,))


def _judge_drive(image: DriveImage, now: float) -> DriveHealth:
    worst = max((image.quality(name, now) for name in image.names), default=Quality.NEVER_READ)
    return DriveHealth(
        name=image.drive.name,
        line=image.drive.line,
        link=image.link,
        quality=worst,
        age=age(image, now),
        reasons=tuple(_reasons(image, now)),
    )


def age(image: DriveImage, now: float) -> float | None:
    """Return the seconds since a drive's last answer with values, None where there was none."""
    return max(0.0, now - image.changed_at) if image.version else None


def _reasons(image: DriveImage, now: float) -> Iterator[str]:
    if not image.link.is_connected:
        # Why the link is lost explains the quality of every value: one reason, not one for each.
        yield f"{image.link.word}: {image.reason}" if image.reason else image.link.word
        return
    for quality in (Quality.STALE, Quality.OFFLINE, Quality.NEVER_READ):
        names = [name for name in image.names if image.quality(name, now) is quality]
        if names:
            yield f"{len(names)} of {len(image.names)} values {quality.word}: {_listing(image, names, now)}"


def _listing(image: DriveImage, names: list[str], now: float) -> str:
    shown = [_with_age(name, image.sample(name, now).age) for name in names[:NAMED_VALUES]]
    rest = len(names) - len(shown)
    return ", ".join(shown) + (f" and {rest} more" if rest else "")


def _with_age(name: str, seconds: float) -> str:
    return name if seconds == float("inf") else f"{name} ({seconds:.1f} s old)"


def as_document(
    health: Health, site: Site, stats: Stats, now_utc: float, ledger: Ledger | None = None
) -> dict[str, Any]:
    """Return the verdict as the JSON object that /healthz answers with.

    How drives stand to commands, and a problem of the store, are shown and do not count: no value is older for it.
    """
    document: dict[str, Any] = {
        "status": "ok" if health.is_well else "fail",
        "reasons": list(health.reasons),
        "gateway": site.config.gateway.name,
        "version": __version__,
        "time": _utc(now_utc),
        "started": _utc(stats.started),
        "lines": {
            line.name: {"up": line.is_up, "load": round(line.load, 4), "reasons": list(line.reasons)}
            for line in health.lines
        },
        "drives": {
            drive.name: {
                "line": drive.line,
                "link": drive.link.word,
                "age": None if drive.age is None else round(drive.age, 3),
                "quality": drive.quality.word,
                **_standing(stats, drive.name),
                **_answers(stats, drive.name),
                "reasons": list(drive.reasons),
            }
            for drive in health.drives
        },
    }
    if site.config.brokers:
        document["mqtt"] = _brokers(site, stats)
    if site.config.sparkplug is not None:
        document["sparkplug"] = {"connected": stats.sparkplug.is_connected}
    if expiries := certificates.document(stats):
        document["certificates"] = expiries
    if ledger is not None:
        document["store"] = {"problem": ledger.problem, "audit_dropped": ledger.dropped}
    return document


def _brokers(site: Site, stats: Stats) -> dict[str, Any]:
    """Say whether all brokers are connected, and which, where they have names."""
    names = [broker.origin for broker in site.config.brokers]
    connected = {name: name in stats.brokers and stats.brokers[name].is_connected for name in names}
    document: dict[str, Any] = {"connected": all(connected.values())}
    named = {name: {"connected": is_connected} for name, is_connected in connected.items() if name}
    return {**document, "brokers": named} if named else document


def _standing(stats: Stats, drive: str) -> dict[str, str]:
    of = stats.drives.get(drive)
    return {"control": of.standing} if of is not None and of.standing else {}


def _answers(stats: Stats, drive: str) -> dict[str, dict[str, float]]:
    """Return the quantiles of a drive's latest answer times and the longest of all, in seconds."""
    of = stats.drives.get(drive)
    if of is None or not (latest := of.answers.latest()):
        return {}
    times = {f"p{share:.0%}".removesuffix("%"): seconds for share, seconds in latest.items()}
    return {"answer": {name: round(seconds, 5) for name, seconds in {**times, "longest": of.answers.longest}.items()}}


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def start_page(name: str) -> str:
    """Return the page at /: what this is, what it is not, and where to look."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>tosvert-gateway {escape(name)}</title></head>
<body>
<h1>tosvert-gateway {escape(name)}</h1>
<p>Version {escape(__version__)}. Values of TOSVERT drives on RS485, by MQTT and MODBUS-TCP.</p>
<p><strong>This is not a safety function.</strong> Nothing shown or sent here may be relied on to keep people
safe. A machine needs a contactor or another protective device that stops it without this gateway.</p>
<ul>
<li><a href="/healthz">/healthz</a>: whether the data of every drive are fresh, and why not</li>
<li><a href="/metrics">/metrics</a>: counters and times for Prometheus</li>
</ul>
</body>
</html>
"""
