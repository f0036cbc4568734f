"""Start rclpy in arpd's own processes, and serve until a signal."""

from __future__ import annotations

import ctypes
import logging
import math
import os
import secrets
import signal
import socket
import threading
import time
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape

from arpd.host.notify import Notifier, Watchdog
from arpd.model.errors import GET_ROS, LinkError, RosUnavailableError
from arpd.model.wire import MOST_DOMAIN
from arpd.ros.rmw import chosen_rmw

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, MutableMapping, Sequence

    from arpd.host.addresses import Addresses
    from arpd.model.settings import LinkDomain

log = logging.getLogger(__name__)
_TURN_S = 0.1
FASTDDS_PROFILE = Path(__file__).with_name("fastdds.xml")
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"  # the name that begins with FASTDDS is of Fast DDS 3
_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"
_SERVER = "ROS_DISCOVERY_SERVER"
_MODE = "RMW_FASTRTPS_PUBLICATION_MODE"
_RANGE, _PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
OWN_PROFILE = Path(__file__).with_name("fastdds-own.xml")
TWO_ENDED_PROFILE = Path(__file__).with_name("fastdds-two-ended.xml")
DAEMON_PROFILE = Path(__file__).with_name("fastdds-daemon.xml")
_GHOSTS_PROFILE = Path(__file__).with_name("fastdds-ghosts.xml")
UDP_PROFILE = Path(__file__).with_name("fastdds-udp.xml")
# Of Fast DDS 2.14: XMLProfileManager::loadXMLString(text, size), which returns XML_OK, and get_instance() of
# DomainParticipantFactory with set_default_participant_qos(PARTICIPANT_QOS_DEFAULT), which reads the default of the
# profiles again.
_LOAD_PROFILE = "_ZN8eprosima8fastrtps9xmlparser17XMLProfileManager13loadXMLStringEPKcm"
_FACTORY = "_ZN8eprosima7fastdds3dds24DomainParticipantFactory12get_instanceEv"
_SET_DEFAULT = (
    "_ZN8eprosima7fastdds3dds24DomainParticipantFactory27set_default_participant_qosERKNS1_20DomainParticipantQosE"
)
_LOAD_FILE = "_ZN8eprosima7fastdds3dds24DomainParticipantFactory13load_profilesEv"  # that of the environment, once
_DEFAULT = "_ZN8eprosima7fastdds3dds23PARTICIPANT_QOS_DEFAULTE"
_XML_OK = 1
_LOCATOR = "<locator><udpv4><address>{}</address></udpv4></locator>"
_BUILTIN = "<builtin>"
_TOLD = (
    f"<defaultUnicastLocatorList>{{0}}</defaultUnicastLocatorList>{_BUILTIN}"
    "<metatrafficUnicastLocatorList>{0}</metatrafficUnicastLocatorList>"
)


def prepare_environment(profile: Path = OWN_PROFILE, environment: MutableMapping[str, str] = os.environ) -> None:
    """Give Fast DDS arpd's profile, unless the user has chosen another one than arpd's, and the sight of all topics."""
    if not _is_another(Path(environment.get(PROFILE_VARIABLE, ""))):
        environment[PROFILE_VARIABLE] = str(profile)
    if environment.get(_SERVER):  # an ordinary client hears only of topics that it uses itself
        environment["ROS_SUPER_CLIENT"] = environment.get("ROS_SUPER_CLIENT") or "TRUE"
    if profile in {TWO_ENDED_PROFILE, DAEMON_PROFILE}:
        environment[_MODE] = "SYNCHRONOUS"  # other samples would share what the profile lets discovery send
        if environment.pop("ROS_LOCALHOST_ONLY", "") == "1":  # its older name; it would confine the link's node, too
            environment[_RANGE] = "LOCALHOST"
            environment.pop(_PEERS, None)
        # Else, where both sides have one domain, the ends would meet there and announce all their ghosts on the link.
        environment.setdefault(_RANGE, "LOCALHOST")


