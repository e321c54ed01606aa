"""Says what Home Assistant may do with a drive: stop it always, and more where control permits.

It sends no heartbeat by itself, so that it cannot keep a lease: of a leased drive it is offered the stop only,
unless the configuration says that an automation beats (SAFETY.md H05). What needs arming or the lease is unavailable
without.
"""

from __future__ import annotations

import json
from typing import Any

from gateway.config import MqttSection
from gateway.control.command import Channel, Source, Verb
from gateway.control.composing import FREQUENCY
from gateway.mqtt import commands
from gateway.mqtt.entities import DIAGNOSTIC, Component, Place, is_set, on_off, when
from gateway.mqtt.operating import Operation, bits_of, operation_of

AT_LEAST_ONCE = 1  # QoS of a command
STATED_FREQUENCIES = (FREQUENCY, "frequency_command_value")  # FA01, FD02: what shows the setpoint, the better first
STATUS = "status"  # FD01
BUTTONS: dict[Verb, tuple[str, str | None]] = {  # title, icon
    Verb.STOP: ("Stop", "mdi:stop"),
    Verb.COAST: ("Coast", "mdi:stop-circle-outline"),
    Verb.EMERGENCY_STOP: ("Emergency stop", "mdi:alert-octagon"),
    Verb.TAKE: ("Take", "mdi:hand-back-right"),
    Verb.RELEASE: ("Release", "mdi:hand-back-right-off"),
    Verb.ARM: ("Arm", "mdi:shield-check"),
    Verb.RESET: ("Reset", "mdi:restart"),
}
HIDDEN = (Verb.COAST, Verb.EMERGENCY_STOP)  # there, and disabled until somebody enables them


