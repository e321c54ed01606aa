"""The page of hazards: how marks are found, what a removal is, and when a proof is one."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tools import hazards, marks, prove, rules
from tools.locks import ROOT
from tools.marks import MarkedTest
from tools.rules import Proof, Removal, Rule, WrongRule

RULES = rules.load()
REMOVALS = list(rules.removals(RULES))
FOUND = marks.collect()

SOURCE = '''
import pytest
pytestmark = [pytest.mark.e2e, pytest.mark.hazard("H01")]

@pytest.mark.hazard("H02", "H03")
async def test_a(): ...

@pytest.mark.hazard("H04")
class TestGroup:
    @pytest.mark.parametrize("x", [1, pytest.param(2, marks=pytest.mark.hazard("H05"))])
    def test_b(self, x): ...

    @pytest.mark.hazard("H06")
    def not_a_test(self): ...

TestMachine = pytest.mark.hazard("H07")(Machine.TestCase)
'''
TEST = MarkedTest("tests/bus/test_x.py", "test_a", frozenset({"H05"}), is_e2e=False)
REMOVAL = Removal("H05", "the lease", "gateway/x.py", "if over:\n", "if False:\n")
RULE = Rule("H05", "a hazard", "a rule", ("gateway/x.py",), (REMOVAL,))


class TestMarks:
    def test_they_are_found_at_the_module_the_class_the_function_and_the_parameter(self) -> None:
        """Without importing anything; "e2e" is told apart."""
        first, second, third = marks.of_source(SOURCE, "tests/test_x.py")
        assert (first.node, sorted(first.hazards)) == ("tests/test_x.py::test_a", ["H01", "H02", "H03"])
        assert (second.node, sorted(second.hazards)) == ("tests/test_x.py::TestGroup::test_b", ["H01", "H04", "H05"])
        assert (third.node, sorted(third.hazards)) == ("tests/test_x.py::TestMachine::runTest", ["H01", "H07"])
        assert first.is_e2e
        assert second.place == ("tests.test_x.TestGroup", "test_b")

    def test_a_file_without_marks_has_none(self) -> None:
        """Most files."""
        assert marks.of_source("def test_a(): ...\n", "tests/test_x.py") == []

    def test_those_of_the_project_name_hazards_that_there_are(self) -> None:
        """Each mark of each test."""
        assert {hazard for test in FOUND for hazard in test.hazards} <= set(rules.HAZARDS)

    def test_tests_of_the_simulated_drives_prove_no_rule(self) -> None:
        """They are the judge's."""
        assert replace(TEST, file="tests/sim/test_x.py").is_of_the_judge
        assert not TEST.is_of_the_judge


class TestRemovals:
    @pytest.mark.parametrize("removal", REMOVALS, ids=lambda removal: f"{removal.hazard} {removal.takes}")
    def test_the_old_text_stands_once_where_it_is_said_to_stand(self, removal: Removal) -> None:
        """So that the proof can be made again; the file is one of those that keep the rule."""
        source = (ROOT / removal.file).read_text(encoding="utf-8")
        assert removal.applied(source) != source
        assert removal.file in next(rule.where for rule in RULES if rule.id == removal.hazard)

    @pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.id)
    def test_the_files_of_a_rule_exist(self, rule: Rule) -> None:
        """No page that leads nowhere."""
        assert rule.where
        assert not [file for file in rule.where if not (ROOT / file).exists()]

    def test_an_old_text_that_stands_twice_or_not_at_all_is_refused(self) -> None:
        """Nobody can say what was taken away then."""
        assert REMOVAL.applied("if over:\n    stop()\n") == "if False:\n    stop()\n"
        with pytest.raises(WrongRule, match="stands 2 times"):
            REMOVAL.applied("if over:\n    a()\nif over:\n    b()\n")
        with pytest.raises(WrongRule, match="stands 0 times"):
            REMOVAL.applied("if under:\n    a()\n")

    def test_a_removal_that_leaves_no_python_is_refused(self) -> None:
        """A file that cannot be read fails every test, and proves nothing."""
        with pytest.raises(WrongRule, match="no Python"):
            replace(REMOVAL, new="if\n").applied("if over:\n    stop()\n")

    def test_another_text_is_another_removal(self) -> None:
        """What was proved of the old one is not proved of it."""
        assert replace(REMOVAL, new="if 0:\n").digest != REMOVAL.digest