def prepare_for_this_host(environment: MutableMapping[str, str] = os.environ) -> None:
    """Give participants that are made from now on, and their writers, a profile for nodes on this host alone.

    Fast DDS loads a file of profiles once in a process, and a participant takes its default, and that of its writers,
    when it is made. Where the user has chosen another profile, nodes may be on other hosts, or Fast DDS has no such
    functions, they keep the profile of the process: it loses nothing either, costs more, and is found later.

    With UDP alone the range is no longer LOCALHOST, in which rmw_fastrtps adds shared memory, but the profile's own,
    which is the same. Only in LOCALHOST and SUBNET it takes ROS_STATIC_PEERS, so they are written into the profile.
    """
    is_ours = environment.get(PROFILE_VARIABLE) in {str(TWO_ENDED_PROFILE), str(DAEMON_PROFILE)}
    if is_ours and environment.get(_RANGE) == "LOCALHOST":
        profiles = [_GHOSTS_PROFILE.read_text()]
        has_udp_alone = environment.get(_VARIABLE, "").partition("?")[0] == "UDPv4"  # with options or without
        if has_udp_alone:
            profiles.append(_with_peers(UDP_PROFILE.read_text(), environment.get(_PEERS, "")))
        if _load(*profiles) and has_udp_alone:  # else rmw_fastrtps names the peer that has no address
            environment[_RANGE] = "SYSTEM_DEFAULT"


def _load(*profiles: str) -> bool:
    """Give participants that are made from now on the last of these profiles; return whether Fast DDS takes it."""
    is_taken = False
    with suppress(OSError, AttributeError, ValueError):
        fast_dds = ctypes.CDLL("librmw_fastrtps_cpp.so")
        (get_factory := fast_dds[_FACTORY]).restype = ctypes.c_void_p
        factory = ctypes.c_void_p(get_factory())
        fast_dds[_LOAD_FILE](factory)  # else it would come later, and replace these
        for text in map(str.encode, profiles):
            is_taken = fast_dds[_LOAD_PROFILE](text, ctypes.c_size_t(len(text))) == _XML_OK
        fast_dds[_SET_DEFAULT](factory, ctypes.byref(ctypes.c_char.in_dll(fast_dds, _DEFAULT)))
    return is_taken


def _with_peers(profile: str, peers: str) -> str:
    """Return a profile that announces its participant at ROS_STATIC_PEERS, too."""
    hosts = "127.0.0.1", *filter(None, peers.split(";"))
    return profile.replace(_LOCATOR.format(hosts[0]), "".join(_LOCATOR.format(escape(host)) for host in hosts))


@contextmanager
def _told_address(address: str | None, environment: MutableMapping[str, str] = os.environ) -> Iterator[None]:
    """Let a participant that is made meanwhile tell others one address of this computer's, where one is given.

    Fast DDS sends every sample to each address of a reader's. Where a computer has a second one, of Docker, of a VPN or
    of a second network, both lead over the link, by a route of their own or by the default route: measured, everything
    crossed twice. It still listens on every interface, so processes on this computer hear it without the link.
    """
    file = environment.get(PROFILE_VARIABLE, "")
    if address is None or file not in {str(TWO_ENDED_PROFILE), str(DAEMON_PROFILE)}:
        yield
        return
    profile = Path(file).read_text()
    _load(_renamed(profile).replace(_BUILTIN, _TOLD.format(_LOCATOR.format(address))))
    try:
        yield
    finally:
        _load(_renamed(profile))


def _renamed(profile: str) -> str:
    """Return the participant of a profile under a name of its own: Fast DDS takes each name once."""
    before, end = '<participant profile_name="', "</participant>"
    participant = profile.partition(f"{before}arpd")[2].partition(end)[0]
    return f"<profiles>{before}{secrets.token_hex(4)}{participant}{end}</profiles>"


