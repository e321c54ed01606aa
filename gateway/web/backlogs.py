"""Puts what is kept for brokers while they are away into metric families."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from gateway.backlog import BacklogStats, Loss

Labels = tuple[str, ...]

COUNTED: tuple[tuple[str, str, Callable[[BacklogStats], float]], ...] = (
    ("kept_total", "Readings that were stored since the broker missed them.", lambda stats: stats.stored),
    ("sent_total", "Stored readings that the broker has got.", lambda stats: stats.sent),
    ("waiting", "Stored readings that wait for the broker.", lambda stats: stats.waiting),
    ("problem", "Whether what the broker misses cannot be stored.", lambda stats: stats.has_problem),
)


def families(prefix: str, labels: Labels, each: Iterable[tuple[Labels, BacklogStats]]) -> Iterator[Metric]:
    """Yield the families of the backlogs of some brokers; their names begin with `prefix`."""
    backlogs = list(each)
    for name, text, read in COUNTED:
        kind = CounterMetricFamily if name.endswith("_total") else GaugeMetricFamily
        family = kind(f"{prefix}_backlog_{name}", text, labels=labels)
        for of, stats in backlogs:
            family.add_metric(of, read(stats))
        yield family
    text = "Readings that were dropped before the broker got them, by reason."
    dropped = CounterMetricFamily(f"{prefix}_backlog_dropped_total", text, labels=(*labels, "reason"))
    for of, stats in backlogs:
        for loss in Loss:
            dropped.add_metric((*of, loss.value), stats.dropped[loss])
    yield dropped
