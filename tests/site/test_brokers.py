"""Several brokers in a configuration: how they are written, and what is wrong with them in fact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from gateway import site
from gateway.config import SparkplugSection
from gateway.errors import BadConfig
from gateway.site import Site

PLANT = {"name": "plant", "url": "mqtt://plant"}
CLOUD = {"name": "cloud", "url": "wss://cloud.example/mqtt", "user": "hall", "keep_alive": "60s"}
DRIVE: dict[str, Any] = {"name": "pump-1", "number": 1, "model": "vf-nc3"}


def build(mqtt: object = None, sparkplug: object = None, **drive: object) -> Site:
    """Return the site of a configuration; BadConfig where it is wrong."""
    table: dict[str, Any] = {
        "gateway": {"name": "hall-3"},
        "line": [{"name": "a", "port": "/dev/null", "drive": [{**DRIVE, **drive}]}],
        **({} if mqtt is None else {"mqtt": mqtt}),
        **({} if sparkplug is None else {"sparkplug": sparkplug}),
    }
    return site.build(table, "test", Path())


def wrong(mqtt: object = None, sparkplug: object = None, **drive: object) -> str:
    """Return what is wrong with a configuration."""
    with pytest.raises(BadConfig) as raised:
        build(mqtt, sparkplug, **drive)
    return str(raised.value)


def edge(mqtt: object, **sparkplug: object) -> SparkplugSection:
    """Return Sparkplug as it is configured beside some brokers."""
    found = build(mqtt, {"group_id": "g", **sparkplug}).config.sparkplug
    assert found is not None
    return found


def test_one_broker_is_a_table_and_several_are_a_list() -> None:
    """In the order of the file; one without a name is as it ever was."""
    (only,) = build({"url": "mqtt://plant"}).config.brokers
    assert (only.origin, only.label, only.channel) == ("", "mqtt://plant", "gateway.mqtt")
    first, second = build([PLANT, CLOUD]).config.brokers
    assert (first.origin, second.origin) == ("plant", "cloud")
    assert second.label == "cloud (wss://cloud.example/mqtt)"
    assert second.channel == "gateway.mqtt.cloud"
    assert build().config.brokers == ()
    assert "mqtt" in wrong([])


def test_each_of_several_has_a_name_of_its_own() -> None:
    """One alone needs none, in a list either."""
    assert "mqtt[1].name: is missing" in wrong([PLANT, {"url": "mqtt://other"}])
    assert "mqtt[1] (plant).name: 'plant' is taken by mqtt[0] (plant)" in wrong([PLANT, {**CLOUD, "name": "plant"}])
    assert build([{"url": "mqtt://plant"}]).config.brokers[0].origin == ""


def test_two_brokers_are_not_one() -> None:
    """They would throw each other out, or send everything twice; with a base of its own each is let be."""
    twice = [PLANT, {**CLOUD, "url": "mqtt://plant/"}]
    assert "mqtt[1] (cloud).base: 'tosvert' is taken by mqtt[0] (plant) at the same broker" in wrong(twice)
    assert len(build([PLANT, {**twice[1], "base": "other"}]).config.brokers) == 2
    named = [{**PLANT, "client_id": "x"}, {**twice[1], "base": "other", "client_id": "x"}]
    assert "mqtt[1] (cloud).client_id: 'x' is taken" in wrong(named)


@pytest.mark.parametrize(
    ("mqtt", "said"),
    [
        ({"url": "http://h"}, "mqtt.url: a broker is wanted"),
        ({"ulr": "mqtt://h"}, "mqtt.ulr: unknown key; did you mean 'url'?"),
        ([PLANT, {**CLOUD, "tls": {"cafile": "x"}}], "mqtt[1].tls.cafile (cloud): unknown key"),
        ([PLANT, {**CLOUD, "filtr": []}], "mqtt[1].filtr (cloud): unknown key; did you mean 'filter'?"),
        ([{"name": "a"}], "mqtt[0].url (a): is missing"),
        ("mqtt://h", "mqtt:"),
        ([PLANT, {**CLOUD, "deadband": {"speeed": 1.0}}], "mqtt[1] (cloud).deadband: no configured drive"),
        ({"url": "mqtt://h/path"}, "a path is for WebSockets only"),
        ({"url": "ws://h/mqtt", "tls": {"ca": "ca.pem"}}, "tls is given but the url is not mqtts:// or wss://"),
        ({"url": "wss://h/mqtt#x"}, "nothing can stand behind a #"),
        ({"url": "wss://a:b@h/mqtt"}, "user and password do not belong into the URL"),
    ],
)
def test_what_is_wrong_is_named_by_broker_and_key(mqtt: object, said: str) -> None:
    """As it stands in the file, with what would be right."""
    assert said in wrong(mqtt)


def test_sparkplug_takes_the_connection_of_a_broker() -> None:
    """The first, or the one that it names; what it says itself stays, and its names are its own."""
    assert edge({**PLANT, "client_id": "mine"}).url == "mqtt://plant"
    assert edge({**PLANT, "client_id": "mine"}).client_id is None
    found = edge([PLANT, CLOUD], broker="cloud", keep_alive="10s")
    assert (found.url, found.user, found.keep_alive) == ("wss://cloud.example/mqtt", "hall", 10.0)
    own = edge({**PLANT, "user": "hall"}, url="mqtt://own")
    assert (own.url, own.user) == ("mqtt://own", None)


def test_sparkplug_names_a_broker_that_is_there() -> None:
    """And has no url besides; without any it says what is missing."""
    named = {"group_id": "g", "broker": "clod"}
    assert "no broker is called 'clod'; known: plant, cloud" in wrong([PLANT, CLOUD], named)
    both = {"group_id": "g", "broker": "plant", "url": "mqtt://own"}
    assert "give one of the two" in wrong([PLANT, CLOUD], both)
    assert "there is no [mqtt] to take it from" in wrong(None, {"group_id": "g"})


def test_a_right_names_a_broker_that_is_there() -> None:
    """Else nobody would have it."""
    right = {"source": "mqtt", "broker": "clowd"}
    assert "right[0].broker: no broker is called 'clowd'; known: plant, cloud" in wrong([PLANT, CLOUD], right=[right])
    assert "none has a name" in wrong({"url": "mqtt://h"}, right=[right])
    assert build([PLANT, CLOUD], right=[{**right, "broker": "cl*"}])