@contextmanager
def any_user_heard(environment: MutableMapping[str, str] = os.environ) -> Iterator[None]:
    """Let nodes that are made meanwhile exchange samples with nodes of any user, as arpd's units do.

    In the range LOCALHOST that takes a profile (fastdds-udp.xml); one that the user has chosen stays, and so does the
    range where it has static peers, which that file has not.
    """
    environment.setdefault(_VARIABLE, "UDPv4")
    chosen = environment.get(_RANGE)
    is_fast_dds = chosen_rmw(environment).is_fast_dds
    if is_fast_dds and (chosen, environment[_VARIABLE], environment.get(_PEERS, "")) == ("LOCALHOST", "UDPv4", ""):
        prepare_environment(UDP_PROFILE, environment)
        if environment.get(PROFILE_VARIABLE) == str(UDP_PROFILE):
            environment[_RANGE] = "SYSTEM_DEFAULT"
    try:
        yield
    finally:
        if chosen is not None:
            environment[_RANGE] = chosen


def _is_another(path: Path) -> bool:
    """Return whether this is another profile than arpd's for the user's nodes, which an environment for all may name.

    A file that this process cannot read is no choice: Fast DDS goes on without any.
    """
    try:
        return path.read_bytes() != FASTDDS_PROFILE.read_bytes()
    except OSError:
        return False


@contextmanager
def ros_node(
    name: str, link: LinkDomain | None = None, *, address: str | None = None, context: Any = None
) -> Iterator[Any]:
    """Run rclpy with one node, without rclpy's signal handlers: the process has its own.

    It has none of a node's usual services, of parameters and type descriptions, because nobody spins it. Raises
    RosUnavailableError if ROS 2 cannot be imported here, or does not start, and LinkError if the name of the link's
    other end leads to no address.

    Parameters
    ----------
    link : domain that it joins; the host's own domain when None
    address : this computer's on the link, the only one that others are told; None = all that it has
    context : rclpy context to start for it; None = the process's own, for a link a new one
    """
    prepare_environment(OWN_PROFILE if link is None else TWO_ENDED_PROFILE)
    try:
        import rclpy  # noqa: PLC0415 - ROS may be missing, and `arpd check` works without it
        from rclpy.parameter import Parameter  # noqa: PLC0415
        from rclpy.signals import SignalHandlerOptions  # noqa: PLC0415
    except ImportError as error:
        raise RosUnavailableError(f"ROS 2 cannot be imported ({error}); {GET_ROS}") from error
    context = context or (rclpy.get_default_context() if link is None else rclpy.Context())
    try:
        with nullcontext() if link is None else _discovery(link):
            domain_id = None if link is None else link.domain_id
            rclpy.init(context=context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO)
            _require_ports(context)
            with _told_address(address):
                node = rclpy.create_node(
                    name,
                    context=context,
                    enable_rosout=link is None,  # nobody reads it on the link
                    start_parameter_services=False,
                    parameter_overrides=[Parameter("start_type_description_service", value=False)],
                )
    # RCLError is the first: no keys for SROS 2, a middleware without it, a node name taken. rcl reads the command line.
    except (RuntimeError, UnicodeError) as error:
        rclpy.try_shutdown(context=context)
        if link and not _has_address(link.peer):
            raise LinkError(
                f"relay.robot or relay.base: this computer knows no address of {link.peer}; make its name known here "
                f"(getent hosts {link.peer}), or write its address"
            ) from error
        raise RosUnavailableError(
            f"ROS 2 does not start ({' '.join(str(error).split())}); correct ROS_* or RMW_IMPLEMENTATION of this "
            "process, for arpd's services in /etc/default/arpd"
        ) from error
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def _has_address(name: str) -> bool:
    """Return whether this computer finds an address for a name; none is asked for where there is no name."""
    try:
        return not name or bool(socket.getaddrinfo(name, None))
    except OSError:
        return False


def _require_ports(context: Any) -> None:
    """Raise RuntimeError where the domain has no ports; Fast DDS would end the process."""
    if (own := context.get_domain_id()) > MOST_DOMAIN:
        raise RuntimeError(f"there is no domain above {MOST_DOMAIN}, and ROS_DOMAIN_ID is {own}")


