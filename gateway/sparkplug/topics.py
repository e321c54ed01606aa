"""Says under which topic everything of Sparkplug B is published and heard (Sparkplug 3.0, 4.1). Pure."""

from __future__ import annotations

from dataclasses import dataclass

from gateway.config import SparkplugSection
from gateway.site import Site

NAMESPACE = "spBv1.0"


@dataclass(frozen=True, slots=True)
class Topics:
    """The topics of one edge node and its devices."""

    group: str
    node: str

    def of_node(self, kind: str) -> str:
        """Return the topic of NBIRTH, NDATA, NDEATH or NCMD."""
        return f"{NAMESPACE}/{self.group}/{kind}/{self.node}"

    def of_device(self, kind: str, device: str) -> str:
        """Return the topic of DBIRTH, DDATA, DDEATH or DCMD of a drive."""
        return f"{NAMESPACE}/{self.group}/{kind}/{self.node}/{device}"


def overview(section: SparkplugSection, site: Site) -> list[str]:
    """List every topic that a site publishes under and listens to, for the integrator."""
    topics = Topics(section.group_id, section.edge_node_id or site.config.gateway.name)
    listed = [topics.of_node(kind) for kind in ("NBIRTH", "NDATA", "NDEATH", "NCMD")]
    listed += [state(section.primary_host)] if section.primary_host is not None else []
    for drive in site.drives:
        kinds = ["DBIRTH", "DDATA", "DDEATH"]
        kinds += ["DCMD"] if section.commands and drive.is_commanded_by("sparkplug") else []
        listed += [topics.of_device(kind, drive.name) for kind in kinds]
    return listed


def state(host: str) -> str:
    """Return the topic at which a host application says whether it is online."""
    return f"{NAMESPACE}/STATE/{host}"
