"""Judgements of `arpd doctor` about the link and the two ends of it: clocks, radio, packet size, discovery."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from arpd.model.quantities import format_duration, format_number
from arpd.model.wire import MTU_BYTES, PACKET_BYTES
from arpd.report.health import Health, Judgement, Unknown, fine, unknown, wrong
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_MOST_OFFSET_S = 0.02  # a robot that turns at 1 rad/s is 1.1° further on by then
_LEAST_SIGNAL_DBM = -75
_WORLD = "00"  # the regulatory domain that holds everywhere
# Plain ROS 2 at rest: 0.5 kB/s per participant with its unicast part (docs/results.md, A link at rest), so this is 1 %
# of a link that carries 8 Mbit/s.
_MANY_PARTICIPANTS = 20
_ARPDS_PROCESSES = 2  # on another host, with one end: `arpd run` and `arpd relay`, or `arpd peer`

_SERVE_WITHOUT_INTERNET = (
    "printf 'allow\\nlocal stratum 10\\n' | sudo tee /etc/chrony/conf.d/arpd.conf && sudo systemctl restart chrony"
    "   # without internet, on the CEDDP"
)
_FOLLOW_WITHOUT_INTERNET = (
    "echo 'server ADDRESS_OF_CEDDP iburst' | sudo tee /etc/chrony/sources.d/ceddp.sources && sudo systemctl restart "
    "chrony   # without internet, on the robot"
)

# udev knows the name that an interface gets from rule 80-net-setup-link on; NAME matches only those that are renamed.
_WITHOUT_POWER_SAVE = (
    'echo \'ACTION=="add", SUBSYSTEM=="net", ENV{DEVTYPE}=="wlan", RUN+="/usr/sbin/iw dev $name set power_save off"\' '
    "| sudo tee /etc/udev/rules.d/81-arpd-no-powersave.rules"
)

_OVER_TCP_TOO = (
    "echo FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA | sudo tee -a /etc/default/arpd && sudo systemctl restart 'arpd*'"
)
_AS_THE_NODES_USER = (
    "sudo systemctl edit arpd   # and the other services: User= and Group= of your nodes, as processes of different "
    "users exchange nothing then"
)

CLOCK, POWER_SAVE, SIGNAL, REGION, MTU = "clock", "power save", "signal", "region", "mtu"
DISCOVERY, TRANSPORTS = "discovery", "transports"


@dataclass(frozen=True, kw_only=True, slots=True)
class PeerClock:
    """Clock of one peer against the robot's (s), as the daemon tells it; None = not known."""

    peer: str
    offset_s: float | None
    uncertainty_s: float | None


def judge_clock(
    clocks: Sequence[PeerClock] | Unknown, *, is_synchronised: bool | None, is_far: bool
) -> Iterator[Judgement]:
    """Judge the offset between the ends: tf2 compares time stamps of both.

    Parameters
    ----------
    is_synchronised : whether the kernel of this computer says that something keeps its clock right, None = not known
    is_far : whether this computer is the CEDDP
    """
    judged = _judge_clocks(clocks)
    if judged.health is Health.WRONG:
        mend = _synchronise(is_synchronised=is_synchronised, is_far=is_far)
        here = {True: "; this computer's is synchronised", False: "; this computer's is not synchronised", None: ""}
        judged = wrong(
            CLOCK, judged.text + here[is_synchronised], mend, _SERVE_WITHOUT_INTERNET, _FOLLOW_WITHOUT_INTERNET
        )
    yield judged
    if judged.health is Health.UNKNOWN and is_synchronised is False:
        yield unknown(CLOCK, "nothing keeps this computer's clock right; it may differ from the other end's")


def _judge_clocks(clocks: Sequence[PeerClock] | Unknown) -> Judgement:
    if isinstance(clocks, Unknown):
        return unknown(CLOCK, clocks)
    if not clocks:
        return unknown(CLOCK, "no peer was heard in the last minute; run `arpd peer` on the CEDDP")
    unsure: list[str] = []
    well: list[str] = []
    for clock in sorted(clocks, key=lambda clock: -abs(clock.offset_s or 0.0)):
        if clock.offset_s is None or clock.uncertainty_s is None:
            unsure.append(f"{clock.peer} answered no probe in the last 30 s")
            continue
        error_s, offset_s = clock.uncertainty_s, abs(clock.offset_s)
        where = "ahead of" if clock.offset_s > 0 else "behind"
        found = f"the clock of {clock.peer} is {format_duration(offset_s)} {where} the robot's"
        found += f" (± {format_duration(error_s)})"
        if offset_s - error_s > _MOST_OFFSET_S:
            return wrong(CLOCK, f"{found}: tf2 finds poses of another time, or none")
        if offset_s + error_s > _MOST_OFFSET_S:
            unsure.append(f"{found}, too vague to judge; look again while the link is idle")
        else:
            well.append(found)
    return unknown(CLOCK, unsure[0]) if unsure else fine(CLOCK, well[0])


