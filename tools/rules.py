"""Reads tests/rules: one file for each hazard, with its rule, where the rule is kept, and how to take it away."""

from __future__ import annotations

import ast
import hashlib
import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.locks import ROOT

RULES = ROOT / "tests" / "rules"
PROOFS = RULES / "proofs.json"
HAZARDS = tuple(f"H{number:02d}" for number in range(1, 38))


class WrongRule(Exception):
    """A file of rules that cannot be used; the message says which, and what is wrong."""


@dataclass(frozen=True, slots=True)
class Removal:
    """A small change of one file that takes a rule away; `takes` says in words what is gone then.

    `e2e`: only tests with other programs can see that.
    """

    hazard: str
    takes: str
    file: str
    old: str
    new: str
    e2e: bool = False

    @property
    def digest(self) -> str:
        """Return what names it: another text is another removal, and to be proved anew."""
        return hashlib.sha256("\0".join((self.file, self.old, self.new)).encode()).hexdigest()[:16]

    def applied(self, source: str) -> str:
        """Return the file without the rule; WrongRule where its old text does not stand there exactly once."""
        if (count := source.count(self.old)) != 1:
            text = f"the old text stands {count} times in {self.file}, not once"
            raise WrongRule(f"{self.hazard}, {self.takes}: {text}")
        changed = source.replace(self.old, self.new)
        if self.file.endswith(".py"):
            try:
                ast.parse(changed)
            except SyntaxError as error:
                raise WrongRule(f"{self.hazard}, {self.takes}: what is left of {self.file} is no Python") from error
        return changed


@dataclass(frozen=True, slots=True)
class Rule:
    """One hazard, the rule against it, the files that keep it, and its removals."""

    id: str
    hazard: str
    rule: str
    where: tuple[str, ...]
    removals: tuple[Removal, ...]


@dataclass(frozen=True, slots=True)
class Proof:
    """The tests that failed when a removal was applied: functions, as pytest calls them."""

    removal: str
    failed: tuple[str, ...]


def load(folder: Path = RULES) -> tuple[Rule, ...]:
    """Return the rules of all hazards, in order; WrongRule says what is missing or unknown."""
    files = {path.stem: path for path in sorted(folder.glob("*.toml"))}
    if wrong := set(files) ^ set(HAZARDS):
        raise WrongRule(f"{folder}: one file for each of {HAZARDS[0]} to {HAZARDS[-1]}: {', '.join(sorted(wrong))}")
    return tuple(_rule(name, tomllib.loads(path.read_text(encoding="utf-8"))) for name, path in files.items())


def _rule(name: str, table: Mapping[str, Any]) -> Rule:
    try:
        removals = tuple(Removal(hazard=name, **removal) for removal in table.get("removal", []))
        rule = Rule(name, table["hazard"], table["rule"], tuple(table["where"]), removals)
    except (KeyError, TypeError) as error:
        raise WrongRule(f"{name}.toml: {error}") from error
    if unknown := set(table) - {"hazard", "rule", "where", "removal"}:
        raise WrongRule(f"{name}.toml: unknown key {sorted(unknown)[0]}")
    return rule


def removals(rules: tuple[Rule, ...]) -> Iterator[Removal]:
    """Yield the removals of all rules."""
    for rule in rules:
        yield from rule.removals


def read_proofs(path: Path = PROOFS) -> dict[str, Proof]:
    """Return what was proved, by the digest of the removal."""
    if not path.exists():
        return {}
    table = json.loads(path.read_text(encoding="utf-8"))
    return {digest: Proof(digest, tuple(failed)) for digest, failed in table.items()}


def write_proofs(proofs: Mapping[str, Proof], rules: tuple[Rule, ...], path: Path = PROOFS) -> None:
    """Keep what was proved of removals that still exist, in their order."""
    kept = {r.digest: sorted(proofs[r.digest].failed) for r in removals(rules) if r.digest in proofs}
    path.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
