"""Says under which topic everything of Sparkplug B is published and heard (Sparkplug 3.0, 4.1). Pure."""

from __future__ import annotations

from dataclasses import dataclass

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


def state(host: str) -> str:
    """Return the topic at which a host application says whether it is online."""
    return f"{NAMESPACE}/STATE/{host}"
