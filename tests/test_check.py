"""What `check` says of a configuration before anything runs."""

from __future__ import annotations

import re
import signal
import socket
from pathlib import Path
from typing import Any

import pytest

from gateway import check, site
from gateway.bus.plan import plan_drive
from gateway.errors import BadConfig
from tests.mosquitto import free_port
from tests.processes import LIMIT, gateway, until

FIVE = ["status", "output_frequency", "output_current", "output_voltage", "alarm"]


def built(polls: list[dict[str, Any]], drives: int = 1, baud: int = 19200) -> site.Site:
    """Return a site of equal VF-nC3 on one line."""
    entries = [{"name": f"d{n}", "number": n, "model": "vf-nc3", "poll": polls} for n in range(1, drives + 1)]
    line = {"name": "a", "port": "/dev/ttyUSB0", "baud": baud, "drive": entries}
    return site.build({"gateway": {"name": "g"}, "line": [line]}, "test", Path())


def text(configured: site.Site) -> str:
    """Return the whole report."""
    return "\n".join(check.report(configured))


def test_the_selectors_to_set_are_said_and_used() -> None:
    """F875-F879 for the most often wanted values, and one exchange then."""
    said = text(built([{"values": FIVE, "every": "100ms"}]))
    assert "F875=1, F876=2, F877=3, F878=4, F879=5" in said
    assert "indirect block, 5 words: status, output_frequency" in said


def test_the_load_is_the_wire_time_over_the_period() -> None:
    """Five words at 19200 baud: 8 and 15 characters, two gaps, 15 ms in the drive at the most: 33 ms in 100."""
    configured = built([{"values": FIVE, "every": "100ms"}])
    plan = plan_drive(configured.drives[0], configured.lines[0], with_selectors=True)
    assert plan.load == pytest.approx((8 * 11 + 15 * 12 + 2 * 3.5 * 11) / 19200 / 0.1 + 0.15)


def test_what_does_not_fit_is_said_with_a_remedy() -> None:
    """Eight drives ten times a second at 9600 baud."""
    said = text(built([{"values": FIVE, "every": "100ms"}], drives=8, baud=9600))
    assert "DOES NOT FIT" in said
    assert "38400" in said


def test_a_line_at_the_highest_baud_rate_is_not_told_to_raise_it() -> None:
    """And how much longer the periods come out is the same number as in what each group reaches."""
    said = text(built([{"values": FIVE, "every": "100ms"}], drives=8, baud=38400))
    assert "come out about 2.1 times as long. Ask for fewer values or longer periods.\n" in said
    assert "asked 100 ms, reachable about 206 ms" in said
    assert "raise F800" not in said


def test_what_to_change_is_said_and_is_enough() -> None:
    """The period, or the baud rate, that is named: with it every poll is in time."""
    said = text(built([{"values": FIVE, "every": "250ms"}], drives=8))
    assert "DOES NOT FIT" in said
    assert "In time whatever falls together: poll every 330 ms instead of every 250 ms (8 drives); or raise" in said
    assert "raise F800 and line.baud to 38400." in said
    for every, baud in (("330ms", 19200), ("250ms", 38400)):
        enough = built([{"values": FIVE, "every": every}], drives=8, baud=baud)
        assert "Every poll is answered before it falls due again" in text(enough)


def test_each_group_says_what_is_asked_what_is_reached_and_how_late_it_may_be() -> None:
    """One that fits, one that is asked too often, one without a period."""
    said = text(built([{"values": FIVE, "every": "200ms"}]))
    assert "asked 200 ms, reachable 200 ms; answered 68 ms after its time at the worst, " in said
    said = text(built([{"values": FIVE, "every": "100ms"}], drives=8))
    assert "asked 100 ms, reachable about 278 ms; answered " in said
    said = text(built([{"values": FIVE, "every": "0s"}], drives=8))
    assert "asked as fast as possible, reachable about 290 ms; answered " in said


def test_a_load_that_fits_may_be_late_at_times() -> None:
    """Two drives every 100 ms: 66 of 100 ms, and a check of the block beside it."""
    said = text(built([{"values": FIVE, "every": "100ms"}], drives=2))
    assert "DOES NOT FIT" not in said
    assert "LATE AT TIMES: polls every 100 ms, when much falls together: how late, see below." in said
    assert "poll every 110 ms instead of every 100 ms (d1, d2)" in said


def test_where_no_period_of_one_group_is_enough_all_are_stretched() -> None:
    """Two groups of which each fills the line by itself."""
    polls = [{"values": FIVE, "every": "100ms"}, {"values": ["trip_code", "pid_feedback"], "every": "120ms"}]
    said = text(built(polls, drives=8, baud=9600))
    assert "make every period 12 times as long (100 ms to 1200 ms, 120 ms to 1500 ms)" in said


