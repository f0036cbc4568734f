"""What the daemon hears of nodes, and of other daemons."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from rclpy.serialization import deserialize_message
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

from arpd.model.observation import MessageKind, MessageRefusal
from arpd.ros.graph import Endpoint
from arpd.ros.names import PRICE_TOPIC, PUBLISHERS_TOPIC
from arpd.ros.node_snapshot import decode_snapshot
from arpd.ros.price_message import decode_price
from arpd.ros.rate_limits import SourceRateLimiter
from arpd.ros.raw_reader import RawReader, octets

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from arpd.model.endpoints import NodeSnapshot
    from arpd.ros.nodes import Nodes
    from arpd.ros.raw_reader import ReadingThread, Sample
    from arpd.ros.refused_messages import RefusedMessages

_QOS = QoSProfile(depth=1000, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_MOST_MESSAGE = 128 * 1024  # bytes: ten times that of MOST_OF_NODE publishers
_MOST_WAITING = 1000  # snapshots between two ticks
_HZ, _BURST = 8.0, 16.0  # snapshots of one node; arpd sends five a second at most
_MOST_PRICE, _PRICES_HZ = 1024, 100.0  # bytes, and messages of one daemon; arpd sends 33 a second at most
_PRICE_SILENT_S = 3.5  # three prices missed: that daemon is gone, or stands by
_MOST_DAEMONS = 32


class NodeSnapshots:
    """Hears what nodes tell, each at its own limited rate; the thread that reads decodes it.

    Parameters
    ----------
    node : the daemon's node
    thread : reads them
    refused : counts refused messages
    clock : monotonic clock (s)
    """

    def __init__(
        self, node: Any, *, thread: ReadingThread, refused: RefusedMessages, clock: Callable[[], float]
    ) -> None:
        self._refused = refused
        self._clock = clock
        self._arrived: deque[tuple[bytes, NodeSnapshot, float]] = deque(maxlen=_MOST_WAITING)
        self._limiter = SourceRateLimiter(rate_hz=_HZ, burst=_BURST)
        RawReader(node, UInt8MultiArray, PUBLISHERS_TOPIC, _QOS, deliver=self.take, thread=thread)

    def drain(self, nodes: Nodes) -> None:
        """Let the nodes take what has arrived."""
        while self._arrived:
            writer, snapshot, at_s = self._arrived.popleft()
            if not nodes.note(writer, snapshot, at_s):
                self._refuse(
                    MessageRefusal.QUOTA, writer, f"too many publishers; those of {snapshot.node} are left out"
                )

    def take(self, sample: Sample) -> None:
        """Take a message."""
        now_s = self._clock()
        if len(sample.data) > _MOST_MESSAGE:
            self._refuse(MessageRefusal.SIZE, sample.writer, "a message is longer than any snapshot of a node")
        elif not self._limiter.lets_pass(sample.writer, now_s):
            words = f"a node tells of its publishers more than {_HZ:g} times a second"
            self._refuse(MessageRefusal.RATE, sample.writer, words)
        else:
            try:
                self._arrived.append((sample.writer, decode_snapshot(octets(sample.data)), now_s))
            except ValueError as fault:
                self._refuse(MessageRefusal.MALFORMED, sample.writer, str(fault))

    def _refuse(self, reason: MessageRefusal, writer: bytes, words: str) -> None:
        self._refused.note(MessageKind.PUBLISHERS, reason, words, source=writer.hex())


class OtherDaemons:
    """The other daemons of the domain, by their prices: while one with a lower GUID sends its own, this one stands by.

    A daemon that stands by sends no price, so the graph shows those.

    Parameters
    ----------
    node : the daemon's node
    own : GUID of its own writer of prices
    tells_hosts : whether GUIDs name the host
    thread : reads the prices
    refused : counts refused messages
    clock : monotonic clock (s)
    """

    def __init__(
        self,
        node: Any,
        own: bytes,
        *,
        tells_hosts: bool,
        thread: ReadingThread,
        refused: RefusedMessages,
        clock: Callable[[], float],
    ) -> None:
        self._own = own
        self._tells_hosts = tells_hosts
        self._refused = refused
        self._clock = clock
        self._limiter = SourceRateLimiter(rate_hz=_PRICES_HZ, burst=_PRICES_HZ)
        self._heard_s: dict[bytes, float] = {}
        self.others: tuple[str, ...] = ()
        RawReader(node, Float64MultiArray, PRICE_TOPIC, _QOS, deliver=self.take, thread=thread)

    def active_daemon(self) -> str:
        """Return where the active daemon is, empty when it is this one."""
        now_s = self._clock()
        # `take` never changes what is read here, in another thread.
        drives = min((who for who, at_s in self._heard_s.items() if now_s - at_s <= _PRICE_SILENT_S), default=b"")
        return self._place(drives) if drives and drives < self._own else ""

    def see(self, writers: Iterable[Endpoint]) -> None:
        """Take in the writers of prices that the graph shows."""
        found = {writer.gid for writer in writers} - {self._own}
        self.others = tuple(self._place(each) for each in sorted(found)[:_MOST_DAEMONS])

    def take(self, sample: Sample) -> None:
        """Take a price, perhaps this daemon's own."""
        now_s, who = self._clock(), sample.writer
        if who == self._own:
            return
        if len(sample.data) > _MOST_PRICE:
            self._refuse(MessageRefusal.SIZE, sample, "a message is longer than any price")
        elif not self._limiter.lets_pass(who, now_s):
            self._refuse(MessageRefusal.RATE, sample, f"a daemon sends more than {_PRICES_HZ:g} prices a second")
        else:
            try:
                decode_price(deserialize_message(sample.data, Float64MultiArray).data)
            except (RuntimeError, ValueError) as fault:  # rclpy raises the first for bytes that it cannot decode
                self._refuse(MessageRefusal.MALFORMED, sample, str(fault))
                return
            heard_s = {each: at_s for each, at_s in self._heard_s.items() if now_s - at_s <= _PRICE_SILENT_S}
            if len(heard_s) < _MOST_DAEMONS:
                self._heard_s = {**heard_s, who: now_s}

    def _place(self, guid: bytes) -> str:
        if not self._tells_hosts:
            return "a host that its middleware does not tell"
        return "this host" if Endpoint(gid=guid).host == Endpoint(gid=self._own).host else "another host"

    def _refuse(self, reason: MessageRefusal, sample: Sample, words: str) -> None:
        self._refused.note(MessageKind.PRICES, reason, words, source=sample.writer.hex())