def _synchronise(*, is_synchronised: bool | None, is_far: bool) -> str:
    other = "the robot" if is_far else "the CEDDP"
    if is_synchronised is None:
        return f"sudo apt install chrony   # here and on {other}"
    where = f"on {other}" if is_synchronised else f"here; then run `arpd doctor` on {other}"
    return f"sudo apt install chrony   # {where}"


@dataclass(frozen=True, kw_only=True, slots=True)
class RadioState:
    """A Wi-Fi interface, as nl80211 tells it.

    Parameters
    ----------
    saves_power : whether it sleeps between beacons
    signal_dbm : strength of its access point, or of the strongest station (dBm)
    region : two letters of the regulatory domain in force, ``00`` = none is set
    has_network_manager : whether NetworkManager runs here, and would set power save again
    """

    saves_power: bool | Unknown
    signal_dbm: int | Unknown
    region: str | Unknown
    has_network_manager: bool = False


def judge_radio(interface: str, radio: RadioState | None) -> Iterator[Judgement]:
    """Judge power save, signal and regulatory domain; None = the interface has no radio."""
    if radio is None:
        yield fine(POWER_SAVE, f"{interface} has no radio")
        return
    yield _judge_power_save(interface, radio)
    yield _judge_signal(interface, radio.signal_dbm)
    yield _judge_region(radio.region)


def _judge_power_save(interface: str, radio: RadioState) -> Judgement:
    if isinstance(radio.saves_power, Unknown):
        return unknown(POWER_SAVE, radio.saves_power)
    if not radio.saves_power:
        return fine(POWER_SAVE, f"{interface} does not save power")
    lasting = (
        "printf '[connection]\\nwifi.powersave = 2\\n' | sudo tee /etc/NetworkManager/conf.d/zz-no-powersave.conf"
        if radio.has_network_manager
        else _WITHOUT_POWER_SAVE
    )
    return wrong(
        POWER_SAVE,
        f"{interface} saves power: the access point holds its packets until the next beacon, 100 ms and more",
        f"sudo iw dev {interface} set power_save off",
        f"{lasting}   # from the next start",
    )


def _judge_signal(interface: str, signal_dbm: int | Unknown) -> Judgement:
    if isinstance(signal_dbm, Unknown):
        return unknown(SIGNAL, signal_dbm)
    if signal_dbm >= _LEAST_SIGNAL_DBM:
        return fine(SIGNAL, f"{interface} receives {signal_dbm} dBm")
    return wrong(
        SIGNAL,
        f"{interface} receives {signal_dbm} dBm now; below {_LEAST_SIGNAL_DBM} dBm the bit rate falls, and packets are "
        "lost",
        f"bring robot and access point closer, or use a better antenna; `iw dev {interface} link` shows the signal",
    )


def _judge_region(region: str | Unknown) -> Judgement:
    if isinstance(region, Unknown):
        return unknown(REGION, region)
    if region != _WORLD:
        return fine(REGION, f"the regulatory domain is {region}")
    return wrong(
        REGION,
        "no regulatory domain is set: the radio sends with little power, and on few channels of 5 GHz",
        "sudo iw reg set YOUR_COUNTRY   # its two letters",
        "echo 'options cfg80211 ieee80211_regdom=YOUR_COUNTRY' | sudo tee /etc/modprobe.d/arpd-region.conf   # its two "
        "letters; from the next start",
    )


def judge_mtu(interface: str, mtu_bytes: int | Unknown, *, route_bytes: int | None) -> Judgement:
    """Judge the largest packet that the link takes whole.

    Parameters
    ----------
    mtu_bytes : of the interface
    route_bytes : what the kernel knows of the route to the other end, None = nothing
    """
    if isinstance(mtu_bytes, Unknown):
        return unknown(MTU, mtu_bytes)
    if mtu_bytes < PACKET_BYTES:
        return wrong(
            MTU,
            f"{interface} has an MTU of {mtu_bytes} bytes; arpd's packets have up to {PACKET_BYTES}, so IP cuts each",
            f"sudo ip link set dev {interface} mtu {MTU_BYTES}   # a tunnel takes less: {PACKET_BYTES}",
        )
    if route_bytes is not None and route_bytes < PACKET_BYTES:
        return wrong(
            MTU,
            f"the route to the other end takes {route_bytes} bytes, less than {interface} ({mtu_bytes}); arpd's "
            f"packets have up to {PACKET_BYTES}, so IP cuts each",
            f"raise the MTU to {PACKET_BYTES} or more on the way; `tracepath` to the other end shows where it falls",
        )
    return fine(MTU, f"{interface} takes packets of {min(mtu_bytes, route_bytes or mtu_bytes)} bytes")