def test_what_fits_only_by_the_block_is_said() -> None:
    """A line that single reads would overload."""
    wide = ["status", "output_current", "alarm", "pid_feedback", "output_voltage"]
    said = text(built([{"values": wide, "every": "150ms"}], drives=4))
    assert "FITS ONLY with F875-F879" in said


def test_polls_without_a_period_get_the_rest_and_their_period_is_said() -> None:
    """As fast as the line allows: 33 ms at the worst."""
    assert "the rest by polls without a period, each every 33 ms" in text(built([{"values": FIVE, "every": "0s"}]))


def test_a_value_that_a_faster_block_brings_is_not_read_twice() -> None:
    """The slow group's status comes with the fast one."""
    configured = built([{"values": FIVE, "every": "100ms"}, {"values": ["status", "trip_code"], "every": "5s"}])
    plan = plan_drive(configured.drives[0], configured.lines[0], with_selectors=True)
    (_, slow) = plan.groups
    assert [r.name for read in slow[1] for r in read.registers] == ["trip_code"]
    assert "status: come with a faster block" in text(configured)


def toshiba(protocol: str, **more: Any) -> site.Site:
    """Return a line of three VF-nC3 with the numbers 11, 12 and 21 in a TOSHIBA protocol, two of them a group."""
    entries = [{"name": f"d{n}", "number": n, "model": "vf-nc3", "protocol": protocol, **more} for n in (11, 12, 21)]
    group = {"name": "fans", "drives": ["d11", "d12"]}
    line = {"name": "a", "port": "/dev/ttyUSB0", "drive": entries, "group": [group]}
    return site.build({"gateway": {"name": "g"}, "line": [line]}, "test", Path())


def test_what_a_protocol_has_not_got_is_said() -> None:
    """ASCII has no block, so provisioning has no effect; binary has it, and the gateway may set it."""
    said = text(toshiba("toshiba-ascii", provision=True))
    assert "toshiba-ascii has no block: single reads instead; with a block: modbus-rtu or toshiba-binary" in said
    assert "provision = true has no effect" in said
    said = text(toshiba("toshiba-binary", provision=True))
    assert "has no block" not in said
    assert "set once by the gateway (EEPROM), then reset the drive: F875=1" in said


@pytest.mark.parametrize(
    ("protocol", "said"),
    [
        ("modbus-rtu", "go with the block read: F870=1, F871=3 (command and frequency)"),
        ("toshiba-binary", "go with the block read: F870=1, F871=0 ("),
        ("toshiba-ascii", "block_write = true has no effect"),
    ],
)
def test_with_which_selectors_commands_go_with_the_block_is_said(protocol: str, said: str) -> None:
    """One or two words of it, as the protocol takes them; nothing where nobody may command."""
    assert said in text(toshiba(protocol, block_write=True, control="direct"))
    assert "block_write" not in text(toshiba(protocol, block_write=True))
    assert "with the block read" not in text(toshiba(protocol, block_write=True))


def test_the_frames_that_reach_a_group_are_said() -> None:
    """A digit in ASCII, which drives hear that are read in binary."""
    for protocol in ("toshiba-ascii", "toshiba-binary"):
        said = text(toshiba(protocol))
        assert "group fans: written by 1 frame\n    1* (toshiba-ascii): d11, d12; nobody answers" in said


# ---- drives that are commanded


def commanded(*drives: dict[str, Any], **line: Any) -> site.Site:
    """Return a line of VF-nC3 p1, p2 ..., commanded with a lease and an F803 of 1.5 s."""
    kept = {"model": "vf-nc3", "control": "leased", "communication_timeout": "1.5s", "timeout_action": "stop"}
    entries = [{"name": f"p{n}", "number": n, **kept, **drive} for n, drive in enumerate(drives, 1)]
    section = {"name": "a", "port": "/dev/ttyUSB0", "drive": entries, **line}
    return site.build({"gateway": {"name": "g"}, "line": [section]}, "test", Path())


def warnings(**drive: Any) -> list[str]:
    """Return what is warned of for one commanded drive."""
    return [line.strip() for line in check.report(commanded(drive)) if "WARNING" in line]


@pytest.mark.hazard("H06")
@pytest.mark.hazard("H30")
def test_how_each_time_out_is_kept_is_said_with_the_sum() -> None:
    """VF-nC3 by MODBUS-RTU at 19200 baud, in seconds: 0.121 + 0.120 + 0.027 + 0.036 = 0.303, of 0.500."""
    said = text(commanded({}))
    assert "communication time-outs: F803 from 1.0 s on can be kept on this line" in said
    assert (
        "p1: F803 1.5 s: a good exchange is due every 0.500 s; worst case 0.303 s ="
        " 0.121 an exchange under way (p1: write to the EEPROM) + 0.120 a lost exchange (p1: identification)"
        " + 0.027 emergency stop of the whole line + 0.036 its own turn: kept, margin 39%"
    ) in said


