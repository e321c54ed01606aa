"""Reads from the table of a configuration which brokers there are, before its form is checked. Pure.

`[mqtt]` is one broker; `[[mqtt]]` is one of several.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

TAKEN_OVER = (  # what Sparkplug takes of a broker that it shares; the rest of a connection is its own
    "url",
    "version",
    "user",
    "password",
    "tls",
    "keep_alive",
    "queue",
    "reconnect_after",
    "reconnect_at_most",
)


def brokers(table: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield key and table of each broker, whatever else is wrong with them."""
    found = table.get("mqtt")
    if isinstance(found, dict):
        yield "mqtt", found
    for i, each in enumerate(found if isinstance(found, list) else []):
        if isinstance(each, dict):
            name = each.get("name")
            yield f"mqtt[{i}]{f' ({name})' if isinstance(name, str) else ''}", each


def shared(table: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the table with Sparkplug's connection filled in: as the broker has it that it names, or the first.

    What Sparkplug says itself stays; where it has a `url`, all of its connection is its own.
    """
    edge = table.get("sparkplug")
    if not isinstance(edge, dict) or "url" in edge:
        return table
    named = edge.get("broker")
    for _, broker in brokers(table):
        if named is None or broker.get("name") == named:
            taken = {key: broker[key] for key in TAKEN_OVER if key in broker}
            return {**table, "sparkplug": {**taken, **edge}}
    return table
