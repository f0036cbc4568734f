"""One end of the two-ended relay: what it offers, what it wants, and what it refuses."""

from __future__ import annotations

import logging
import time
from collections import deque
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from arpd import __version__
from arpd.endpoint.lane import SMALL_BYTES, Lane
from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.relay import RelaySummary
from arpd.relay.ends.announced import AnnouncedParticipants
from arpd.relay.ends.calls import Calls
from arpd.relay.ends.ghosts import GhostNodes
from arpd.relay.ends.incoming import Incoming
from arpd.relay.ends.link import LINK_QOS, LinkReader, LinkThread
from arpd.relay.ends.link_topic import LinkOutgoing
from arpd.relay.ends.offers import EndState, TopicOffer, decode_state, encode_state
from arpd.relay.ends.survey import Survey
from arpd.relay.partner import EVERY_S, Partner
from arpd.relay.selection import Side
from arpd.relay.status import MOST_NAMED, status_line, topics_of
from arpd.ros.graph_view import ON_EVERY_NODE, GraphView
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample, octets
from arpd.ros.rcl import no_publisher_events, rcl

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings

log = logging.getLogger(__name__)
_LOOK_S = 0.5  # the graph of the local domain
_PLANS_S = 5.0  # between changes of the plans that it tells: each is a message on the link
_SETTLE_S = 1.0  # before it offers anything: until then an end that has just started sees a part of its graph only
_PARTICIPANT = 24  # digits of a GUID that name its process
_LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
_ALIVE = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_SIGNS = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)
#: In the place of a state while there is no other end.
NOBODY = EndState(session=0, serial=0)