@pytest.mark.hazard("H30")
def test_what_cannot_be_kept_is_refused_with_file_key_and_remedy() -> None:
    """Two such drives; with a margin of 5 ms at 38400 baud they are kept."""
    short = {"communication_timeout": "1s"}
    with pytest.raises(BadConfig) as refused:
        check.refuse(commanded(short, short), Path("plant.toml"))
    first, second = str(refused.value).splitlines()
    assert first.startswith("plant.toml: line[0].drive[0] (p1).communication_timeout: F803 1.0 s: ")
    assert "TOO SHORT; set communication_timeout to 1.2 s or more" in first
    assert second.startswith("plant.toml: line[0].drive[1] (p2)")
    check.refuse(commanded(short, short, baud=38400, answer_margin="5ms"), Path("plant.toml"))


def plant(folder: Path, drive: str) -> Path:
    """Return a file with one commanded VF-nC3 that has these keys as well."""
    file = folder / "plant.toml"
    file.write_text(
        '[gateway]\nname = "g"\n[[line]]\nname = "a"\nport = "/dev/none"\n[[line.drive]]\nname = "p"\nnumber = 1\n'
        f'model = "vf-nc3"\ncontrol = "leased"\n{drive}\n'
    )
    return file


@pytest.mark.hazard("H06")
@pytest.mark.hazard("H34")
@pytest.mark.parametrize(
    ("drive", "refusal"),
    [
        ('communication_timeout = "2250ms"', r"\(p\)\.communication_timeout: F803: 2\.25 is not a multiple of 0\.1"),
        (
            'timeout_action = "stop"\non_loss = "quiesce"',
            r'\(p\)\.on_loss: "quiesce" leaves the stop to the drive\'s own F803',
        ),
    ],
)
def test_a_contradiction_is_not_run(tmp_path: Path, drive: str, refusal: str) -> None:
    """Neither at the start nor at a reload: both read the file by `load`."""
    with pytest.raises(BadConfig, match=refusal):
        check.load(plant(tmp_path, drive))


@pytest.mark.hazard("H30")
def test_a_time_out_that_cannot_be_kept_is_run_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """No plant stands still for that; the warning is what `check` refuses it with."""
    file = plant(tmp_path, 'communication_timeout = "0.5s"')
    configured = check.load(file)
    check.warn(configured, file)
    with pytest.raises(BadConfig, match=r"set communication_timeout to 1\.0 s or more") as refused:
        check.refuse(configured, file)
    assert [(record.levelname, record.message) for record in caplog.records] == [("WARNING", str(refused.value))]
    caplog.clear()
    check.warn(check.load(plant(tmp_path, 'communication_timeout = "1.0s"')), file)
    assert caplog.records == []


@pytest.mark.e2e
@pytest.mark.hazard("H30")
@pytest.mark.hazard("H34")
def test_start_and_reload_warn_of_what_cannot_be_kept_and_refuse_what_contradicts_itself(tmp_path: Path) -> None:
    """The port is not there: nothing of this waits for a drive."""
    file, log = plant(tmp_path, 'communication_timeout = "0.5s"'), tmp_path / "log"

    def said(text: str) -> bool:
        return any(text in line for line in log.read_text().splitlines())

    with gateway(file, log) as process:
        until(lambda: said("line a is down"), "the gateway's start")
        assert said(f"WARNING gateway: {file}: line[0].drive[0] (p).communication_timeout: F803 0.5 s: ")
        plant(tmp_path, 'communication_timeout = "550ms"')
        process.send_signal(signal.SIGHUP)
        until(lambda: said("not reloaded, the gateway goes on as it was"), "the refusal")
        plant(tmp_path, 'communication_timeout = "0.6s"')
        process.send_signal(signal.SIGHUP)
        until(lambda: said("(p).communication_timeout: F803 0.6 s: "), "the second warning")
        until(lambda: log.read_text().count("line a is down") == 2, "the reload")
        process.terminate()
        assert process.wait(LIMIT) == 0
    with gateway(plant(tmp_path, 'communication_timeout = "550ms"'), log) as process:
        assert process.wait(LIMIT) == 78


