"""What `check` says of a configuration before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway import check, site
from gateway.errors import BadConfig

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
    plan = check.plan_drive(configured.drives[0], configured.lines[0], with_selectors=True)
    assert plan.load == pytest.approx((8 * 11 + 15 * 12 + 2 * 3.5 * 11) / 19200 / 0.1 + 0.15)


def test_what_does_not_fit_is_said_with_a_remedy() -> None:
    """Eight drives ten times a second at 9600 baud."""
    said = text(built([{"values": FIVE, "every": "100ms"}], drives=8, baud=9600))
    assert "DOES NOT FIT" in said
    assert "38400" in said


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
    plan = check.plan_drive(configured.drives[0], configured.lines[0], with_selectors=True)
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
    """VF-nC3 by MODBUS-RTU at 19200 baud, in seconds: 0.121 + 0.027 + 0.241 + 0.039 = 0.427, of 0.500."""
    said = text(commanded({}))
    assert "communication time-outs: F803 from 1.3 s on can be kept on this line" in said
    assert (
        "p1: F803 1.5 s: a good exchange is due every 0.500 s; worst case 0.427 s ="
        " 0.121 an exchange under way (p1: write to the EEPROM) + 0.027 emergency stop of the whole line"
        " + 0.241 its own exchange, lost once and repeated + 0.039 room for all else: kept, margin 15%"
    ) in said


@pytest.mark.hazard("H30")
def test_what_cannot_be_kept_is_refused_with_file_key_and_remedy() -> None:
    """Two such drives; with a margin of 5 ms at 38400 baud they are kept."""
    with pytest.raises(BadConfig) as refused:
        check.refuse(commanded({}, {}), Path("plant.toml"))
    first, second = str(refused.value).splitlines()
    assert first.startswith("plant.toml: line[0].drive[0] (p1).communication_timeout: F803 1.5 s: ")
    assert "TOO SHORT; set communication_timeout to 2.7 s or more" in first
    assert second.startswith("plant.toml: line[0].drive[1] (p2)")
    check.refuse(commanded({}, {}, baud=38400, answer_margin="5ms"), Path("plant.toml"))


@pytest.mark.hazard("H30")
def test_a_file_that_cannot_be_kept_is_not_run(tmp_path: Path) -> None:
    """Neither at the start nor at a reload: both read it by `load`."""
    file = tmp_path / "plant.toml"
    drive = '[[line.drive]]\nname = "p"\nnumber = 1\nmodel = "vf-nc3"\ncontrol = "leased"\n'
    line = '[gateway]\nname = "g"\n[[line]]\nname = "a"\nport = "/dev/ttyUSB0"\n'
    file.write_text(f'{line}{drive}communication_timeout = "0.5s"\n')
    with pytest.raises(BadConfig, match=r"set communication_timeout to 1\.3 s or more"):
        check.load(file)
    file.write_text(f'{line}{drive}communication_timeout = "1.3s"\n')
    assert check.load(file).drives[0].name == "p"


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
    assert "where it is 0 in the drive, run commands are refused; below 1.3 s it cannot be kept" in said
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
        check.load(file)
