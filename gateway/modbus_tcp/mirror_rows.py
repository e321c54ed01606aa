"""The rows of the printed register map for commands by unit 255: the mirror, and the stops of whole lines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from gateway.modbus_tcp.gateway_unit import NO_VALUE, UNIT
from gateway.modbus_tcp.map_rows import Row, Table, row_of
from gateway.modbus_tcp.mirror_map import (
    ENDED,
    LINE_ORDERS,
    LINES_AT,
    MIRROR_AT,
    NOTHING,
    ORDERS,
    OWNERS,
    PER_DRIVE,
    REASONS,
    STANDINGS,
    STATUSES,
    UNDER_WAY,
    Order,
    Place,
)
from gateway.site import Drive, Site

TITLES = {
    Place.COMMAND: "what is to be done",
    Place.HEARTBEAT: "sign of life: another word than before renews the lease",
    Place.FREQUENCY: "frequency setpoint",
    Place.PARAMETER: "number of a preset speed or acceleration pattern",
    Place.SEQUENCE: "another number makes the same command once more",
    Place.ECHO: "sequence of the command that result and reason are about",
    Place.RESULT: "what became of it",
    Place.REASON: "why it was not done",
    Place.STANDING: "whether the drive may be set in motion",
    Place.OWNER: "who holds the lease",
    Place.OWNER_HIGH: "the owner's IPv4 address, first half",
    Place.OWNER_LOW: "the owner's IPv4 address, second half",
    Place.LEASE_LEFT: "what is left of the lease; 65535: so much or more",
}
SHOWN = {
    Place.DRIVE_STATUS: "status",
    Place.OUTPUT_FREQUENCY: "output_frequency",
    Place.TRIP_CODE: "trip_code",
}
AS_SHOWN = f"as in the compact map; {NO_VALUE:04X}H: no value"
UNITS = {Place.FREQUENCY: "Hz", Place.LEASE_LEFT: "ms"}
SCALES = {Place.FREQUENCY: "0.01"}


def _words(orders: Mapping[int, Order]) -> Mapping[int, str]:
    return {NOTHING: "nothing", **{code: order.word for code, order in orders.items()}}


CODES: Mapping[Place, Mapping[int, str]] = {
    Place.COMMAND: _words(ORDERS),
    Place.RESULT: {
        0: "none yet",
        **{number: status.value for status, number in STATUSES.items()},
        UNDER_WAY: "under way",
        ENDED: "done, and ended since",
    },
    Place.REASON: {number: reason.value or "none" for reason, number in REASONS.items()},
    Place.STANDING: {0: "not controlled", **{number: standing.value for standing, number in STANDINGS.items()}},
    Place.OWNER: {0: "nobody", **{number: channel.value for channel, number in OWNERS.items()}},
}


def command_tables(site: Site) -> Iterator[Table]:
    """Lay out the mirror and the lines; nothing where no drive may be commanded."""
    if not any(drive.is_controlled for drive in site.drives):
        return
    rows = (row for index, drive in enumerate(site.drives) for row in _mirror_rows(drive, index))
    yield Table(f"Unit {UNIT}: command mirror, {PER_DRIVE} registers a drive", tuple(rows), "mirror")
    yield Table(f"Unit {UNIT}: stops of whole lines", tuple(_line_rows(site)))


def _mirror_rows(drive: Drive, index: int) -> Iterator[Row]:
    for place in Place:
        address = MIRROR_AT + PER_DRIVE * index + place
        register = drive.model.registers.get(SHOWN.get(place, ""))
        if register is not None:
            yield row_of(
                UNIT, drive.name, address, register, None, f"as in the compact map; {NO_VALUE:04X}H: no value"
            )
            continue
        note = (
            "" if not place.is_written else "written" if drive.is_controlled else "not controlled: cannot be written"
        )
        yield Row(
            UNIT,
            drive.name,
            address,
            place.name.lower(),
            TITLES.get(place, "this model has no such value"),
            scale=SCALES.get(place, "1"),
            unit=UNITS.get(place, ""),
            codes=CODES.get(place, {}),
            note=note if place.is_written else "",
        )


def _line_rows(site: Site) -> Iterator[Row]:
    for index, line in enumerate(site.lines):
        note = "written" if any(drive.is_controlled for drive in line.drives) else "no drive of it may be commanded"
        title = f"stop of all drives of line {line.name}"
        yield Row(UNIT, line.name, LINES_AT + index, "line_stop", title, codes=_words(LINE_ORDERS), note=note)
