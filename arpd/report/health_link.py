"""Checks of `arpd doctor` on the link and the two ends of it: clocks, radio, packet size, discovery."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from arpd.model.quantities import format_duration, format_number
from arpd.model.wire import MTU_BYTES, PACKET_BYTES
from arpd.report.health import Health, fine, known, unknown, wrong
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from arpd.report.health import Announcer, Facts, Finding, PeerClock, RadioState

_MOST_OFFSET_S = 0.02  # a robot that turns at 1 rad/s is 1.1° further on by then
_LEAST_SIGNAL_DBM = -75
_WORLD = "00"  # the regulatory domain that holds everywhere
# Plain ROS 2 at rest: 0.5 kB/s per participant with its unicast part (docs/results.md, A link at rest), so this is 1 %
# of a link that carries 8 Mbit/s.
_MANY_PARTICIPANTS = 20
_ARPDS_PROCESSES = 2  # on another host, with one end: `arpd run` and `arpd relay`, or `arpd peer`

_SERVE_WITHOUT_INTERNET = (
    "printf 'allow\\nlocal stratum 10\\n' | sudo tee /etc/chrony/conf.d/arpd.conf && sudo systemctl restart chrony"
    "   # without internet, on the base computer"
)
_FOLLOW_WITHOUT_INTERNET = (
    "echo 'server ADDRESS_OF_BASE iburst' | sudo tee /etc/chrony/sources.d/base.sources && sudo systemctl restart "
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

_WORST_LAST = [Health.FINE, Health.UNKNOWN, Health.WRONG]


def clock(facts: Facts) -> Finding:
    """Judge the offset between the ends: tf2 compares time stamps of both."""
    if not (clocks := known(facts.clocks)):
        return unknown("no peer was heard in the last minute; run `arpd peer` on the base computer")
    found = max(map(_of_peer, sorted(clocks, key=lambda each: -abs(each.offset_s or 0.0))), key=_badness)
    is_right = facts.is_clock_synchronised
    if found.health is Health.UNKNOWN and is_right is False:
        return unknown(f"{found.text}; nothing keeps this computer's clock right")
    if found.health is not Health.WRONG:
        return found
    here = {True: "; this computer's is synchronised", False: "; this computer's is not synchronised", None: ""}
    other = "the robot" if facts.is_far else "the base computer"
    where = {True: f"on {other}", False: f"here; then run `arpd doctor` on {other}", None: f"here and on {other}"}
    mend = f"sudo apt install chrony   # {where[is_right]}"
    return wrong(found.text + here[is_right], mend, _SERVE_WITHOUT_INTERNET, _FOLLOW_WITHOUT_INTERNET)


def _of_peer(clock: PeerClock) -> Finding:
    if clock.offset_s is None or clock.uncertainty_s is None:
        return unknown(f"{clock.peer} answered no probe in the last 30 s")
    error_s, offset_s = clock.uncertainty_s, abs(clock.offset_s)
    where = "ahead of" if clock.offset_s > 0 else "behind"
    found = f"the clock of {clock.peer} is {format_duration(offset_s)} {where} the robot's"
    found += f" (± {format_duration(error_s)})"
    if offset_s - error_s > _MOST_OFFSET_S:
        return wrong(f"{found}: tf2 finds poses of another time, or none")
    if offset_s + error_s > _MOST_OFFSET_S:
        return unknown(f"{found}, too vague to judge; look again while the link is idle")
    return fine(found)


def _badness(finding: Finding) -> int:
    return _WORST_LAST.index(finding.health)


def _worst(facts: Facts, judge: Callable[[str, RadioState], Finding]) -> Finding | None:
    """Return the worst finding on the radios of the link, None where it has none."""
    return max((judge(name, radio) for name, radio in known(facts.radios).items()), key=_badness, default=None)


def power_save(facts: Facts) -> Finding:
    """Judge whether a radio sleeps between beacons."""

    def judge(interface: str, radio: RadioState) -> Finding:
        if not known(radio.saves_power):
            return fine(f"{interface} does not save power")
        lasting = (
            "printf '[connection]\\nwifi.powersave = 2\\n' | sudo tee /etc/NetworkManager/conf.d/zz-no-powersave.conf"
            if radio.has_network_manager
            else _WITHOUT_POWER_SAVE
        )
        return wrong(
            f"{interface} saves power: the access point holds its packets until the next beacon, 100 ms and more",
            f"sudo iw dev {interface} set power_save off",
            f"{lasting}   # from the next start",
        )

    return _worst(facts, judge) or fine(f"{facts.interface} has no radio")


def signal(facts: Facts) -> Finding | None:
    """Judge the strength of the signal."""

    def judge(interface: str, radio: RadioState) -> Finding:
        if (signal_dbm := known(radio.signal_dbm)) >= _LEAST_SIGNAL_DBM:
            return fine(f"{interface} receives {signal_dbm} dBm")
        return wrong(
            f"{interface} receives {signal_dbm} dBm now; below {_LEAST_SIGNAL_DBM} dBm the bit rate falls, and packets "
            "are lost",
            f"bring robot and access point closer, or use a better antenna; `iw dev {interface} link` shows the signal",
        )

    return _worst(facts, judge)


def region(facts: Facts) -> Finding | None:
    """Judge the regulatory domain."""

    def judge(_interface: str, radio: RadioState) -> Finding:
        if (domain := known(radio.region)) != _WORLD:
            return fine(f"the regulatory domain is {domain}")
        return wrong(
            "no regulatory domain is set: the radio sends with little power, and on few channels of 5 GHz",
            "sudo iw reg set YOUR_COUNTRY   # its two letters",
            "echo 'options cfg80211 ieee80211_regdom=YOUR_COUNTRY' | sudo tee /etc/modprobe.d/arpd-region.conf   # its "
            "two letters; from the next start",
        )

    return _worst(facts, judge)


def mtu(facts: Facts) -> Finding:
    """Judge the largest packet that the link takes whole."""
    interface, mtu_bytes, route_bytes = facts.interface, known(facts.mtu_bytes), facts.route_mtu_bytes
    if mtu_bytes < PACKET_BYTES:
        return wrong(
            f"{interface} has an MTU of {mtu_bytes} bytes; arpd's packets have up to {PACKET_BYTES}, so IP cuts each",
            f"sudo ip link set dev {interface} mtu {MTU_BYTES}   # a tunnel takes less: {PACKET_BYTES}",
        )
    if route_bytes is not None and route_bytes < PACKET_BYTES:
        return wrong(
            f"the route to the other end takes {route_bytes} bytes, less than {interface} ({mtu_bytes}); arpd's "
            f"packets have up to {PACKET_BYTES}, so IP cuts each",
            f"raise the MTU to {PACKET_BYTES} or more on the way; `tracepath` to the other end shows where it falls",
        )
    return fine(f"{interface} takes packets of {min(mtu_bytes, route_bytes or mtu_bytes)} bytes")


def discovery(facts: Facts) -> Finding:
    """Judge how many participants other than arpd's announce themselves on the link.

    With two ends nobody needs to. With one end the nodes find each other across the link, so only many are too many.
    """
    heard, interface = known(facts.heard), facts.interface
    here = [one for one in heard.announcers if one.is_here and not one.is_arpds]
    there = _not_arpds([one for one in heard.announcers if not one.is_here], has_two_ends=facts.has_two_ends)
    others = len(here) + len(there)
    if not others:
        return fine(f"no node but arpd's announces itself on {interface} (domain {heard.domain_id})")
    names = [f"{len(here)} of this computer ({listed(sorted({one.process for one in here}))})"] if here else []
    hosts = sorted({one.host for one in there})
    names += [f"{sum(one.host == host for one in there)} of {host}" for host in hosts]
    rate = f"{format_number(heard.bytes_per_second / 1e3, digits=2)} kB/s"
    announce = "announces itself" if others == 1 else "announce themselves"
    found = (
        f"{count(others, 'participant')} of domain {heard.domain_id} {announce} "
        f"on {interface}: {listed(names)}; all multicast discovery there takes {rate}"
    )
    if facts.has_two_ends:
        line = "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
        where = "before your nodes start" + ("" if here else f", on {listed(hosts)}")
        return wrong(f"{found}; the relay carries their topics already", f"{line}   # {where}")
    if others > _MANY_PARTICIPANTS:
        return wrong(
            f"{found}, and unicast discovery about twice as much",
            "carry the topics with two ends: relay.link_domain in arpd.yaml, and "
            "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST for your nodes",
        )
    return fine(found)


def transports(facts: Facts) -> Finding:
    """Judge whether all participants can tell each other of their topics.

    They do so over TCP alone with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA, and over UDP alone without it. The two kinds
    hear each other's announcements, but never find each other's topics.
    """
    told = [one for one in known(facts.heard).announcers if one.transports]
    if not told:
        return fine("nobody announces itself, so nobody is cut off")
    own = [one.transports for one in told if one.is_arpds]
    ((usual, _number),) = Counter(own or [one.transports for one in told]).most_common(1)
    apart = [one for one in told if not one.transports & usual]
    if not apart:
        return fine(f"all participants share {listed(sorted(usual))}")
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
    return wrong(f"{found}, {listed(sorted(usual))} here", *mends)


def _not_arpds(there: Sequence[Announcer], *, has_two_ends: bool) -> list[Announcer]:
    """Return the participants of other computers beyond those that arpd itself may have there."""
    if has_two_ends:  # arpd's own are in the link domain
        return list(there)
    kept: list[Announcer] = []
    for host in sorted({one.host for one in there}):
        kept += [one for one in there if one.host == host][_ARPDS_PROCESSES:]
    return kept