@contextmanager
def _discovery(link: LinkDomain, environment: MutableMapping[str, str] = os.environ) -> Iterator[None]:
    """Let a context whose first node is made meanwhile look for others at known addresses, and never wait for a write.

    With a list of peers Fast DDS announces a participant to those, at the first four ports of the domain, and once more
    by multicast. LOCALHOST would announce it at 32 ports of each (rmw_fastrtps, participant.cpp), every three seconds.

    Written without waiting (`send_without_waiting`), a full link delays neither acknowledgements nor signs of life; the
    reliable protocol sends again what the socket did not take. rcl reads its variables at each initialisation, Fast DDS
    its own with each participant, which the first node makes.
    """
    peers = ";".join(filter(None, ("127.0.0.1", link.peer)))
    own = {_RANGE: "SUBNET", _PEERS: peers}
    before = {name: environment.get(name) for name in (*own, _VARIABLE, _SERVER)}
    environment.update(own)
    environment.pop(_SERVER, None)  # the robot's discovery server is in its own domain, and knows nothing of the link
    # What else suits the nodes around leaves no host (SHM), or carries half as much here (LARGE_DATA, measured).
    if environment.get(_VARIABLE, "").partition("?")[0] not in {"", "DEFAULT", "UDPv4"}:
        environment[_VARIABLE] = "UDPv4"
    send_without_waiting(environment)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                environment.pop(name, None)
            else:
                environment[name] = value


def serve_until(
    stopping: threading.Event,
    *,
    notifier: Notifier,
    parts: Sequence[Callable[[], float]],
    addresses: Addresses,
    step: Callable[[], None] = lambda: None,
    every_s: float = _TURN_S,
) -> None:
    """Run a service in this thread, which systemd hears of, with a watchdog, until ``stopping`` is set.

    Raises LinkError if only a new process can use the link, or its address.

    Parameters
    ----------
    parts : as `Watchdog` has them
    step : called again and again; where it fails, the watchdog is not fed, and a LinkError ends the service
    every_s : time between two calls, a tenth of a second or more (s)
    """
    heartbeat, due_s = Watchdog(notifier, parts=parts), -math.inf
    notifier.ready()
    try:
        while not stopping.is_set():
            if (now_s := time.monotonic()) >= due_s:
                due_s = now_s + every_s
                try:
                    step()
                    heartbeat.beat()
                except LinkError:
                    raise
                except Exception:
                    log.exception("a step failed; the service continues")
            if addresses.are_outdated():
                raise addresses.error()
            time.sleep(_TURN_S)  # Event.wait could hold the lock that the handler of a signal needs
    finally:
        notifier.stopping()


def stop_on_signals() -> threading.Event:
    """Return an event that SIGINT and SIGTERM set from now on; SIGHUP is ignored."""
    stopping = threading.Event()

    def handle(_signum: int, _frame: Any) -> None:
        stopping.set()

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    return stopping


def send_without_waiting(environment: MutableMapping[str, str] = os.environ) -> None:
    """Let Fast DDS drop samples that the socket does not take, in this process, unless its options are set already.

    Fast DDS writes to a blocking socket. When a link stops but keeps its carrier, its queue fills, then the socket's
    buffer, and the next write to a far reader blocks until the link recovers. In `arpd run` that write blocks the tick,
    and the publishers on this host receive no price. Measured on such a link with 40 kB/s of probes: the ticks stopped
    after 3 s and continued with the link. Without waiting, a write took 0.2 ms, and the price kept arriving through
    shared memory. (With UDP alone one socket serves near and far readers: the ticks continue, and the price
    arrives again with the link.) The dropped samples are best effort, or are repeated.

    Nodes of the application do not use this: a write that blocks tells them that the link is full.
    """
    chosen = environment.get(_VARIABLE) or "DEFAULT"
    if "?" not in chosen:
        environment[_VARIABLE] = f"{chosen}?non_blocking=true"
