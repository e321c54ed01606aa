"""docs/trace.md is true: its session is played, its tables leave nothing out, its filters are known to Wireshark."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from gateway.sim.process import SimulatedLine
from gateway.sim.settings import SimulatedLineConfig, from_options
from gateway.trace.capture import Capture
from gateway.trace.record import Verdict
from tests.mosquitto import program
from tests.processes import gateway, until

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "trace.md").read_text(encoding="utf-8")
SHOWN_PORT = "/tmp/line"  # noqa: S108  (as the page has it)
CHANGING = (
    (r"\d{4}-\d\d-\d\dT[\d:.]+Z", "TIME"),
    (r"\d{8}T\d{6}\.\d{3}Z", "TIME"),
    (r"\d+\.\d\d ms", "N ms"),
    (r"^\d+ frames in", "N frames in"),
)  # differs from one play to the next


def blocks(language: str) -> list[str]:
    """Return the page's code blocks of a language."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def rows(heading: str) -> list[list[str]]:
    """Return the cells of every table under a heading."""
    body = PAGE.split(f"\n## {heading}\n", 1)[1].split("\n## ", 1)[0]
    found = re.findall(r"^\|(?![-| ]*\n)([^\n]*)\|$", body, re.MULTILINE)
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", row)] for row in found]
    return [row for row in cells if row[0] not in ("verdict", "filter", "wanted") and not row[0].startswith("--")]


def settled(text: str) -> str:
    """Return a text without what differs from one play to the next."""
    for pattern, word in CHANGING:
        text = re.sub(pattern, word, text, flags=re.MULTILINE)
    return text


def simulated(link: Path) -> SimulatedLineConfig:
    """Return the line that the page begins with."""
    found = re.search(r"tosvert-gateway simulate (.*) --link", PAGE)
    assert found is not None
    return from_options(re.findall(r"--drive (\S+)", found[1])).model_copy(update={"link": str(link)})


@contextmanager
def played(folder: Path) -> Iterator[tuple[SimulatedLine, subprocess.Popen[str], Path]]:
    """Run the line and the gateway of the page; the programs that it names are in the folder."""
    for name, command in (("tosvert-gateway", f'"{sys.executable}" -m gateway'), ("tshark", program("tshark"))):
        (folder / name).write_text(f'#!/bin/sh\nexec {command} "$@"{" 2>/dev/null" * (name == "tshark")}\n')
        (folder / name).chmod(0o755)
    (folder / "gateway.toml").write_text(blocks("toml")[0].replace(SHOWN_PORT, str(folder / "line")))
    config, log = folder / "gateway.toml", folder / "log"
    with SimulatedLine(simulated(folder / "line")) as line, gateway(config, log) as process:
        for drive in ("pump-1", "fan-1"):
            until(partial(is_online, log, drive), drive)
        heard = line.state(1)["messages_acknowledged"]
        until(lambda: line.state(1)["messages_acknowledged"] > heard + 30, "some exchanges")
        yield line, process, log


def is_online(log: Path, drive: str) -> bool:
    """Say whether the log tells of a drive that answers."""
    return f"{drive} is online" in log.read_text()


@pytest.mark.e2e
def test_the_session_is_true(tmp_path: Path) -> None:
    """Every command in turn, its output line by line but for the times; and the log after a fault."""
    with played(tmp_path) as (line, process, log):
        for block in blocks("console"):
            for shown in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
                command, _, expected = shown.partition("\n")
                done = subprocess.run(
                    ["sh", "-c", command],
                    stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True,
                    check=False, timeout=60, cwd=tmp_path,
                    env={"PATH": f"{tmp_path}:/usr/bin:/bin", "PYTHONPATH": str(ROOT)},
                )  # fmt: skip
                assert settled(done.stdout) == settled(expected), command
        line.do({"do": "fault", "kind": "cut", "drive": 1})
        expected = settled(blocks("text")[0]).replace("TIME.pcapng", "")
        until(lambda: "gateway.trace: the latest frames are in" in log.read_text(), "a file")
        told = settled(log.read_text()).replace(f"{tmp_path}/", "").replace("TIME.pcapng", "")
        assert expected.strip() in told
        process.send_signal(signal.SIGUSR1)
        until(lambda: len(list((tmp_path / "traces").glob("*.pcapng"))) == 2, "a second file")


@pytest.mark.e2e
@pytest.mark.parametrize("row", rows("Wireshark"), ids=lambda row: str(row[0]))
def test_each_filter_is_known_to_wireshark(row: list[str], tmp_path: Path) -> None:
    """And so are the options, and the fields that the text names."""
    (tmp_path / "line.pcapng").write_bytes(Capture(["a"]).begin())
    options = blocks("sh")[1].split("line.pcapng", 1)[1].split()
    command = [program("tshark"), "-r", str(tmp_path / "line.pcapng"), *options, "-Y", row[0].strip("`")]
    fields = re.findall(r"`(frame\.\w+)`", PAGE)
    assert len(fields) >= 2
    command += ["-T", "fields", *[word for field in fields for word in ("-e", field)]]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


def test_every_verdict_is_told() -> None:
    """By its word, and no other."""
    assert {row[0].strip("`") for row in rows("Verdicts")} == {verdict.value for verdict in Verdict}
