"""Finds what is right in form and wrong in fact: models, values, and what must be there once only. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway.config import valid_parts
from gateway.drives.catalogue import Catalogue
from gateway.site import brokers, drives, lines, mapping, publishing
from gateway.site.once import Once


def contradictions(table: Mapping[str, Any], models: Catalogue) -> list[str]:
    """List what is wrong, a line each; parts whose form is wrong are passed over, for they are listed already."""
    once: Once = {}
    wrong = list(lines.contradictions(table, once))
    valid = [(f"{key} ({drive.name})", line, drive) for key, line, drive in valid_parts(table)]
    for label, line, drive in valid:
        wrong += drives.contradictions(label, line, drive, models, once)
    used = [(label, drive, models[drive.model]) for label, _, drive in valid if drive.model in models]
    wrong += brokers.contradictions(table, ((label, drive) for label, _, drive in valid))
    return [*wrong, *publishing.contradictions(table, used), *mapping.contradictions(table, used)]
