"""Sees that drives are of the models that they are said to be, before their numbers are trusted."""

from __future__ import annotations

from collections.abc import Callable

from gateway.bus.identification import CAPACITY, SERIES, Identification
from gateway.bus.session import Session
from gateway.commissioning.recognition import addresses, mismatch
from gateway.commissioning.targets import Target
from gateway.drives.register import Kind, Register
from gateway.errors import BadConfig, BadReply, GatewayError, NoReply, Refusal, Refused
from gateway.site import Drive

Say = Callable[[str], None]

ANY_MODEL = "--any-model writes all the same"


async def check(session: Session, target: Target, warn: Say) -> None:
    """Refuse (BadConfig) to write to a drive of another model; a silent one of a group is let be.

    Where the target takes any model it is only warned of.
    """
    for drive in target.drives:
        try:
            wrong = await _wrong(session, target, drive)
        except (NoReply, BadReply):
            if not target.is_group:
                raise
            continue
        if wrong and not target.any_model:
            raise BadConfig(f"{drive.name}: {wrong} ({ANY_MODEL})")
        if wrong:
            warn(f"{drive.name}: {wrong}")


async def warn_of_others(session: Session, target: Target, warn: Say) -> None:
    """Warn of drives of other models, whose values may mean something else; a drive that is silent is let be."""
    for drive in target.drives:
        try:
            wrong = await _wrong(session, target, drive)
        except GatewayError:
            continue
        if wrong:
            warn(f"{drive.name}: {wrong}: its values may mean something else")


async def _wrong(session: Session, target: Target, drive: Drive) -> str:
    """Say why a drive is not of its model, "" where it is as far as it tells: by 2BH, else by FB07 and FB05."""
    identity = await session.identify(drive)
    if identity is not None:
        return Identification(drive).is_stranger(identity)
    facts: dict[str, int] = {}
    unknown = set()
    for address, name in addresses(target.models).items():
        if name not in (CAPACITY, SERIES):
            continue
        try:
            facts[name] = await session.read(drive, Register(name, address, Kind.STATUS, source=""))
        except Refused as refused:
            if refused.reason is Refusal.ADDRESS:
                unknown.add(name)
    return mismatch(drive.model, target.models, facts, unknown)
