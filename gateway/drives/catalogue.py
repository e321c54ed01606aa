"""The catalogue: drive models read from TOML files, the built-in ones and the user's own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType

from gateway.drives.building import build
from gateway.drives.catalogue_file import parse
from gateway.drives.model import Model
from gateway.errors import BadConfig

Catalogue = Mapping[str, Model]


def load(extra: Iterable[Path] = ()) -> Catalogue:
    """Read the built-in models and then the user's files, in order; BadConfig says file, key and reason."""
    models = dict(built_in())
    for path in extra:
        _add(models, str(path), _read(path))
    return models


@cache
def built_in() -> Catalogue:
    """Read the built-in models, once for a process: models never change, and to build them takes a while."""
    models: dict[str, Model] = {}
    for name, text in _files():
        _add(models, name, text)
    return MappingProxyType(models)


def _files() -> Iterator[tuple[str, str]]:
    folder = resources.files("gateway.drives") / "data"
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.name.endswith(".toml"):
            yield entry.name, entry.read_text(encoding="utf-8")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadConfig(f"{path}: cannot be read: {error}") from error


def _add(models: dict[str, Model], name: str, text: str) -> None:
    """Build the model of one file and take it, whole or not at all."""
    model, wrong = build(parse(name, text), models)
    if wrong or model is None:
        raise BadConfig("\n".join(f"{name}: {problem}" for problem in wrong))
    models[model.name] = model
