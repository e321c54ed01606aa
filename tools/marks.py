"""Finds the tests that carry `@pytest.mark.hazard("Hnn")` by their source alone: nothing is imported or run."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tools.locks import ROOT

TESTS = ROOT / "tests"
MACHINE = "runTest"  # the one test of a state machine: `TestX = pytest.mark.hazard("H05")(X.TestCase)`
LONG = "tests/simulation/"  # long plays of the whole gateway: too long to be played once for each removal
JUDGES = "tests/sim/"  # tests of the simulated drives, which judge the gateway: they prove no rule of it


@dataclass(frozen=True, slots=True)
class MarkedTest:
    """A test function and the hazards whose rules it proves; `is_e2e`: it starts other programs."""

    file: str
    name: str
    hazards: frozenset[str]
    is_e2e: bool
    group: str = ""  # its class

    @property
    def node(self) -> str:
        """Return what pytest calls it, all its parameters included."""
        return "::".join(part for part in (self.file, self.group, self.name) if part)

    @property
    def place(self) -> tuple[str, str]:
        """Return the class and the name by which pytest's report calls it, without parameters."""
        module = self.file.removesuffix(".py").replace("/", ".")
        return (f"{module}.{self.group}" if self.group else module), self.name

    @property
    def is_long(self) -> bool:
        """Say whether it plays the whole gateway for long."""
        return self.file.startswith(LONG)

    @property
    def is_of_the_judge(self) -> bool:
        """Say whether it is about the simulated drives."""
        return self.file.startswith(JUDGES)


def collect(folder: Path = TESTS, root: Path = ROOT) -> list[MarkedTest]:
    """Return every marked test below a folder, in the order of files and lines."""
    found = []
    for path in sorted(folder.rglob("test_*.py")):
        found += of_source(path.read_text(encoding="utf-8"), path.relative_to(root).as_posix())
    return found


def of_source(source: str, file: str) -> list[MarkedTest]:
    """Return the marked tests of one file."""
    module = ast.parse(source, file)
    return [test for test in _tests(module.body, file, _of_module(module), "") if test.hazards]


def _tests(body: list[ast.stmt], file: str, around: frozenset[str], group: str) -> Iterator[MarkedTest]:
    """Yield every test function; `around` are the marks of what stands around it."""
    for node in body:
        if isinstance(node, ast.ClassDef) and node.name.startswith("Test"):
            yield from _tests(node.body, file, around | _marks(node.decorator_list), node.name)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            marks = around | _marks(node.decorator_list)
            yield MarkedTest(file, node.name, marks - {"e2e"}, "e2e" in marks, group)
        elif isinstance(node, ast.Assign) and (name := ast.unparse(node.targets[0])).startswith("Test"):
            marks = around | _marks([node.value])
            yield MarkedTest(file, MACHINE, marks - {"e2e"}, "e2e" in marks, name)


def _of_module(module: ast.Module) -> frozenset[str]:
    for node in module.body:
        if isinstance(node, ast.Assign) and any(ast.unparse(target) == "pytestmark" for target in node.targets):
            return _marks([node.value])
    return frozenset()


def _marks(expressions: list[ast.expr]) -> frozenset[str]:
    """Return the hazards named anywhere in decorators (also those of single parameters), and "e2e"."""
    names: set[str] = set()
    for node in (inner for expression in expressions for inner in ast.walk(expression)):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.mark.hazard":
            names |= {str(ast.literal_eval(argument)) for argument in node.args}
        elif ast.unparse(node) == "pytest.mark.e2e":
            names.add("e2e")
    return frozenset(names)
