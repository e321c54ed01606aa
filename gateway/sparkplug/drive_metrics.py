"""Says which metrics a drive has as a device, and what each of them shows. Pure."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from gateway.control.drive_control import DriveControl
from gateway.image import DriveImage
from gateway.mqtt.topics import has_text
from gateway.sparkplug.definition import Definer, Definition
from gateway.sparkplug.payload import DataType, Value

TRIPPED, RESET_NEEDED = "Drive/Tripped", "Drive/Reset Needed"
MODE, STANDING, REASON, OWNER = "Control/Mode", "Control/Standing", "Control/Reason", "Control/Owner"
RESULT, EVENT = "Control/Result", "Control/Event"
COMMAND, HEARTBEAT, FREQUENCY = "Control/Command", "Control/Heartbeat", "Control/Frequency"
FOLDERS = ("drive", "control", "properties")  # first levels that no value may have, in any case

# What a button asks for when true is written to it, as MQTT spells it; see `commands` for false.
BUTTONS: Mapping[str, bytes] = {
    "Control/Take": b"take",
    "Control/Release": b"release",
    "Control/Arm": b"arm",
    "Control/Run": b"run",
    "Control/Run Reverse": b'{"command": "run", "reverse": true}',
    "Control/Stop": b"stop",
    "Control/Coast": b"coast",
    "Control/Emergency Stop": b"emergency_stop",
    "Control/Reset": b"reset",
}
INPUTS: Mapping[str, tuple[DataType, Value, str]] = {  # type, what it shows, unit
    COMMAND: (DataType.STRING, "", ""),
    HEARTBEAT: (DataType.INT64, 0, ""),
    FREQUENCY: (DataType.DOUBLE, None, "Hz"),
}


@dataclass(slots=True)
class DriveMetrics:
    """The definitions of one drive.

    `values` and `texts` are by value name, `standing` and `constants` by metric name, `told` what happens, `inputs`
    what can be written besides values.
    """

    values: dict[str, Definition] = field(default_factory=dict)
    texts: dict[str, Definition] = field(default_factory=dict)
    standing: dict[str, Definition] = field(default_factory=dict)
    told: dict[str, Definition] = field(default_factory=dict)
    inputs: dict[str, Definition] = field(default_factory=dict)
    constants: dict[str, tuple[Definition, Value]] = field(default_factory=dict)
    writable: dict[str | int, str] = field(default_factory=dict)  # metric name or alias -> input, or value name


def define(definer: Definer, image: DriveImage, *, is_controlled: bool, may_command: bool) -> DriveMetrics:
    """Define all metrics of a drive; `may_command`: by Sparkplug."""
    made = DriveMetrics()
    for name in image.names:
        _define_value(made, definer, image, name, may_write=may_command and _is_writable(image, name))
    made.standing[TRIPPED] = definer.define(TRIPPED, DataType.BOOLEAN)
    made.standing[RESET_NEEDED] = definer.define(RESET_NEEDED, DataType.BOOLEAN)
    for name in (MODE, STANDING, REASON, OWNER) if is_controlled else (MODE,):
        made.standing[name] = definer.define(name, DataType.STRING)
    for name in (RESULT, EVENT) if is_controlled else ():
        made.told[name] = definer.define(name, DataType.STRING)
    if may_command:
        _define_inputs(made, definer)
    _define_constants(made, definer, image)
    return made


def _define_value(made: DriveMetrics, definer: Definer, image: DriveImage, name: str, *, may_write: bool) -> None:
    title = "" if name in image.derived else image.points[name].register.title
    shown = metric_name(name)
    definition = definer.define(shown, _type_of(image, name), image.unit(name), title, is_writable=may_write)
    made.values[name] = definition
    if may_write:
        made.writable |= {shown: name, definition.alias: name}
    if has_text(image, name):
        made.texts[name] = definer.define(f"{shown}_text", DataType.STRING)


def _define_inputs(made: DriveMetrics, definer: Definer) -> None:
    known = dict.fromkeys(BUTTONS, (DataType.BOOLEAN, ""))
    known |= {name: (datatype, unit) for name, (datatype, _, unit) in INPUTS.items()}
    for name, (datatype, unit) in known.items():
        definition = definer.define(name, datatype, unit, is_writable=True)
        made.inputs[name] = definition
        made.writable |= {name: name, definition.alias: name}


def _define_constants(made: DriveMetrics, definer: Definer, image: DriveImage) -> None:
    drive = image.drive
    known: dict[str, tuple[DataType, Value]] = {
        "Properties/Model": (DataType.STRING, drive.model.name),
        "Properties/Line": (DataType.STRING, drive.line),
        "Properties/Number": (DataType.INT32, drive.number),
        "Properties/Protocol": (DataType.STRING, drive.protocol),
    }
    for name, (datatype, value) in known.items():
        made.constants[name] = definer.define(name, datatype), value


def metric_name(name: str) -> str:
    """Return the metric name of a value; one that is a folder here gets "_value" behind it."""
    return f"{name}_value" if name in FOLDERS else name


def _is_writable(image: DriveImage, name: str) -> bool:
    return name in image.points and image.points[name].register.is_writable


def _type_of(image: DriveImage, name: str) -> DataType:
    """Return the type that holds every value exactly, as decoders of any make read it.

    Int16 is none of them: of a negative one, some write and read 16 bits, and some 32.
    """
    if name in image.derived:
        return DataType.DOUBLE
    scaling = image.points[name].register.scaling
    if scaling.scale != int(scaling.scale):
        return DataType.DOUBLE
    return DataType.UINT16 if scaling.scale == 1 and not scaling.signed else DataType.INT32


def number_of(image: DriveImage, name: str, datatype: DataType) -> Callable[[int], float | int]:
    """Return what makes of a word the number that the metric of a value shows, where the value is good."""
    if name in image.derived:
        return lambda word: float(image.number(name, word))
    scaling = image.points[name].register.scaling
    if datatype is DataType.DOUBLE:
        return scaling.nearest
    units = int(scaling.scale)
    return lambda word: scaling.raw(word) * units


def standing_of(image: DriveImage, control: DriveControl | None) -> dict[str, Value]:
    """Return what is known of trip, reset and control, by metric name."""
    shown: dict[str, Value] = {TRIPPED: image.is_tripped, RESET_NEEDED: image.is_reset_needed}
    if control is None:
        return {**shown, MODE: "off"}
    owner = control.lease.owner
    return {
        **shown,
        MODE: "leased" if control.settings.is_leased else "direct",
        STANDING: control.standing.value,
        REASON: control.reason,
        OWNER: "" if owner is None else str(owner),
    }