class TestProofs:
    def test_a_test_that_fails_by_what_it_asserts_is_one(self) -> None:
        """Parameters belong to their function; a name that is missing is an accident of the removal."""
        xml = (
            '<testsuite><testcase classname="tests.bus.test_x" name="test_a[1-x]">'
            '<failure message="AssertionError: no"/></testcase><testcase classname="c" name="passed"/>'
            '<testcase classname="c" name="test_b"><failure message="NameError: lease"/></testcase>'
            '<testcase classname="c" name="test_c"><error message="AssertionError"/></testcase></testsuite>'
        )
        assert prove.read_report(xml) == {("tests.bus.test_x", "test_a")}

    @pytest.mark.parametrize(
        ("code", "failed", "why"),
        [
            (prove.PASSED, set(), "every test passes without it"),
            (prove.FAILED, set(), "nothing fails by what it asserts"),
            (2, {("tests.bus.test_x", "test_a")}, "pytest ends with 2: interrupted"),
        ],
    )
    def test_nothing_else_is_one(self, code: int, failed: set[tuple[str, str]], why: str) -> None:
        """All passed, failed by accident, or not run to the end."""
        report = prove.Report(code, frozenset(failed), "interrupted")
        assert prove.judged(REMOVAL, report, [TEST]) == why

    def test_it_names_the_tests_that_failed(self) -> None:
        """By what pytest calls them."""
        report = prove.Report(prove.FAILED, frozenset({TEST.place}), "")
        assert prove.judged(REMOVAL, report, [TEST]) == Proof(REMOVAL.digest, (TEST.node,))

    def test_tests_with_other_programs_are_run_only_where_a_removal_says_so(self) -> None:
        """And those of the judge, or that take long, never."""
        slow, judge = replace(TEST, is_e2e=True), replace(TEST, file="tests/sim/test_x.py")
        long = replace(TEST, file="tests/simulation/test_x.py")
        assert prove.tests_of(REMOVAL, [TEST, slow, judge, long]) == [TEST]
        assert prove.tests_of(replace(REMOVAL, e2e=True), [TEST, slow, judge, long]) == [slow]


class TestPage:
    def test_a_hazard_is_open_without_a_test_or_a_proof(self) -> None:
        """Said in its row; tests of the judge count for nothing."""
        judge = replace(TEST, file="tests/sim/test_x.py")
        for found in ([], [judge]):
            (standing,) = hazards.standings([RULE], found, {})
            assert "**open** | **open** |" in hazards.page([standing])
        (standing,) = hazards.standings([RULE], [TEST], {})
        assert standing.proof == "open: 1 of 1 removals not proved"

    def test_a_proof_counts_while_removal_and_test_are_there(self) -> None:
        """A renamed test must be proved again."""
        proofs = {REMOVAL.digest: Proof(REMOVAL.digest, (TEST.node,))}
        (standing,) = hazards.standings([RULE], [TEST], proofs)
        assert standing.proof == "yes: 1 of 1"
        assert "- ✓ a: `tests/bus/test_x.py`" in hazards.page([standing])
        (standing,) = hazards.standings([RULE], [replace(TEST, name="test_b")], proofs)
        assert standing.proof.startswith("open")

    def test_an_unknown_hazard_is_refused(self) -> None:
        """A mark with a slip in it."""
        with pytest.raises(WrongRule, match="test_a: there is no hazard 'H99'"):
            hazards.standings([RULE], [replace(TEST, hazards=frozenset({"H99"}))], {})

    def test_every_hazard_has_its_row(self) -> None:
        """37 of them."""
        text = hazards.page(hazards.standings(RULES, FOUND, {}))
        assert [line[2:5] for line in text.splitlines() if line.startswith("| H")] == list(rules.HAZARDS)