class End:
    """Tells the other end what is offered and wanted here, and does what that one tells it.

    Parameters
    ----------
    node, link_node : its nodes in the local domain and in that of the link
    settings : the relay's settings, the same on both ends
    is_far : whether this is the base computer's end
    host : name of this host
    session : of this process, 32 random bits, not 0
    on_change : called with the status line at the start and whenever it changes
    """

    def __init__(
        self,
        node: Node,
        link_node: Node,
        settings: RelaySettings,
        *,
        is_far: bool,
        host: str,
        session: int,
        on_change: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._settings, self._is_far, self._on_change, self._clock = settings, is_far, on_change, clock
        self._node, self._link_node = node, link_node
        self._side = Side.of(settings, is_far=is_far)
        self._view, self._link_view = GraphView.of(node), GraphView.of(link_node)
        self._announced = AnnouncedParticipants(node.context.get_domain_id())
        self._is_shared = False  # whether both ends are in one domain
        self._others: list[str] = []  # nodes in the link domain that are not arpd's
        self._partner = Partner()
        self._there = NOBODY  # the other end's state that this end follows
        self._fault = ""  # of the other end's messages
        self._arrived: deque[bytes | int] = deque(maxlen=1000)  # states, and the sessions of signs of life
        self._offers: dict[str, TopicOffer] = {}
        self._plans: dict[str, tuple[int, int]] = {}  # DEPTH and DEADLINE that it tells, by the name on the link
        self._plans_s = 0.0  # when it may tell others
        self._refused: dict[str, str] = {}
        self._differ: dict[str, str] = {}  # topics whose type differs between the sides
        self._told = EndState(
            session=session,
            serial=0,
            host=host,
            arpd=__version__,
            link_gids=self._link_view.own.participant.hex(),
            local_gids=self._view.own.participant.hex(),
        )
        self._begun_s = self._look_s = clock()
        self._status, self._summary_s = "", 0.0  # as last told, and when the daemon's next summary is due
        role, other = ("base", "robot") if is_far else ("robot", "base")
        states, small, signs, calls = (
            rcl().outlet(
                link_node.create_publisher(
                    UInt8MultiArray, f"/arpd/relay/{role}{ending}", qos, event_callbacks=no_publisher_events()
                ).handle
            )
            for ending, qos in (("", _LATCHED), ("/small", LINK_QOS), ("/alive", _ALIVE), ("/calls", LINK_QOS))
        )
        self.link = LinkThread(session, state=states.publish, sign=signs.publish, together=small.publish, clock=clock)
        # Two threads, so that what comes from the link does not wait for the nodes here; calls have a third.
        self.outgoing_thread, self.incoming_thread = ReadingThread(), ReadingThread()
        self._nodes = GhostNodes(node)
        self.survey = Survey(node, is_of_interest=self._is_of_interest, clock=clock)
        self.incoming = Incoming(
            link_node=link_node,
            nodes=self._nodes,
            thread=self.incoming_thread,
            link=self.link,
            side=self._side,
            depths=settings.depths,
            clock=clock,
        )
        self.outgoing = LinkOutgoing(
            link_node,
            self.link,
            node=node,
            survey=self.survey,
            thread=self.outgoing_thread,
            local_name=self._side.local_name,
            settings=settings,
            clock=clock,
        )
        # A topic of weight 1 in the paced queue, of which none is dropped.
        self._call_lane = Lane(calls.publish, is_kept=True)
        self.link.add(self._call_lane)
        self._calls = Calls(
            node,
            self._nodes,
            self._send_call,
            session=session,
            side=self._side,
            timeout_s=settings.call_timeout_s,
            clock=clock,
        )
        reader = partial(RawReader, link_node, UInt8MultiArray, thread=self.incoming_thread)
        chunks = partial(LinkReader, link_node, link=self.link, thread=self.incoming_thread, clock=clock)
        self._readers: list[RawReader | LinkReader] = [
            reader(f"/arpd/relay/{other}", _LATCHED, deliver=lambda sample: self._arrived.append(sample.data)),
            reader(f"/arpd/relay/{other}/alive", _SIGNS, deliver=self._hear_sign),
            chunks(f"/arpd/relay/{other}/small", deliver=self.incoming.deliver, is_together=True),
            chunks(
                f"/arpd/relay/{other}/calls",
                deliver=lambda record, chunk, _age_s: self._calls.arrived(chunk.session, record),
            ),
        ]
        publishing = NodePublishers.of(link_node).thread
        #: None may hang.
        self.threads = (publishing, self.link, self.outgoing_thread, self.incoming_thread, self._calls.thread)
        self.link.start()

    def close(self) -> None:
        """Destroy everything in both domains."""
        self._announced.close()
        self.link.stop()
        for reader in self._readers:
            reader.destroy()
        self._calls.close()
        self.outgoing.forget()
        self.incoming.close()
        self.outgoing_thread.stop()
        self.incoming_thread.stop()
        self._nodes.close()

    def _is_of_interest(self, local: str) -> bool:
        name = self._side.robot_name(local)
        return name is not None and (name in self._there.topics or self._side.may_leave(name))

    # -- one tick

    def tick(self) -> None:
        """Follow the graph and the other end; call it ten times a second."""
        now_s = self._clock()
        self._hear(now_s)
        if now_s >= self._look_s:
            self._look_s = now_s + _LOOK_S
            self.survey.look()
            self._offers = self._survey_offers()
            self._others = self._nodes_of_others()
            self._follow(now_s)
        self.incoming.step(is_reachable=self._partner.is_reachable(now_s))
        self.outgoing.step(self._offers)
        if now_s - self._begun_s >= _SETTLE_S:
            self._tell()
        self._report(now_s)

    def _hear(self, now_s: float) -> None:
        """Take what the other end has sent."""
        is_new = False
        while self._arrived:
            arrived = self._arrived.popleft()
            if isinstance(arrived, int):
                self._partner.hear(arrived, now_s)
                continue
            before, self._fault = self._fault, ""
            try:
                state = decode_state(octets(arrived))
                self._partner.hear(state.session, now_s, state)
                is_new = True
            except ValueError as fault:
                self._fault = str(fault)
            if self._fault not in {"", before}:
                log.error("the other end: %s", self._fault)
        if is_new:
            self._follow(now_s)

    def _follow(self, now_s: float) -> None:
        """Do what the newest state of the other end asks."""
        self._partner.look(now_s)
        before, self._there = self._there, self._partner.state or NOBODY
        state = self._there
        # In one domain, its ghosts would be in this graph, too.
        self._is_shared = state.local_gids in {each.hex() for each in self._view.participants}
        if self._is_shared or not self._partner.is_reachable(now_s):
            self._calls.offered = {}, None  # calls fail at once; topics bridge an outage
        else:
            self._calls.offered = state.services, state.session
        if state.session != before.session:
            self.link.follow(state.session)
            if state is NOBODY:
                self.outgoing.forget()
            else:
                self.outgoing.meet(state.link_gids)
                log.info("the other end is %s (arpd %s), session %08x", state.host, state.arpd, state.session)
        accepted, refused = {}, {}
        announced = self._announced.recent()
        for name, offer in state.topics.items():
            if reason := self._reason_against(name, offer, announced):
                refused[name] = reason
            else:
                accepted[name] = offer
        self.incoming.follow(accepted, refused=refused)
        self.outgoing.follow(frozenset() if self._is_shared else state.wants, self._offers)
        self._note_other_types(accepted)
        self._note_refusals(
            {**refused, **self.incoming.refused, **self.outgoing.refused, **self._calls.refused, **self._conflicts()}
        )

    def _reason_against(self, name: str, offer: TopicOffer, announced: Collection[str]) -> str:
        """Return why a topic of the other side does not enter here; empty if it does."""
        if self._is_shared:
            return "both ends are in one ROS domain"
        if not self._side.may_enter(name):
            return "the configuration of this end does not let it in; give both ends one file"
        here = self.survey.gids(self._side.local_name(name))
        for writer in offer.writers:
            if writer.gid in here or writer.gid[:_PARTICIPANT] in announced:
                return (
                    f"{writer.node} of the other side is visible in this domain without the relay; give the two sides "
                    "different ROS_DOMAIN_IDs, or its nodes ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
                )
        return ""

    def _note_other_types(self, accepted: Mapping[str, TopicOffer]) -> None:
        """Name the topics that nodes here use with another type than the other side."""
        differ = {}
        for name, offer in accepted.items():
            if others := sorted(set(self._view.types.get(self._side.local_name(name), ())) - {offer.type_name}):
                differ[name] = f"it is {offer.type_name} there and {', '.join(others)} here"
        for name in differ.keys() - self._differ.keys():
            log.warning("%s: %s; nodes of two types do not hear each other", name, differ[name])
        self._differ = differ

    def _conflicts(self) -> dict[str, str]:
        return {
            name: f"it has more than one type here: {', '.join(surveyed.types)}"
            for local, surveyed in self.survey.topics.items()
            if len(surveyed.types) > 1 and (name := self._side.robot_name(local)) is not None
        }

    def _survey_offers(self) -> dict[str, TopicOffer]:
        now_s, plans = self._clock(), self.outgoing.plans
        if plans != self._plans and now_s >= self._plans_s:
            self._plans, self._plans_s = plans, now_s + _PLANS_S
        offers = {}
        for local, surveyed in self.survey.topics.items():
            name = self._side.robot_name(local)
            if name is not None and surveyed.writers and self._side.may_leave(name):
                link_name = self.outgoing.link_name(name)
                depth, deadline_ns = self._plans.get(link_name, (0, 0))
                offers[name] = TopicOffer(
                    type_name=surveyed.type_name,
                    writers=self.outgoing.living(name, surveyed.writers.values()),
                    link_name=link_name,
                    type_hash=surveyed.type_hash,
                    planned_depth=depth,
                    planned_deadline_ns=deadline_ns,
                )
        return offers

    def _tell(self) -> None:
        """Send this end's state if it has changed."""
        state = replace(
            self._told,
            topics=self._offers,
            services=self._calls.offers,
            wants=self.incoming.wants,
            refused=self._refused,
        )
        if state != self._told or not state.serial:
            self._told = state = replace(state, serial=state.serial + 1)
            self.link.tell(encode_state(state))

    def _send_call(self, record: bytes, source: int) -> None:
        """Let a record wait for its turn, in the place of one of this source; a large one on its way is not repeated.

        Calls repeat themselves once a second, and a large answer takes longer.
        """
        if len(record) <= SMALL_BYTES or not self.link.is_sending(self._call_lane, source):
            self.link.offer(self._call_lane, record, source=source)

    # -- status

    def _report(self, now_s: float) -> None:
        relay = self._summary(now_s)
        status = status_line(
            relay,
            is_far=self._is_far,
            is_met=self._there is not NOBODY,
            is_shared=self._is_shared,
            second_ends=self._partner.others(now_s),
        )
        is_news, self._status = status != self._status, status
        if is_news:
            self._on_change(status)
        if not self._is_far and (is_news or now_s >= self._summary_s):
            self._summary_s, told = now_s + EVERY_S, NodePublishers.of(self._link_node)
            told.relay = relay
            if is_news:
                told.hurry()

    def _summary(self, now_s: float) -> RelaySummary:
        here, there = replace(self._told, refused=self._refused), self._there
        robot, base = (there, here) if self._is_far else (here, there)
        return RelaySummary(
            other_host=there.host,
            is_reachable=self._partner.is_reachable(now_s),
            fault=self._fault,
            to_base=topics_of(robot, base),
            to_robot=topics_of(base, robot),
            received=self.incoming.received,
            doubled=self.incoming.doubled,
            unknown=self.incoming.unknown,
            outdated=self.incoming.outdated,
            link_bytes=self.link.link_bytes,
            incomplete=self.outgoing.incomplete,
            calls_failed=dict(self._calls.failures),
            strangers=tuple(self._others),
            types_differ=self._differ,
        )

    def _nodes_of_others(self) -> list[str]:
        self._link_view.look()
        writers = self._link_view.writers(ON_EVERY_NODE)
        names = sorted({writer.node.removeprefix("/") for writer in writers} - {""})
        return [name for name in names if not name.startswith("arpd") and name != self._link_node.get_name()][
            :MOST_NAMED
        ]

    def _note_refusals(self, refused: dict[str, str]) -> None:
        for name, reason in refused.items():
            if self._refused.get(name) != reason:
                log.error("cannot carry %s: %s; the other topics are not affected", name, reason)
        self._refused = refused

    def _hear_sign(self, sample: Sample) -> None:
        with suppress(ValueError):  # of another version, which its state says, too
            self._arrived.append(self.link.hear(octets(sample.data)))
