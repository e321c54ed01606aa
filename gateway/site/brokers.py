"""Finds what is wrong in fact with several brokers: their names, and two of them that are one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from gateway.config import DriveSection
from gateway.config.broker_tables import brokers

Used = Iterator[tuple[str, DriveSection]]  # key and section of each drive that is right in itself


def contradictions(table: Mapping[str, Any], drives: Used) -> Iterator[str]:
    """Yield what is wrong, a line each."""
    found = list(brokers(table))
    names = [broker["name"] for _, broker in found if isinstance(broker.get("name"), str)]
    yield from _names(found)
    yield from _same_place(found)
    edge = table.get("sparkplug")
    if isinstance(edge, dict) and isinstance(edge.get("broker"), str):
        yield from _edge(edge, names)
    for key, drive in drives:
        for i, right in enumerate(drive.right):
            if right.broker != "*" and not any(fnmatchcase(name, right.broker) for name in names):
                yield f"{key}.right[{i}].broker: no broker is called {right.broker!r}; {_known(names)}"


def _names(found: list[tuple[str, Mapping[str, Any]]]) -> Iterator[str]:
    """See that several brokers can be told apart."""
    taken: dict[str, str] = {}
    for key, broker in found if len(found) > 1 else ():
        name = broker.get("name")
        if name is None:
            yield f"{key}.name: is missing: of several brokers each has one, for the log, metrics and rights"
        elif isinstance(name, str) and taken.setdefault(name, key) != key:
            yield f"{key}.name: {name!r} is taken by {taken[name]}"


def _same_place(found: list[tuple[str, Mapping[str, Any]]]) -> Iterator[str]:
    """See that no two of them are one: they would throw each other out, or publish everything twice."""
    taken: dict[tuple[object, object], str] = {}
    for key, broker in found:
        for what, default in (("base", "tosvert"), ("client_id", None)):
            url, value = broker.get("url"), broker.get(what, default)
            if not isinstance(url, str) or not isinstance(value, str):
                continue
            place = (url.rstrip("/"), f"{what} {value}")
            if taken.setdefault(place, key) != key:
                yield f"{key}.{what}: {value!r} is taken by {taken[place]} at the same broker {url}"


def _edge(edge: Mapping[str, Any], names: list[str]) -> Iterator[str]:
    if "url" in edge:
        yield "sparkplug.broker: it has a url of its own: give one of the two"
    elif edge["broker"] not in names:
        yield f"sparkplug.broker: no broker is called {edge['broker']!r}; {_known(names)}"


def _known(names: list[str]) -> str:
    return f"known: {', '.join(names)}" if names else "none has a name"
