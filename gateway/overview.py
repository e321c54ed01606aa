"""What `check` prints of a site: the plan of its lines, and by which topics and registers others see it."""

from __future__ import annotations

from collections.abc import Iterator

from gateway import broker_certificates, check, check_rights
from gateway.clock import SystemClock
from gateway.config import MqttSection
from gateway.image import Image
from gateway.modbus_tcp import credentials, mapping
from gateway.mqtt import topics
from gateway.mqtt.discovery import Discovery
from gateway.site import Site
from gateway.sparkplug import topics as sparkplug_topics
from gateway.store import backlog


def lines(configured: Site) -> Iterator[str]:
    """Yield it as lines of text."""
    yield from check.report(configured)
    for section in configured.config.brokers:
        yield from _broker(configured, section)
    if (edge := configured.config.sparkplug) is not None:
        yield "\nSparkplug topics"
        yield from (f"  {topic}" for topic in sparkplug_topics.overview(edge, configured))
        yield f"  {backlog.summary(configured, edge)}"
        yield from (f"  {line}" for line in broker_certificates.report(edge, SystemClock().wall()))
    if configured.config.modbus_tcp is not None:
        yield ""
        yield from check_rights.report(configured)
        if (tls := configured.config.modbus_tcp.tls) is not None:
            yield f"  {credentials.report(tls, SystemClock().wall())}"
        yield ""
        yield mapping.as_markdown(mapping.register_map(configured))


def _broker(configured: Site, section: MqttSection) -> Iterator[str]:
    way = "" if section.commands else ": nothing is taken from it"
    yield f"\nMQTT topics{f' of {section.label}{way}' if section.name else way}"
    yield from (f"  {topic}" for topic in topics.overview(section, configured))
    yield from (f"  taken: {topic}" for topic in topics.taken(section, configured))
    yield f"  {backlog.summary(configured, section)}"
    yield from (f"  {line}" for line in broker_certificates.report(section, SystemClock().wall()))
    if section.home_assistant.enabled:
        found = Discovery(section, configured.config.gateway.name, Image(configured.drives))
        yield from (f"  {topic}" for topic in found.topics())
