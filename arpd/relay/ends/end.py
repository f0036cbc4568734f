"""One end of the two-ended relay: what it offers, what it wants, and what it refuses."""

from __future__ import annotations

import logging
import platform
import secrets
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd import __version__
from arpd.endpoint.node_publishers import NodePublishers
from arpd.host.discovery import AnnouncedParticipants
from arpd.model.errors import LinkError
from arpd.model.relay import RelaySummary
from arpd.relay.ends.calls import Calls
from arpd.relay.ends.ghosts import GhostNodes
from arpd.relay.ends.incoming import Incoming
from arpd.relay.ends.link import STATE_QOS, LinkReader, LinkThread, LinkTopic, lasting_s
from arpd.relay.ends.offers import EndState, TopicOffer, decode_state, encode_state
from arpd.relay.ends.outgoing import Outgoing
from arpd.relay.envelope import WRAP
from arpd.relay.partner import Partner
from arpd.relay.selection import Side
from arpd.relay.status import MOST_NAMED, ONE_DOMAIN, status_line, topics_of
from arpd.ros.cdr import octets
from arpd.ros.graph import ON_EVERY_NODE, GraphView
from arpd.ros.names import is_arpds
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings

log = logging.getLogger(__name__)
_LOOK_S = 0.5  # the graph of the local domain
_SILENT_S = 10.0
_LINGER_S = 3.0  # an end that has just started wants nothing at first
_SETTLE_S = 1.0  # before it offers anything: until then an end that has just started sees a part of its graph only
_PARTICIPANT = 24  # digits of a GUID that name its process
_SIGNS = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_OWN_DOMAIN = "give each robot a relay.link_domain of its own, and run one arpd relay on it"
#: In the place of a state while there is no other end.
NOBODY = EndState(session=0)


