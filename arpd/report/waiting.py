"""Next steps of a robot that starts: what the daemon waits for, and who can bring it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from arpd.model.link import CapacityKind
from arpd.model.observation import MessageKind, MessageRefusal
from arpd.model.settings import AUTO
from arpd.report.conditions import Condition
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from arpd.model.relay import RelaySummary
    from arpd.report.snapshot import Snapshot

_LIST = "arpd topics lists what there is"
# DDS in nodes that stay on their host finds nobody by an address that has gone.
_ENVIRONMENT = (
    " (again, if an address of its computer has changed since)"
    " with the ROS_DOMAIN_ID, ROS_AUTOMATIC_DISCOVERY_RANGE and FASTDDS_BUILTIN_TRANSPORTS of /etc/default/arpd"
)


def first_plan(snapshot: Snapshot) -> str:
    """Say why the topics that cross the link have no plan yet."""
    crossing = {publisher.topic for publisher in snapshot.observation.publishers if publisher.direction != "local"}
    why = f"arpd is still measuring the link for {count(len(crossing), 'topic')}"
    return f"{why}; the first plan follows within seconds"


def topics(snapshot: Snapshot) -> str:
    """Say why there is no topic to plan for, and the next step."""
    observation, settings = snapshot.observation, snapshot.settings
    # With two ends a topic of the other computer is read by the end here.
    is_met = settings.relay.link_domain is None or (observation.relay and observation.relay.is_reachable)
    if observation.publishers and is_met:
        names = listed(sorted({publisher.topic for publisher in observation.publishers}))
        return f"no node on the other side of the link reads {names}; start one there{_where(snapshot)}"
    if settings.relay.link_domain is not None:
        return _of_two_ends(observation.relay)
    if settings.relay.topics:
        names = listed([settings.relay.prefix + name for name in settings.relay.topic_names])
        start = f"start arpd-relay, and the nodes whose topics it carries{_where(snapshot)}"
        return f"the relay does not publish {names} yet; {start}"
    where, file = _where(snapshot), snapshot.config_path or "the configuration"
    if settings.topics:
        names = listed([topic.name for topic in settings.topics])
        return f"no AdaptivePublisher{where} has a topic that {file} names ({names}); start its node; {_LIST}"
    return (
        f"no AdaptivePublisher is found{where}, and the relay has nothing to carry; "
        f"use AdaptivePublisher in your nodes, or write relay: into {file}; {_LIST}"
    )


def is_reported(snapshot: Snapshot) -> bool:
    """Return whether a peer reports."""
    return any(age_s < Condition.PEER_LOST.holds_s for age_s in snapshot.observation.peer_ages_s.values())


def is_lost(snapshot: Snapshot) -> bool:
    """Return whether a peer that is needed reported once; one that is forgotten is still lost."""
    was_there = snapshot.observation.peer_ages_s or any(
        each.condition is Condition.PEER_LOST for each in snapshot.found
    )
    return bool(was_there) and snapshot.link.kind is not CapacityKind.CONFIGURED


def peer(snapshot: Snapshot) -> str:
    """Say why no peer reports and the next step, empty while one reports."""
    observation = snapshot.observation
    if is_reported(snapshot):
        return ""
    without = _WITHOUT_PEER[snapshot.link.kind]  # without its number, which would change systemd's line too often
    if observation.peer_ages_s:
        return f"{listed([*observation.peer_ages_s])} reports no more, so {without}; see journalctl -u arpd-peer there"
    if observation.peers:
        many = "a peer is" if observation.peers == 1 else f"{observation.peers} peers are"
        if observation.refused.get((MessageKind.REPORTS, MessageRefusal.MALFORMED)):
            return f"{many} in the graph, of another version, so {without}; install one arpd on both computers"
        return f"{many} in the graph, but no report arrives, so {without}; see journalctl -u arpd-peer there"
    start = f"start arpd-peer on the other computer{_where(snapshot)}: sudo systemctl enable --now arpd-peer"
    if AUTO == snapshot.settings.link.interface != snapshot.interface:
        return f"{without}; {start}; is {snapshot.interface} the link? (link.interface is auto)"
    return f"{without}; {start}"


_WITHOUT_PEER = {
    CapacityKind.CONFIGURED: "nothing checks what link.capacity or link.initial_capacity says",
    CapacityKind.RADIO: "the capacity is a guess from the radio's bit rate",
    CapacityKind.LOCAL: "the capacity is known from this computer's own queue alone",
    CapacityKind.PEER: "the capacity is what a peer saw last",
}


def _of_two_ends(relay: RelaySummary | None) -> str:
    if relay is None or not relay.is_reachable:
        return "topics cross once both ends of the relay run"
    offered, wanted = (relay.to_base.offered + relay.to_robot.offered, relay.to_base.wanted + relay.to_robot.wanted)
    if wanted:
        return f"the relay begins to carry {count(wanted, 'topic')}"
    if offered:
        beside = " beside those that it refuses" if relay.to_base.refused or relay.to_robot.refused else ""
        could = f"the relay could carry {count(offered, 'topic')}{beside}, and no node on the other side reads one"
        return f"{could}; start a reader there{_ENVIRONMENT}; {_LIST}"
    return f"the relay finds no topic on either side; start each of your nodes{_ENVIRONMENT}"


def _where(snapshot: Snapshot) -> str:
    """Name the ROS domain of nodes and peers, unless it is the relay's, which no user starts a node in."""
    domain = snapshot.observation.domain
    return "" if domain is None or snapshot.settings.relay.link_domain is not None else f" in ROS domain {domain}"
