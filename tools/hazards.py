"""Writes docs/hazards.md: each hazard, its rule, the tests that prove it, and that they fail without it."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from tools import marks, rules
from tools.locks import ROOT
from tools.marks import MarkedTest
from tools.rules import Proof, Rule

PAGE = ROOT / "docs" / "hazards.md"

OPENING = """\
# Hazards

What can go wrong between a controller and a motor, the rule of this gateway against it, and the tests that prove
the rule. The gateway is **not a safety function**: the drive manuals demand a contactor that stops the machine
without fail.

Tests name the hazards that they prove by a mark, `@pytest.mark.hazard("H05")`. A hazard without a test, or with tests
of the simulated drives only, is **open**. That a test *can* fail is proved too: `tests/rules/` has for each rule one
or more removals, small changes of the source that take the rule away. `make prove` applies each of them to a copy of
the project, runs the tests of its hazard, and demands that one of them fails by what it asserts.

`make generate` writes this page, `make check` says when it is not current.

"""

HEAD = "| id | hazard | rule | kept in | tests | fail without their rule |\n|---|---|---|---|---|---|\n"

THE_TESTS = """
## The tests

A tick marks a test that failed when the rule was taken away. Those without one prove a part of the rule that no
removal takes away, or need other programs or much time, which the proof does without where it can.
"""


@dataclass(frozen=True, slots=True)
class Standing:
    """What there is for one rule: its tests, those of them that failed without it, and the removals not proved."""

    rule: Rule
    tests: Sequence[MarkedTest]
    failed: frozenset[str]
    unproved: int

    @property
    def own(self) -> list[MarkedTest]:
        """Return the tests of the gateway itself."""
        return [test for test in self.tests if not test.is_of_the_judge]

    @property
    def proof(self) -> str:
        """Say whether its tests fail without it."""
        if not self.rule.removals or not self.own:
            return "open"
        if self.unproved:
            return f"open: {self.unproved} of {len(self.rule.removals)} removals not proved"
        return f"yes: {len(self.failed)} of {len(self.own)}"


def standings(
    known: Sequence[Rule], found: Sequence[MarkedTest], proofs: Mapping[str, Proof]
) -> tuple[Standing, ...]:
    """Bring rules, tests and proofs together; WrongRule where a test names a hazard that there is not."""
    for test in found:
        if wrong := test.hazards - set(rules.HAZARDS):
            raise rules.WrongRule(f"{test.node}: there is no hazard {sorted(wrong)[0]!r}")
    return tuple(_standing(rule, [test for test in found if rule.id in test.hazards], proofs) for rule in known)


def _standing(rule: Rule, tests: list[MarkedTest], proofs: Mapping[str, Proof]) -> Standing:
    nodes = {test.node for test in tests}
    kills = [nodes & set(proofs[r.digest].failed) if r.digest in proofs else set() for r in rule.removals]
    return Standing(rule, tests, frozenset().union(*kills), sum(not kill for kill in kills))


def page(all_: Sequence[Standing]) -> str:
    """Return the whole page."""
    return OPENING + _summary(all_) + HEAD + "".join(_row(one) for one in all_) + "".join(_tests(all_))


def _summary(all_: Sequence[Standing]) -> str:
    tested = [one for one in all_ if one.own]
    proved = [one for one in tested if one.proof.startswith("yes")]
    nodes = {test.node for one in tested for test in one.own}
    return (
        f"{len(all_)} hazards; {len(tested)} with tests, {len(nodes)} tests in all; of {len(proved)} hazards it is"
        " proved that their tests fail without the rule.\n\n"
    )


def _row(one: Standing) -> str:
    rule = one.rule
    where = ", ".join(f"`{file.removeprefix('gateway/')}`" for file in rule.where)
    count = f"[{len(one.own)}](#{rule.id.lower()})" if one.own else "**open**"
    proof = one.proof if one.proof.startswith("yes") else f"**{one.proof}**"
    return f"| {rule.id} | {rule.hazard} | {rule.rule} | {where} | {count} | {proof} |\n"


def _tests(all_: Sequence[Standing]) -> Iterator[str]:
    yield THE_TESTS
    for one in all_:
        taken = "; ".join(removal.takes for removal in one.rule.removals) or "nothing yet"
        yield f"\n### {one.rule.id}\n\nTaken away: {taken}.\n\n"
        yield from (_line(test, test.node in one.failed) for test in one.tests)


def _line(test: MarkedTest, has_failed: bool) -> str:
    name = test.group if test.name == marks.MACHINE else test.name
    sentence = name.removeprefix("test_").replace("_", " ")
    kinds = {"real programs": test.is_e2e, "long play": test.is_long, "simulated drives": test.is_of_the_judge}
    what = "".join(f" ({kind})" for kind, is_it in kinds.items() if is_it)
    return f"- {'✓ ' if has_failed else ''}{sentence}{what}: `{test.file}`\n"


def main() -> int:
    """Write the page; with --check, only say whether it is current."""
    try:
        text = page(standings(rules.load(), marks.collect(), rules.read_proofs()))
    except rules.WrongRule as error:
        print(f"tools.hazards: {error}", file=sys.stderr)
        return 1
    if "--check" not in sys.argv[1:]:
        PAGE.write_text(text, encoding="utf-8")
        return 0
    if PAGE.exists() and PAGE.read_text(encoding="utf-8") == text:
        return 0
    print("docs/hazards.md is not current: run `make generate`", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