class Controls:
    """The components by which Home Assistant commands one drive."""

    def __init__(self, place: Place, section: MqttSection, operation: Operation) -> None:
        self._place = place
        self._source = section.home_assistant.source
        self._owner = Source(Channel.MQTT, self._source, section.origin)
        self._operation = operation
        self._is_offered = section.home_assistant.heartbeat or not operation.is_leased
        register = place.image.points[STATUS].register if STATUS in place.image.points else None
        self._bits = bits_of(register)

    def components(self) -> dict[str, Component]:
        """Return all of them, by key."""
        found = {f"command/{verb}": self._button(verb) for verb in BUTTONS if self._has(verb)}
        if self._has(Verb.RUN):
            found |= self._run()
        if self._has(Verb.FREQUENCY) and self._operation.least < self._operation.greatest:
            found["set/frequency"] = self._frequency()
        if self._has(Verb.ACCELERATION) and "acceleration_2" in self._bits:
            found["set/acceleration"] = self._acceleration()
        found["state/control"] = self._standing()
        return found

    def _has(self, verb: Verb) -> bool:
        """Say whether a command is offered: of those that are permitted, what Home Assistant can do as it is."""
        if verb in (Verb.TAKE, Verb.RELEASE) and not self._operation.is_leased:
            return False
        return verb in self._operation.verbs and (verb.is_stopping or self._is_offered)

    # ---- when it may be asked for

    def _when(self, *, is_motion: bool = False, is_owned: bool = True) -> dict[str, Any]:
        """Return when something is available: the drive there, and armed, and the lease ours, as far as needed."""
        wanted = ["value_json.standing == 'armed'"] if is_motion else []
        if is_owned and self._operation.is_leased:
            wanted.append(f"value_json.owner == '{self._owner}'")
        available = self._place.of_drive
        if wanted:
            available.append({"topic": self._place.named.control, "value_template": when(" and ".join(wanted))})
        return {"availability": available, "availability_mode": "all"}

    # ---- what is asked for

    def _command(self, verb: Verb, **more: str) -> str:
        return json.dumps({"command": verb.value, **more, "source": self._source})

    def _topic(self, *levels: str) -> str:
        return "/".join((self._place.root, *levels))

    def _entity(self, platform: str, key: str, name: str, *levels: str, **options: Any) -> Component:
        return self._place.entity(
            platform, key, name, command_topic=self._topic(*levels), qos=AT_LEAST_ONCE, **options
        )

    def _button(self, verb: Verb) -> Component:
        title, icon = BUTTONS[verb]
        if verb.is_stopping:
            available: dict[str, Any] = {"availability": self._place.of_gateway}
        else:
            available = self._when(is_owned=verb is not Verb.TAKE)
        return self._entity(
            "button",
            f"command/{verb}",
            title,
            commands.COMMAND,
            payload_press=self._command(verb),
            icon=icon,
            enabled_by_default=False if verb in HIDDEN else None,
            **available,
        )

    def _run(self) -> dict[str, Component]:
        """Return run and stop as a switch, and the direction as a selection; a button where no state can be shown."""
        motion = self._when(is_motion=True)
        if "running" not in self._bits:
            run = self._command(Verb.RUN)
            key = "command/run"
            return {key: self._entity("button", key, "Run", commands.COMMAND, payload_press=run, **motion)}
        topic, word = self._place.number(STATUS)
        is_running = is_set(word, self._bits["running"])
        found = {
            "command/run": self._entity(
                "switch", "command/run", "Run", commands.COMMAND, payload_on=self._command(Verb.RUN),
                payload_off=self._command(Verb.STOP), state_topic=topic, value_template=on_off(is_running),
                state_on="ON", state_off="OFF", icon="mdi:engine", **motion,
            ),
        }  # fmt: skip
        if "reverse" in self._bits:
            is_reverse = is_set(word, self._bits["reverse"])
            state = f"'stop' if not {is_running} else 'reverse' if {is_reverse} else 'forward'"
            asked = ("stop", "forward", "reverse")
            payloads = (
                self._command(Verb.STOP),
                self._command(Verb.RUN, direction="forward"),
                self._command(Verb.RUN, direction="reverse"),
            )
            table = ", ".join(f"'{option}': '{text}'" for option, text in zip(asked, payloads, strict=True))
            found["command/direction"] = self._entity(
                "select", "command/direction", "Direction", commands.COMMAND, options=list(asked), state_topic=topic,
                value_template=f"{{{{ {state} }}}}", command_template=f"{{{{ {{{table}}}[value] }}}}", **motion,
            )  # fmt: skip
        return found

    def _setting(self, value: str) -> str:
        """Return the template of a value to be set; `value` is a template too."""
        return f'{{"value": {value}, "source": "{self._source}"}}'

    def _frequency(self) -> Component:
        """Return the setpoint; without a register that shows it, it is unknown, and not what was asked for last.

        One that is outside of what may be asked for Home Assistant would complain of, at each message.
        """
        operation = self._operation
        options: dict[str, Any] = {"optimistic": False}
        shown = next((name for name in STATED_FREQUENCIES if name in self._place.image.points), None)
        if shown is not None:
            topic, expression = self._place.number(shown)
            is_shown = f"{operation.least} <= {expression} | float(-1) <= {operation.greatest}"
            options = {"state_topic": topic, "value_template": f"{{{{ {expression} if {is_shown} else 'None' }}}}"}
        return self._entity(
            "number", "set/frequency", "Frequency setpoint", commands.SET, Verb.FREQUENCY.value,
            command_template=self._setting("{{ value }}"), min=float(operation.least), max=float(operation.greatest),
            step=float(operation.step), mode="box", unit_of_measurement="Hz", device_class="frequency",
            **options, **self._when(),
        )  # fmt: skip

    def _acceleration(self) -> Component:
        topic, word = self._place.number(STATUS)
        state = f"{{{{ '2' if {is_set(word, self._bits['acceleration_2'])} else '1' }}}}"
        return self._entity(
            "select", "set/acceleration", "Acceleration", commands.SET, Verb.ACCELERATION.value, options=["1", "2"],
            state_topic=topic, value_template=state, command_template=self._setting("{{ value }}"),
            entity_category="config", **self._when(),
        )  # fmt: skip

    def _standing(self) -> Component:
        """Return who may command, and why nobody may."""
        return self._place.entity(
            "sensor", "state/control", "Control", state_topic=self._place.named.control,
            value_template="{{ value_json.standing if value_json is defined else 'None' }}",
            json_attributes_topic=self._place.named.control, json_attributes_template="{{ value or '{}' }}",
            entity_category=DIAGNOSTIC, availability=self._place.of_gateway,
        )  # fmt: skip


def of_control(place: Place, section: MqttSection) -> dict[str, Component]:
    """Return the components by which a drive may be commanded; none where it may not, or not by this broker."""
    operation = operation_of(place.image.drive, section, section.home_assistant.source)
    return {} if operation is None else Controls(place, section, operation).components()
