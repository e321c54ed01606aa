"""How benchmarks are run and their results told."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from bench import block_forms, control_cycle, mqtt_throughput, one_drive, run


@dataclass(frozen=True, slots=True)
class Measured:
    """A result."""

    name: str
    rate: float


def measured(late: list[float], seconds: float, runs: int) -> Iterator[Measured]:
    """Tell what was asked for."""
    for name in ("first", "second"):
        late.append(0.000_05)
        yield Measured(name, seconds * runs)


TABLE = one_drive.Table(
    "Things",
    "name rate",
    0.5,
    measured,
    row=lambda result: f"{result.name} {result.rate}",
    ratios=lambda results: iter([f"{len(results)} results"]),
)


def told(*options: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    """Run the table's program with options and return what it printed."""
    monkeypatch.setattr(sys, "argv", ["bench", *options])
    one_drive.main("a benchmark", TABLE)
    return capsys.readouterr().out


def test_results_are_told_as_a_table(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows as they come, then the ratios and how late the line was itself."""
    lines = told("--runs", "2", monkeypatch=monkeypatch, capsys=capsys).splitlines()
    assert lines[0] == "Things, medians of 2 runs of 0.5 s; gv: gap violations"
    assert lines[1:5] == ["name rate", "first 1.0", "second 1.0", "2 results"]
    assert lines[5].endswith("50 microseconds")


def test_results_are_told_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Nothing but the document."""
    document = json.loads(told("--json", "--seconds", "2", monkeypatch=monkeypatch, capsys=capsys))
    assert document["results"] == [{"name": "first", "rate": 6.0}, {"name": "second", "rate": 6.0}]
    assert document["lateness_p99"] == 0.000_05


@pytest.mark.parametrize("name", run.BENCHMARKS)
def test_every_benchmark_is_a_program_that_says_what_it_measures(name: str) -> None:
    """`make bench` runs each by its name, quickly by its own options."""
    module = importlib.import_module(f"bench.{name}")
    assert module.__doc__
    done = subprocess.run(
        [sys.executable, "-m", f"bench.{name}", *run.BENCHMARKS[name], "--help"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "--help" in done.stdout


def test_an_unknown_benchmark_is_refused(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """And all are named."""
    monkeypatch.setattr(sys, "argv", ["run", "line_lode"])
    with pytest.raises(SystemExit):
        run.main()
    assert "no benchmark line_lode; there are line_load" in capsys.readouterr().err


@pytest.mark.e2e
def test_forms_and_cycles_are_measured() -> None:
    """The first row of each table: some values, nothing failed, and never more than the wire allows."""
    late: list[float] = []
    form, cycle = next(block_forms.measured(late, 0.1, 1)), next(control_cycle.measured(late, 0.1, 1))
    assert (form.failed, cycle.failed) == (0, 0)
    assert 0 < form.share <= 1
    assert 0 < cycle.share <= 1
    assert cycle.is_obeyed
    assert form.form in block_forms.row(form)
    assert cycle.master in control_cycle.row(cycle)


def test_a_load_costs_the_line_what_it_has_less_than_beside_it() -> None:
    """In points; a line that grows slower all the time costs nothing."""
    assert mqtt_throughput.costs([0.97, 0.97, 0.95], [0.96, 0.96]) == pytest.approx([1.0, 0.0])
    assert mqtt_throughput.costs([0.97, 0.95], [0.96]) == pytest.approx([0.0])


def test_a_row_of_throughput_has_medians_and_quartiles() -> None:
    """Of idle and of loaded stretches."""
    idle = [mqtt_throughput.Stretch(0.0, 0.02, 0.0, 0.0, 0.97)] * 4
    loaded = [mqtt_throughput.Stretch(20_000.0, 0.4, 0.2, 0.1, share) for share in (0.96, 0.965, 0.97)]
    told = mqtt_throughput.row(mqtt_throughput.Row(0, "state", 20_000.0, 0, idle, loaded))
    assert told.split() == [
        *("0", "state", "20000", "20000", "0", "40%", "20%", "10%", "97.0%", "96.5%"),
        *("0.50", "(0.00", "to", "1.00)"),
    ]
