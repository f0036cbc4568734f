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
from arpd.endpoint.node_publishers import NodePublishers
from arpd.model.relay import RelaySummary
from arpd.relay.ends.announced import AnnouncedParticipants
from arpd.relay.ends.calls import Calls
from arpd.relay.ends.ghosts import GhostNodes
from arpd.relay.ends.incoming import Incoming
from arpd.relay.ends.link_reader import CallLink, LinkReader
from arpd.relay.ends.link_thread import LinkThread
from arpd.relay.ends.link_topic import LinkOutgoing
from arpd.relay.ends.survey import Survey
from arpd.relay.offers import EndState, OtherVersionError, TopicOffer, decode_state, encode_state
from arpd.relay.partner import EVERY_S, Partner
from arpd.relay.selection import Side
from arpd.relay.status import MOST_NAMED, status_line, topics_of
from arpd.ros.graph_view import ON_EVERY_NODE, GraphView
from arpd.ros.raw_reader import RawReader, ReadingThread, Sample, octets
from arpd.ros.rcl import rcl

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from rclpy.node import Node

    from arpd.model.settings import RelaySettings

log = logging.getLogger(__name__)
_LOOK_S = 0.5  # the graph of the local domain
_PLANS_S = 5.0  # between changes of the plans that it tells: each is a message on the link
_SETTLE_S = 1.0  # before it offers anything: until then an end that has just started sees a part of its graph only
_LATCHED = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)
_ALIVE = QoSProfile(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_SMALL = QoSProfile(depth=1000)
_SIGNS = QoSProfile(depth=10, reliability=QoSReliabilityPolicy.BEST_EFFORT)


class End:
    """Tells the other end what is offered and wanted here, and does what that one tells it.

    Parameters
    ----------
    node, link_node : its nodes in the local domain and in that of the link
    settings : the relay's settings, the same on both ends
    is_far : whether this is the base computer's end
    host : name of this host
    session : number of this process, 32 random bits
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
        self._settings = settings
        self._is_far = is_far
        self._host = host
        self._on_change = on_change
        self._clock = clock
        self._side = Side.of(settings, is_far=is_far)
        self._view = GraphView.of(node)
        self._own_gids = self._view.own.participant.hex()
        self._announced = AnnouncedParticipants(node.context.get_domain_id())
        self._is_shared = False  # whether both ends are in one domain
        self._others: list[str] = []  # nodes in the link domain that are not arpd's
        self._link_view = GraphView.of(link_node)
        self._partner = Partner()
        self._partner_session = ""
        self._fault = ""  # of the other end's messages
        self._arrived: deque[bytes | int] = deque(maxlen=1000)  # states, and the sessions of signs of life
        self._offers: dict[str, TopicOffer] = {}
        self._plans: dict[str, tuple[int, int]] = {}  # DEPTH and DEADLINE that it tells, by the name on the link
        self._plans_s = 0.0  # when it may tell others
        self._offered_to_us: Mapping[str, TopicOffer] = {}
        self._refused: dict[str, str] = {}
        self._differ: dict[str, str] = {}  # topics whose type differs between the sides
        self._told = EndState(session=f"{session:016x}", serial=0)
        self._begun_s = self._look_s = clock()
        role, other = ("base", "robot") if is_far else ("robot", "base")
        self._states, small, signs = (
            link_node.create_publisher(UInt8MultiArray, f"/arpd/relay/{role}{ending}", qos)
            for ending, qos in (("", _LATCHED), ("/small", _SMALL), ("/alive", _ALIVE))
        )
        sign, together = (rcl().outlet(publisher.handle).publish for publisher in (signs, small))
        self.link = LinkThread(session, sign=sign, together=together, clock=clock)
        # Two threads, so that what comes from the link does not wait for the nodes here; calls have a third.
        self.outgoing_thread, self.incoming_thread = ReadingThread(), ReadingThread()
        self._nodes = GhostNodes(node)
        self._link_node = link_node
        self.survey = Survey(node, is_of_interest=self._is_of_interest)
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
        topics = {"own": f"/arpd/relay/{role}/calls", "other": f"/arpd/relay/{other}/calls"}
        calls = CallLink(link_node, self.link, self.incoming_thread, **topics)
        self._calls = Calls(
            node,
            self._nodes,
            calls,
            session=session,
            side=self._side,
            timeout_s=settings.call_timeout_s,
            clock=clock,
        )
        reader = partial(RawReader, link_node, UInt8MultiArray, thread=self.incoming_thread)
        self._readers: list[RawReader | LinkReader] = [
            reader(f"/arpd/relay/{other}", _LATCHED, deliver=lambda sample: self._arrived.append(sample.data)),
            reader(f"/arpd/relay/{other}/alive", _SIGNS, deliver=self._hear_sign),
            LinkReader(
                link_node,
                f"/arpd/relay/{other}/small",
                link=self.link,
                thread=self.incoming_thread,
                deliver=self.incoming.deliver_together,
                is_together=True,
            ),
        ]
        publishing = NodePublishers.of(link_node).thread
        #: None may hang.
        self.threads = (publishing, self.link, self.outgoing_thread, self.incoming_thread, self._calls.thread)
        self._status, self._summary_s = "", 0.0  # as last told, and when the daemon's next summary is due
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
        return name is not None and (name in self._offered_to_us or self._side.may_leave(name))

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
                self._partner.hear(f"{arrived:016x}", now_s)
                continue
            try:
                state = decode_state(octets(arrived))
                self._partner.hear(state.session, now_s, state)
                is_new = True
                self._fault = ""
            except OtherVersionError as fault:
                self._note_fault(str(fault))
            except ValueError as fault:
                self._note_fault(f"its message is not understood ({fault})")
        if is_new:
            self._follow(now_s)

    def _follow(self, now_s: float) -> None:
        """Do what the newest state of the other end asks."""
        self._partner.look(now_s)
        state = self._partner.state
        # In one domain, its ghosts would be in this graph, too.
        self._is_shared = state is not None and state.local_gids in {each.hex() for each in self._view.participants}
        if state is None or self._is_shared or not self._partner.is_reachable(now_s):
            self._calls.offered = {}, None  # calls fail at once; topics bridge an outage
        else:
            self._calls.offered = state.services, int(state.session, 16) & 0xFFFFFFFF
        if state is None:
            if self._partner_session:
                self._partner_session = ""
                self.link.follow(0)
                self.outgoing.forget()
                self._offered_to_us = {}
                self._refused, self._differ = {}, {}
            self.incoming.follow({}, session=0)
            return
        if state.session != self._partner_session:
            self._partner_session = state.session
            self.link.follow(int(state.session, 16))
            self.outgoing.meet(state.link_gids)
            log.info("the other end is %s (arpd %s), session %s", state.host, state.arpd, state.session)
        self._offered_to_us = state.topics
        accepted = {}
        refused = {}
        announced = self._announced.recent()
        for name, offer in state.topics.items():
            if self._is_shared:
                refused[name] = "both ends are in one ROS domain"
            elif reason := self._reason_against(name, offer, announced):
                refused[name] = reason
            else:
                accepted[name] = offer
        self.incoming.follow(accepted, session=int(state.session, 16) & 0xFFFFFFFF, refused=refused)
        self.outgoing.follow(frozenset() if self._is_shared else state.wants, self._offers)
        self._note_other_types(accepted)
        self._note_refusals(
            {**refused, **self.incoming.refused, **self.outgoing.refused, **self._calls.refused, **self._conflicts()}
        )

    def _reason_against(self, name: str, offer: TopicOffer, announced: Collection[str]) -> str:
        """Return why a topic of the other side does not enter here; empty if it does."""
        if not self._side.may_enter(name):
            return "the configuration of this end does not let it in; give both ends one file"
        here = self.survey.gids(self._side.local_name(name))
        for writer in offer.writers:
            if writer.gid in here or writer.gid[: len(self._own_gids)] in announced:
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
                link_name, member = self.outgoing.names.of(name)
                depth, deadline_ns = self._plans.get(link_name, (0, 0))
                offers[name] = TopicOffer(
                    type_name=surveyed.type_name,
                    writers=self.outgoing.living(name, surveyed.writers.values()),
                    link_name=link_name,
                    member=member,
                    type_hash=surveyed.type_hash,
                    planned_depth=depth,
                    planned_deadline_ns=deadline_ns,
                )
        return offers

    def _tell(self) -> None:
        """Send this end's state if it has changed."""
        state = EndState(
            session=self._told.session,
            serial=self._told.serial,
            host=self._host,
            arpd=__version__,
            topics=self._offers,
            services=self._calls.offers,
            wants=self.incoming.wants,
            refused=self._refused,
            link_gids=self._link_view.own.participant.hex(),
            local_gids=self._own_gids,
        )
        if state != self._told:
            self._told = state = replace(state, serial=state.serial + 1)
            self.link.send(rcl().outlet(self._states.handle).publish, encode_state(state))

    # -- status

    def _report(self, now_s: float) -> None:
        relay = self._summary(now_s)
        status = status_line(
            relay,
            is_far=self._is_far,
            is_met=self._partner.state is not None,
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
        here, there = replace(self._told, refused=self._refused), self._partner.state or EndState(session="", serial=0)
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

    def _note_fault(self, words: str) -> None:
        if words != self._fault:
            log.error("the other end: %s", words)
        self._fault = words

    def _note_refusals(self, refused: dict[str, str]) -> None:
        for name, reason in refused.items():
            if self._refused.get(name) != reason:
                log.error("cannot carry %s: %s; the other topics are not affected", name, reason)
        self._refused = refused

    def _hear_sign(self, sample: Sample) -> None:
        with suppress(ValueError):  # of another version, which its state says, too
            self._arrived.append(self.link.hear(octets(sample.data)))
