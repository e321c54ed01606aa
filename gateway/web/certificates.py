"""Shows when certificates expire: as metrics, and in the document of /healthz."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from datetime import UTC, datetime

from prometheus_client.core import GaugeMetricFamily, Metric

from gateway.metrics import Stats

Labels = tuple[str, ...]


def family(prefix: str, whose: str, labels: Labels, each: Iterable[tuple[Labels, Mapping[str, float]]]) -> Metric:
    """Return the expiries of some certificates, by what each is; the name begins with `prefix`."""
    text = f"When a certificate of {whose} expires, in UTC seconds; of authorities the first one."
    made = GaugeMetricFamily(f"{prefix}_certificate_expires_seconds", text, labels=(*labels, "certificate"))
    for of, certificates in each:
        for what, expires in sorted(certificates.items()):
            made.add_metric((*of, what), expires)
    return made


def document(stats: Stats) -> dict[str, dict[str, str]]:
    """Return for /healthz when certificates expire, by whose and what they are; empty where there are none."""
    brokers = {f"mqtt/{name}" if name else "mqtt": broker.certificates for name, broker in stats.brokers.items()}
    each = {"modbus_tcp": stats.tcp.certificates, **brokers, "sparkplug": stats.sparkplug.certificates}
    held = {whose: found for whose, found in each.items() if found}
    return {whose: {what: _utc(when) for what, when in sorted(found.items())} for whose, found in held.items()}


def _utc(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
