"""Proves that the tests of a hazard can fail: takes its rule away in a copy of the project, and runs them there.

`python -m tools.prove [--stale] [H05 ...]`: all hazards, those named, or only removals that were never proved as they
are now. What failed is kept in tests/rules/proofs.json, from which docs/hazards.md is written.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tools import marks, rules
from tools.locks import ROOT
from tools.marks import MarkedTest
from tools.rules import Proof, Removal, WrongRule

LEFT_OUT = (".git", ".venv", "*_cache", "__pycache__", ".hypothesis", "build", "dist", "htmlcov", ".coverage*")
LIMIT = 150.0  # seconds for the tests of one hazard
FIXED = {"CI": "1", "TOSVERT_PROVE": "1", "PYTHONDONTWRITEBYTECODE": "1"}  # the same inputs every time
PASSED, FAILED = 0, 1  # exit codes of pytest
BY_ACCIDENT = re.compile(r"^(NameError|UnboundLocalError|ImportError|ModuleNotFoundError|SyntaxError)\b")


@dataclass(frozen=True, slots=True)
class Report:
    """How a run of pytest ended: its exit code, the failed functions by class and name, and what it printed."""

    code: int
    failed: frozenset[tuple[str, str]]
    text: str


def read_report(xml: str) -> frozenset[tuple[str, str]]:
    """Return what failed by what it asserts, from pytest's report; a name that is missing is no proof of anything."""
    found = set()
    for case in ET.fromstring(xml).iter("testcase"):  # noqa: S314  (pytest's own words)
        failure = case.find("failure")
        if failure is not None and not BY_ACCIDENT.match(failure.get("message", "")):
            found.add((case.get("classname", ""), case.get("name", "").partition("[")[0]))
    return frozenset(found)


class Copy:
    """A copy of the project in a temporary folder, for as long as the `with` block lasts."""

    def __enter__(self) -> Copy:
        self._folder = tempfile.TemporaryDirectory(prefix="tosvert-prove-")
        self.root = Path(self._folder.name) / "project"
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(*LEFT_OUT))
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.cleanup()

    def run(self, tests: Iterable[MarkedTest]) -> Report:
        """Run tests in the copy: the same inputs every time, and the modules of the copy."""
        report = self.root / "report.xml"
        report.unlink(missing_ok=True)
        nodes = sorted(test.node for test in tests)
        try:
            done = subprocess.run(  # noqa: S603  (this interpreter, on tests of our own)
                [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}", *nodes],
                cwd=self.root,
                env=os.environ | FIXED | {"PYTHONPATH": str(self.root)},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=LIMIT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Report(-1, frozenset(), f"not done within {LIMIT:g} s")
        failed = read_report(report.read_text(encoding="utf-8")) if report.exists() else frozenset()
        return Report(done.returncode, failed, done.stdout)

    def without(self, removal: Removal, tests: Sequence[MarkedTest]) -> Report:
        """Take a rule away, run tests, and put it back."""
        path = self.root / removal.file
        source = path.read_text(encoding="utf-8")
        path.write_text(removal.applied(source), encoding="utf-8")
        try:
            return self.run(tests)
        finally:
            path.write_text(source, encoding="utf-8")


def tests_of(removal: Removal, found: Iterable[MarkedTest]) -> list[MarkedTest]:
    """Return the gateway's own tests of a rule that are to fail without it: quick ones, or those with programs."""
    own = [test for test in found if removal.hazard in test.hazards and not test.is_of_the_judge]
    return [test for test in own if test.is_e2e is removal.e2e and not test.is_long]


def judged(removal: Removal, report: Report, tests: Iterable[MarkedTest]) -> Proof | str:
    """Return what a run without the rule proves, or why it proves nothing."""
    failed = tuple(test.node for test in tests if test.place in report.failed)
    if report.code == FAILED and failed:
        return Proof(removal.digest, failed)
    why = {PASSED: "every test passes without it", FAILED: "nothing fails by what it asserts"}
    return why.get(report.code, f"pytest ends with {report.code}: {report.text.strip()[-2000:]}")


class Prover:
    """Proves removals in one copy; tests that have passed as it is are not run so again."""

    def __init__(self, copy: Copy, found: Sequence[MarkedTest]) -> None:
        self._copy = copy
        self._found = found
        self._as_it_is: dict[tuple[MarkedTest, ...], Report] = {}

    def prove(self, removal: Removal) -> Proof | str:
        """Return what a removal proves: its tests pass as it is, and one of them at least fails without the rule."""
        tests = tuple(tests_of(removal, self._found))
        if not tests:
            return "there is no test"
        try:
            removal.applied((self._copy.root / removal.file).read_text(encoding="utf-8"))
        except WrongRule as error:
            return str(error)
        if tests not in self._as_it_is:
            self._as_it_is[tests] = self._copy.run(tests)
        before = self._as_it_is[tests]
        if before.code != PASSED:
            return f"the tests fail as it is: {before.text.strip()[-2000:]}"
        return judged(removal, self._copy.without(removal, tests), tests)


def main(arguments: Sequence[str]) -> int:
    """Prove, print a line for each removal, keep what was proved; 1 where anything was not."""
    known, found, proofs = rules.load(), marks.collect(), rules.read_proofs()
    named = {argument for argument in arguments if argument != "--stale"} or set(rules.HAZARDS)
    is_well = True
    with Copy() as copy:
        prover = Prover(copy, found)
        for removal in rules.removals(known):
            if removal.hazard not in named or ("--stale" in arguments and removal.digest in proofs):
                continue
            result = prover.prove(removal)
            is_well &= isinstance(result, Proof)
            proofs.pop(removal.digest, None)
            if isinstance(result, Proof):
                proofs[removal.digest] = result
                result = f"{len(result.failed)} tests fail"
            print(f"{removal.hazard}  without {removal.takes}: {result}", flush=True)
            rules.write_proofs(proofs, known)
    return 0 if is_well else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