@pytest.mark.e2e
@pytest.mark.hazard("H34")
def test_a_reload_whose_port_is_taken_goes_back_to_what_was(tmp_path: Path) -> None:
    """A right file that cannot be had now is no reason to leave the drives alone; the next one is taken."""
    file, log = plant(tmp_path, ""), tmp_path / "log"
    listen = '[web]\nlisten = "127.0.0.1:{}"\n'

    def said(text: str) -> int:
        return log.read_text().count(text)

    with socket.create_server(("127.0.0.1", 0)) as taken, gateway(file, log) as process:
        until(lambda: said("line a is down") == 1, "the gateway's start")
        plant(tmp_path, "")
        file.write_text(listen.format(taken.getsockname()[1]) + file.read_text())
        process.send_signal(signal.SIGHUP)
        until(lambda: said("the gateway goes back to what it was") == 1, "the way back")
        until(lambda: said("line a is down") == 2, "the gateway's start")
        plant(tmp_path, "")
        file.write_text(listen.format(free_port()) + file.read_text())
        process.send_signal(signal.SIGHUP)
        until(lambda: said("line a is down") == 3, "the reload")
        process.terminate()
        assert process.wait(LIMIT) == 0


def test_a_line_that_nobody_commands_needs_no_time_outs() -> None:
    """Nothing is said of them."""
    assert "F803" not in text(built([{"values": FIVE, "every": "100ms"}]))


def test_by_whom_a_drive_is_commanded_and_what_ends_that_is_said() -> None:
    """Mode, sources, lease, on_loss, on_exit; what F803, F804 and F808 are to be."""
    said = text(commanded({"sources": ["mqtt"], "on_loss": "coast", "timeout_detection": "running"}))
    assert "control leased by mqtt: lease 2 s, then coast; when the gateway ends: stop" in said
    assert "F803 = 1.5 s, F804 = 2 (stop), F808 = 2 (running)" in said
    assert warnings() == []


def test_what_is_not_configured_is_the_drives_own() -> None:
    """Only at run time is it known what that is: said, with what the line can keep."""
    said = text(commanded({"communication_timeout": None, "timeout_action": None}))
    assert "F803 = the drive's own, F804 = the drive's own, F808 = the drive's own" in said
    assert "where it is 0 in the drive, run commands are refused; below 1.0 s it cannot be kept" in said
    assert "run commands are refused" not in text(commanded({"communication_timeout": None, "unwatched": True}))


def test_rights_are_counted() -> None:
    """A drive with rights refuses what none of them covers."""
    assert "rights: 1, all else is refused" in text(commanded({"right": [{"source": "mqtt"}]}))


@pytest.mark.hazard("H05")
@pytest.mark.parametrize(
    ("drive", "said"),
    [
        ({"control": "direct"}, 'control = "direct": there is no lease, so a controller that dies is not noticed'),
        ({"on_loss": "hold"}, 'on_loss = "hold": the motor runs on'),
        ({"on_loss": {"frequency": 10}}, "on_loss = { frequency = 10 }: the motor runs on"),
        ({"on_exit": "hold"}, 'on_exit = "hold": the motor runs on when the gateway ends'),
        ({"unwatched": True}, "unwatched = true: run commands are taken though"),
        ({"timeout_action": "alarm"}, 'timeout_action = "alarm": the drive only shows an alarm'),
    ],
)
def test_what_lets_a_motor_run_on_is_warned_of_in_words(drive: dict[str, Any], said: str) -> None:
    """One warning each, that says what happens."""
    (warning,) = warnings(**drive)
    assert warning.startswith(f"WARNING: {said}")


def test_a_drive_without_a_lease_is_not_warned_of_the_loss_of_it() -> None:
    """on_loss means nothing there."""
    (warning,) = warnings(control="direct", on_loss="hold")
    assert "on_loss" not in warning


@pytest.mark.hazard("H34")
def test_the_examples_are_kept() -> None:
    """Whoever begins with them is not refused."""
    for file in sorted((Path(__file__).parents[1] / "config").glob("*.toml")):
        check.refuse(check.load(file), file)


def test_what_one_process_cannot_carry_is_said() -> None:
    """32 full lines are more than a core; a few drives are next to nothing."""

    def told(lines: int, every: str) -> str:
        poll = [{"values": ["status", "output_frequency"], "every": every}]
        tables = [
            {
                "name": f"l{n}",
                "port": f"/dev/ttyS{n}",
                "baud": 38400,
                "drive": [{"name": f"d{n}", "number": 1, "unit": n + 1, "model": "vf-nc3", "poll": poll}],
            }
            for n in range(lines)
        ]
        made = site.build({"gateway": {"name": "t"}, "line": tables}, "test", Path())
        return "\n".join(list(check.report(made))[:3])

    assert "about 2 exchanges a second: 0% of a core" in told(1, "500ms")
    assert "TOO MUCH FOR ONE PROCESS" not in told(1, "0s")
    assert "TOO MUCH FOR ONE PROCESS" in told(32, "0s")
    assert re.search(r"several processes \(about [2-9]\)", told(32, "0s"))