class End:
    """Tells the other end what is offered and wanted here, and does what that one tells it.

    Parameters
    ----------
    node, link_node : its nodes in the local domain and in that of the link
    is_far : whether this is the base computer's end
    on_change : called with the status line at the start and whenever it changes
    """

    def __init__(
        self,
        node: Node,
        link_node: Node,
        settings: RelaySettings,
        *,
        is_far: bool,
        on_change: Callable[[str], None],
    ) -> None:
        self._is_far, self._on_change = is_far, on_change
        self._link_node = link_node
        self._side = Side(settings, is_far=is_far)
        self._view, self._link_view = GraphView.of(node), GraphView.of(link_node)
        self._announced = AnnouncedParticipants(node.context.get_domain_id())
        self._is_shared = False  # whether both ends are in one domain
        self._others: list[str] = []  # nodes in the link domain that are not arpd's
        self._there = NOBODY  # the other end's state that this end follows
        self._fault = ""  # of the other end's messages
        self._logged = ""  # the last fault of the other end that the log has
        self._arrived: deque[bytes | int] = deque(maxlen=1000)  # states, and the sessions of signs of life
        self._refused: dict[str, str] = {}
        session = 1 + secrets.randbelow(WRAP - 1)
        link_gids = self._link_view.own.participant.hex()
        self._partner, self._namespace = Partner(own=link_gids), settings.namespace
        self._new_state = partial(
            EndState,
            session=session,
            host=platform.node(),
            arpd=__version__,
            namespace=self._namespace,
            link_gids=link_gids,
            local_gids=self._view.own.participant.hex(),
        )
        self._told = NOBODY  # this end's state, as the other one was told
        self._begun_s = self._look_s = self._heard_s = lasting_s()
        self._is_silent = False
        self._status = ""  # as last told
        role, other = ("base", "robot") if is_far else ("robot", "base")
        program = "arpd-relay" if is_far else "arpd-relay-far"
        self._sought = f"{program} at {getattr(settings, other) or 'an unknown address'} (relay.{other})"
        self.link = LinkThread(session, link_node, f"/arpd/relay/{role}")
        # Two reading threads, so that what comes from the link does not wait for the nodes here; calls have a third.
        self._reading = thread = ReadingThread()
        chunks = partial(LinkReader, link_node, link=self.link, thread=thread)
        self._nodes = GhostNodes(node)
        self.incoming = Incoming(nodes=self._nodes, reader=chunks, side=self._side, depths=settings.depths)
        self._incomplete = 0  # samples of groups whose set was never complete
        carry = partial(LinkTopic, link_node, thread=self.link, settings=settings, on_drop=self._on_drop)
        self.outgoing = Outgoing(
            node,
            name_of=self._name_of,
            carry=carry,
            settings=settings,
            linger_s=_LINGER_S,
            node_name=self._side.node_name,
        )
        self._calls = Calls(
            node,
            self._nodes,
            self.link.send_call,
            session=session,
            side=self._side,
            timeout_s=settings.call_timeout_s,
        )
        reader = partial(RawReader, link_node, UInt8MultiArray, thread=thread)
        self._readers: list[RawReader] = [
            reader(f"/arpd/relay/{other}", STATE_QOS, deliver=lambda sample: self._arrived.append(sample.data)),
            reader(f"/arpd/relay/{other}/alive", _SIGNS, deliver=self._hear_sign),
            chunks(f"/arpd/relay/{other}/small", deliver=self.incoming.deliver, is_together=True),
            chunks(f"/arpd/relay/{other}/large", deliver=self.incoming.deliver, is_freight=True),
            chunks(f"/arpd/relay/{other}/calls", deliver=self._calls.deliver),
        ]
        publishing = NodePublishers.of(link_node).thread
        #: None may hang.
        self.threads = (publishing, self.link, self.outgoing.thread, thread, self._calls.thread)
        self.link.start()

    def close(self) -> None:
        """Destroy everything in both domains."""
        self._announced.close()
        self.link.stop()
        for reader in self._readers:
            reader.destroy()
        self._calls.close()
        self.outgoing.close()
        self.incoming.close()
        self._reading.stop()
        self._nodes.tidy()

    def _name_of(self, local: str) -> str | None:
        """Return the name on the robot of a topic that may leave this side."""
        name = self._side.robot_name(local)
        return name if name is not None and self._side.may_leave(name) else None

    def _on_drop(self, samples: int) -> None:
        self._incomplete += samples

    # -- one tick

    def tick(self) -> None:
        """Follow the graph and the other end; call it ten times a second.

        Raises LinkError if the other end hears only a new process.
        """
        now_s = lasting_s()
        # Before it hears what came since: while this computer slept, the other end has forgotten it.
        was_there = self._partner.is_there(now_s)
        self._hear(now_s)
        state = self._partner.look(now_s)
        if self._partner.is_deaf(now_s):
            raise LinkError(f"{self._sought} is heard, and hears this process no more; start it again")
        there, is_due = (was_there and state) or NOBODY, now_s >= self._look_s
        if is_due:
            self._look_s = now_s + _LOOK_S
            self.outgoing.look()
            self._others = self._nodes_of_others()
        if is_due or there is not self._there:
            self._follow(there)
        is_reachable = there is not NOBODY and self._partner.is_reachable(now_s)
        # Calls fail while the other end is unreachable; topics and the results of actions bridge an outage.
        services = {} if self._is_shared else self._there.services
        self._calls.offered = services, self._there.session if is_reachable and not self._is_shared else None
        self.incoming.step(is_reachable=is_reachable)
        self.outgoing.step()
        self.link.freight.follow(self.link.queue.flight.freight.held_until_s)
        if now_s - self._begun_s >= _SETTLE_S:
            self._tell()
        if is_due:
            self._report(now_s)

    def _hear(self, now_s: float) -> None:
        while self._arrived:
            arrived = self._arrived.popleft()
            if isinstance(arrived, int):
                self._partner.hear(arrived, now_s)
                continue
            self._fault = ""
            try:
                self._partner.tell(decode_state(octets(arrived), namespace=self._namespace), now_s)
            except ValueError as fault:
                self._fault = str(fault)

    def _follow(self, state: EndState) -> None:
        before, self._there = self._there, state
        self._is_shared = state.local_gids in {each.hex() for each in self._view.participants}
        if state.session != before.session:
            self.link.follow(state.session, state.link_gids)
            self.outgoing.forget_latched()
            if state is not NOBODY:
                log.info("the other end is %s (arpd %s), session %08x", state.host, state.arpd, state.session)
        # In one domain, its ghosts would be in this graph, too.
        topics = {} if self._is_shared else state.topics
        self.incoming.follow(topics, partial(self._reason_against, announced=self._announced.recent()))
        self.outgoing.follow(frozenset() if self._is_shared else state.wants)
        types = {
            name: f"it has more than one type here: {', '.join(each)}"
            for name, each in self.outgoing.several_types().items()
        }
        for name, offer in state.topics.items():
            if others := sorted(set(self._view.types.get(self._side.local_name(name), ())) - {offer.type_name}):
                types[name] = f"nodes here do not hear it: it is {offer.type_name} there and {', '.join(others)} here"
        refused = {**types, **self.incoming.refused, **self.outgoing.refused, **self._calls.refused}
        for name, reason in refused.items():
            if self._refused.get(name) != reason:
                log.error("%s does not cross as it should: %s; the other topics are not affected", name, reason)
        self._refused = refused

    def _reason_against(self, name: str, offer: TopicOffer, *, announced: Collection[str]) -> str:
        """Return why a topic of the other side does not enter here; empty if it does."""
        if not self._side.may_enter(name):
            return "the configuration of this end does not let it in; give both ends one file"
        here = {writer.gid.hex() for writer in self._view.writers(self._side.local_name(name))}
        for writer in offer.writers:
            if writer.gid in here or writer.gid[:_PARTICIPANT] in announced:
                return (
                    f"{writer.node} of the other side is visible in this domain without the relay; give the two sides "
                    "different ROS_DOMAIN_IDs, or its nodes ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST and no "
                    "ROS_STATIC_PEERS"
                )
        return ""

    def _tell(self) -> None:
        state = self._new_state(
            topics=self.outgoing.offers,
            services=self._calls.offers,
            wants=self.incoming.wants,
            refused=self._refused,
            follows=self._there.link_gids,
        )
        if state != self._told:
            self._told = state
            self.link.tell(encode_state(state))

    # -- status

    def _report(self, now_s: float) -> None:
        relay = self._summary(now_s)
        if relay.fault not in {"", self._logged}:
            self._logged = relay.fault
            log.error("the other end cannot be used: %s", relay.fault)
        self._log_silence(now_s, is_heard=relay.is_reachable or relay.fault != "")
        status = status_line(
            relay,
            is_far=self._is_far,
            is_met=self._there is not NOBODY,
            second_ends=self._partner.others(now_s),
        )
        is_news, self._status = status != self._status, status
        if is_news:
            self._on_change(status)
        if not self._is_far:
            told, queue = NodePublishers.of(self._link_node), self.link.queue
            # Read at the last moment: the daemon compares it with what the interface has carried by then.
            told.relay = lambda: replace(relay, link_bytes=queue.link_bytes)
            if is_news:
                told.hurry()

    def _log_silence(self, now_s: float, *, is_heard: bool) -> None:
        if is_heard:
            self._heard_s = now_s
        was_silent, self._is_silent = self._is_silent, now_s - self._heard_s > _SILENT_S
        if self._is_silent and not was_silent:
            log.warning("nothing heard of %s for %g s; does it run, and is the address right?", self._sought, _SILENT_S)
        elif was_silent and not self._is_silent:
            log.info("the other end is heard again")

    def _summary(self, now_s: float) -> RelaySummary:
        here, there = self._told, self._there
        fault = self._fault if there is NOBODY else ""  # another robot's end, perhaps, while the right one works
        is_settled = now_s - self._begun_s > _LINGER_S  # this computer may have had another address
        if there is NOBODY and is_settled and (hosts := self._partner.elsewhere(now_s)):
            another = "base computer's end; a robot has one" if self._is_far else f"robot's end; {_OWN_DOMAIN}"
            fault = f"that of {', '.join(hosts)} serves another {another}"
        if self._is_shared:
            fault = ONE_DOMAIN
        robot, base = (there, here) if self._is_far else (here, there)
        return RelaySummary(
            other_host=there.host,
            is_reachable=self._partner.is_reachable(now_s),
            fault=fault,
            to_base=topics_of(robot, base),
            to_robot=topics_of(base, robot),
            **self.incoming.samples,
            incomplete=self._incomplete,
            calls_failed=dict(self._calls.failures),
            strangers=tuple(self._others),
        )

    def _nodes_of_others(self) -> list[str]:
        self._link_view.look()
        nodes = {writer.node for writer in self._link_view.writers(ON_EVERY_NODE) if not is_arpds(writer.node)}
        names = {node.removeprefix("/") for node in nodes} - {"", self._link_node.get_name()}
        return sorted(names)[:MOST_NAMED]

    def _hear_sign(self, sample: Sample) -> None:
        with suppress(ValueError):  # of another version, which its state says, too
            self._arrived.append(self.link.hear(octets(sample.data)))
