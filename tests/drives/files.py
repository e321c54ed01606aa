"""Catalogue files that tests begin with: a whole model, an extension, one register."""

from __future__ import annotations

from pathlib import Path

WHOLE_MODEL = """
[model]
name = "vf-x"
title = "A drive of the user's own"
identity = "VFX"
series_code = 7
source = "its manual 1"

[times]
processing = 0.02
source = "its manual 2"

[blocks]
indirect_read_address = 0x1875
indirect_read_minimum = 2
indirect_read_maximum = 2
indirect_write_address = 0x1870
indirect_write_words = 1
has_exchange = true
direct_read_maximum = 4
direct_ranges = [[0x0000, 0x0999]]
source = "its manual 3"

[[connector]]
name = "rs485"
parameters = { timeout = "communication_timeout" }
block_write = ["selector_w"]
block_read = ["selector_1", "selector_2"]
source = "its manual 4"

[read_selectors]
0 = ""
1 = "speed"

[write_selectors]
0 = ""

[capacities]
3 = "VFX-2007"

[enumeration.trip]
0 = { text = "None" }
24 = { name = "err5", text = "Time-out" }

[[derived]]
name = "speed_hz"
of = "speed"
base = "rated"
unit = "Hz"
digits = 1
source = "its manual 5"

[[profile]]
values = ["speed", "speed_hz"]
every = "1s"

[[register]]
name = "speed"
address = 0xFD00
held = 0xFE00
kind = "monitor"
title = "Speed"
unit = "%"
scale = "0.01"
signed = true
source = "its manual 6"

[[register]]
name = "rated"
address = 0xFE70
kind = "monitor"
unit = "Hz"
source = "its manual 6"

[[register]]
name = "trip_code"
address = 0xFC90
kind = "status"
enumeration = "trip"
source = "its manual 6"

[[register]]
name = "communication_timeout"
address = 0x0803
kind = "parameter"
unit = "s"
scale = "0.1"
range = [1, 1000]
access = "rw"
storage = "eeprom"
writable_while_running = false
takes_effect = "after reset"
maximum_from = "rated"
source = "its manual 6"

[[register]]
name = "selector_w"
address = 0x0870
kind = "parameter"
source = "its manual 6"

[[register]]
name = "selector_1"
address = 0x0875
kind = "parameter"
values = { 0 = "None", 1 = "Speed" }
source = "its manual 6"

[[register]]
name = "selector_2"
address = 0x0876
kind = "parameter"
source = "its manual 6"
"""

EXTENSION = """
extend = "vf-nc3"

[times]
processing = 0.03
source = "measured"

[capacities]
99 = "VFnC3-9999P"

[enumeration.trip_code]
99 = { name = "e-99", text = "A new one" }

[[derived]]
name = "torque_newton_metres"
of = "torque"
base = "rated_torque"
unit = "Nm"
source = "name plate"

[[profile]]
values = ["status", "maximum_frequency"]
every = "500ms"

[[register]]
name = "maximum_frequency"
address = 0x0011
kind = "parameter"
unit = "Hz"
scale = "0.01"
range = [3000, 40000]
access = "rw"
storage = "eeprom"
source = "instruction manual"

[[register]]
name = "rated_torque"
address = 0x0999
kind = "parameter"
unit = "Nm"
scale = "0.1"
source = "instruction manual"

[[register]]
name = "frequency_command"
replaces = true
address = 0xFA01
kind = "command"
unit = "Hz"
scale = "0.01"
maximum_from = "maximum_frequency"
access = "rw"
storage = "ram"
source = "E6581657 7.1"

[[register]]
name = "last_but_not_least"
address = 0x0998
kind = "status"
enumeration = "trip_code"
source = "instruction manual"
"""

REGISTER = """
[[register]]
name = "extra"
address = 0x0777
kind = "parameter"
source = "somewhere"
"""


def written(folder: Path, text: str, name: str = "user.toml") -> Path:
    """Write a user's file."""
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path