@dataclass(frozen=True, kw_only=True, slots=True)
class Announcer:
    """A participant that announces itself by multicast.

    Parameters
    ----------
    host : name or address of its computer
    process : its command, or its number in words; empty = not known
    is_here : whether it runs on this computer
    is_arpds : whether it is a process of arpd's; never known of another computer's
    transports : over what it tells of its topics, as "UDPv4"; empty = not known
    """

    host: str
    process: str
    is_here: bool
    is_arpds: bool
    transports: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True, slots=True)
class HeardDiscovery:
    """Multicast discovery on the link interface for some seconds.

    Parameters
    ----------
    bytes_per_second : with UDP, IP and Ethernet headers
    """

    domain_id: int
    announcers: tuple[Announcer, ...]
    bytes_per_second: float


def judge_discovery(heard: HeardDiscovery | Unknown, *, interface: str, has_two_ends: bool) -> Judgement:
    """Judge how many participants other than arpd's announce themselves on the link.

    With two ends nobody needs to. With one end the nodes find each other across the link, so only many are too many.

    Parameters
    ----------
    has_two_ends : whether the configuration has a relay with two ends
    """
    if isinstance(heard, Unknown):
        return unknown(DISCOVERY, heard)
    here = [one for one in heard.announcers if one.is_here and not one.is_arpds]
    there = _not_arpds([one for one in heard.announcers if not one.is_here], has_two_ends=has_two_ends)
    others = len(here) + len(there)
    if not others:
        return fine(DISCOVERY, f"no node but arpd's announces itself on {interface} (domain {heard.domain_id})")
    names = [f"{len(here)} of this computer ({listed(sorted({one.process for one in here}))})"] if here else []
    hosts = sorted({one.host for one in there})
    names += [f"{sum(one.host == host for one in there)} of {host}" for host in hosts]
    rate = f"{format_number(heard.bytes_per_second / 1e3, digits=2)} kB/s"
    announce = "announces itself" if others == 1 else "announce themselves"
    found = (
        f"{count(others, 'participant')} of domain {heard.domain_id} {announce} "
        f"on {interface}: {listed(names)}; all multicast discovery there takes {rate}"
    )
    if has_two_ends:
        line = "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        where = "before your nodes start" + ("" if here else f", on {listed(hosts)}")
        return wrong(DISCOVERY, f"{found}; the relay carries their topics already", f"{line}   # {where}")
    if others > _MANY_PARTICIPANTS:
        return wrong(
            DISCOVERY,
            f"{found}, and unicast discovery about twice as much",
            "carry the topics with two ends: relay.link_domain in arpd.yaml, and "
            "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST for your nodes",
        )
    return fine(DISCOVERY, found)


def judge_transports(heard: HeardDiscovery | Unknown) -> Judgement:
    """Judge whether all participants can tell each other of their topics.

    They do so over TCP alone with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA, and over UDP alone without it. The two kinds
    hear each other's announcements, but never find each other's topics.
    """
    if isinstance(heard, Unknown):
        return unknown(TRANSPORTS, heard)
    told = [one for one in heard.announcers if one.transports]
    if not told:
        return fine(TRANSPORTS, "nobody announces itself, so nobody is cut off")
    own = [one.transports for one in told if one.is_arpds]
    ((usual, _number),) = Counter(own or [one.transports for one in told]).most_common(1)
    apart = [one for one in told if not one.transports & usual]
    if not apart:
        return fine(TRANSPORTS, f"all participants share {listed(sorted(usual))}")
    theirs = frozenset[str]().union(*(one.transports for one in apart))
    names = sorted({one.process if one.is_here else f"{one.process} of {one.host}" for one in apart})
    others = "arpd" if own else "the others"
    found = f"{listed(names)} and {others} never find each other's topics: {listed(sorted(theirs))} there"
    have_tcp = any(name.startswith("TCP") for name in theirs)
    if own and have_tcp:
        mends: tuple[str, ...] = (_OVER_TCP_TOO, _AS_THE_NODES_USER)
    else:
        chosen = "unset FASTDDS_BUILTIN_TRANSPORTS" if have_tcp else "export FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"
        mends = (f"{chosen}   # before {listed(names)} start",)
    return wrong(TRANSPORTS, f"{found}, {listed(sorted(usual))} here", *mends)


def _not_arpds(there: Sequence[Announcer], *, has_two_ends: bool) -> list[Announcer]:
    """Return the participants of other computers beyond those that arpd itself may have there."""
    if has_two_ends:  # arpd's own are in the link domain
        return list(there)
    kept: list[Announcer] = []
    for host in sorted({one.host for one in there}):
        kept += [one for one in there if one.host == host][_ARPDS_PROCESSES:]
    return kept
