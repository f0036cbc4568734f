"""Checks of `arpd doctor` on the link and the two ends of it: clocks, radio, packet size, discovery."""

from __future__ import annotations

from collections import Counter
from shlex import quote
from typing import TYPE_CHECKING

from arpd.cli.checkup import Health, fine, unknown, wrong
from arpd.host import kernel, radio
from arpd.model.quantities import format_duration, format_number
from arpd.model.wire import MTU_BYTES, PACKET_BYTES
from arpd.report.wording import count, listed

if TYPE_CHECKING:
    from arpd.cli.checkup import Finding, Here
    from arpd.web.api import Peer

_MOST_OFFSET_S = 0.02  # a robot that turns at 1 rad/s is 1.1° further on by then
_LEAST_SIGNAL_DBM = -75
_WORLD = "00"  # the regulatory domain that holds everywhere
# Plain ROS 2 at rest: 0.5 kB/s per participant with its unicast part (docs/results.md, A link at rest), so this is 1 %
# of a link that carries 8 Mbit/s.
_MANY_PARTICIPANTS = 20
_ARPDS_PROCESSES = 2  # on another host, with one end: `arpd run` and `arpd relay`, or `arpd peer`

_SERVE_THE_CLOCK = (
    "printf 'allow\\nlocal stratum 10\\n' | sudo tee /etc/chrony/conf.d/arpd.conf && sudo systemctl restart chrony"
    "   # without internet, on the base computer"
)
_FOLLOW_THE_CLOCK = (
    "echo 'server ADDRESS_OF_BASE iburst' | sudo tee /etc/chrony/sources.d/base.sources && sudo systemctl restart "
    "chrony   # without internet, on the robot"
)
_BY_NETWORK_MANAGER = (
    "printf '[connection]\\nradio.powersave = 2\\n' | sudo tee /etc/NetworkManager/conf.d/zz-no-powersave.conf"
)
# udev knows the name that an interface gets from rule 80-net-setup-link on; NAME matches only those that are renamed.
_BY_UDEV = (
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


def clock(here: Here) -> Finding:
    """Judge the offset between the ends: tf2 compares time stamps of both."""
    if not (peers := here.status.peers):
        return unknown("no peer was heard in the last minute; run `arpd peer` on the base computer")
    farthest_first = sorted(peers, key=lambda peer: -abs(peer.clock.offset_s if peer.clock else 0.0))
    return max(map(_clock_of, farthest_first), key=lambda finding: list(Health).index(finding.health))


def _clock_of(peer: Peer) -> Finding:
    if peer.clock is None:
        return unknown(f"{peer.peer} answered no probe in the last 30 s")
    offset_s, error_s = peer.clock.offset_s, peer.clock.uncertainty_s
    found = f"the clock of {peer.peer} is {format_duration(abs(offset_s))} {'ahead of' if offset_s > 0 else 'behind'} "
    found += f"the robot's (± {format_duration(error_s)})"
    kept = {True: "; this computer's is synchronised", False: "; this computer's is not synchronised", None: ""}
    if abs(offset_s) - error_s > _MOST_OFFSET_S:
        is_kept = kept[kernel.is_clock_synchronised()]
        found += f": tf2 finds poses of another time, or none{is_kept}"
        mend = "sudo apt install chrony   # on both computers"
        return wrong(found, mend, _SERVE_THE_CLOCK, _FOLLOW_THE_CLOCK)
    if abs(offset_s) + error_s > _MOST_OFFSET_S:
        return unknown(f"{found}, too vague to judge; look again while the link is idle")
    return fine(found)


def power_save(here: Here) -> Finding:
    """Judge whether a radio sleeps between beacons."""
    radios = radio.radios_of(here.interface)
    for name in radios:
        if radio.power_save(name):
            lasting = _BY_NETWORK_MANAGER if radio.runs_network_manager() else _BY_UDEV
            return wrong(
                f"{name} saves power: the access point holds its packets until the next beacon, 100 ms and more",
                f"sudo iw dev {quote(name)} set power_save off",
                f"{lasting}   # from the next start",
            )
    return fine(f"{listed(radios)} does not save power" if radios else f"{here.interface} has no radio")


def signal(here: Here) -> Finding | None:
    """Judge the strength of the signal."""
    signals = {name: radio.signal(name) for name in radio.radios_of(here.interface)}
    if not signals:
        return None
    weakest = min(signals, key=signals.__getitem__)
    found = f"{weakest} receives {signals[weakest]} dBm"
    if signals[weakest] >= _LEAST_SIGNAL_DBM:
        return fine(found)
    return wrong(
        f"{found} now; below {_LEAST_SIGNAL_DBM} dBm the bit rate falls, and packets are lost",
        "bring robot and access point closer, or use a better antenna; "
        f"`iw dev {quote(weakest)} link` shows the signal",
    )


def region(here: Here) -> Finding | None:
    """Judge the regulatory domain."""
    regions = [radio.region(name) for name in radio.radios_of(here.interface)]
    if _WORLD not in regions:
        return fine(f"the regulatory domain is {listed(regions)}") if regions else None
    return wrong(
        "no regulatory domain is set: the radio sends with little power, and on few channels of 5 GHz",
        "sudo iw reg set YOUR_COUNTRY   # its two letters",
        "echo 'options cfg80211 ieee80211_regdom=YOUR_COUNTRY' | sudo tee /etc/modprobe.d/arpd-region.conf   # its "
        "two letters; from the next start",
    )


def mtu(here: Here) -> Finding:
    """Judge the largest packet that the link takes whole."""
    interface = here.interface
    mtu_bytes = kernel.read_mtu(interface)
    if mtu_bytes < PACKET_BYTES:
        return wrong(
            f"{interface} has an MTU of {mtu_bytes} bytes; arpd's packets have up to {PACKET_BYTES}, so IP cuts each",
            f"sudo ip link set dev {quote(interface)} mtu {MTU_BYTES}   # a tunnel takes less: {PACKET_BYTES}",
        )
    route_bytes = kernel.route_mtu(here.other_end) if here.other_end else None
    if route_bytes is not None and route_bytes < PACKET_BYTES:
        return wrong(
            f"the route to the other end takes {route_bytes} bytes, less than {interface} ({mtu_bytes}); arpd's "
            f"packets have up to {PACKET_BYTES}, so IP cuts each",
            f"raise the MTU to {PACKET_BYTES} or more on the way; `tracepath` to the other end shows where it falls",
        )
    return fine(f"{interface} takes packets of {min(mtu_bytes, route_bytes or mtu_bytes)} bytes")


def discovery(here: Here) -> Finding:
    """Judge how many participants other than arpd's announce themselves on the link.

    With two ends nobody needs to. With one end the nodes find each other across the link, so only many are too many.
    """
    heard, interface, has_two_ends = here.heard, here.interface, here.settings.relay.link_domain is not None
    own = [one for one in heard.announcers if one.is_here and not one.is_arpds]
    by_host = Counter(one.host for one in heard.announcers if not one.is_here)
    if not has_two_ends:  # else arpd's own are in the link domain
        by_host = +Counter({host: number - _ARPDS_PROCESSES for host, number in by_host.items()})
    others = len(own) + by_host.total()
    if not others:
        return fine(f"no node but arpd's announces itself on {interface} (domain {heard.domain_id})")
    names = [f"{len(own)} of this computer ({listed(sorted({one.process for one in own}))})"] if own else []
    names += [f"{number} of {host}" for host, number in sorted(by_host.items())]
    rate = f"{format_number(heard.bytes_per_second / 1e3, digits=2)} kB/s"
    found = (
        f"{count(others, 'participant')} of domain {heard.domain_id} "
        f"{'announces itself' if others == 1 else 'announce themselves'} on {interface}: {listed(names)}; "
        f"all multicast discovery there takes {rate}"
    )
    if has_two_ends:
        return wrong(
            f"{found}; the relay carries their topics already",
            "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST   # before your nodes start, on these computers",
        )
    if others > _MANY_PARTICIPANTS:
        return wrong(
            f"{found}, and unicast discovery about twice as much",
            "carry the topics with two ends: relay.link_domain in arpd.yaml, and "
            "ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST for your nodes",
        )
    return fine(found)


def transports(here: Here) -> Finding:
    """Judge whether all participants can tell each other of their topics.

    They do so over TCP alone with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA, and over UDP alone without it. The two kinds
    hear each other's announcements, but never find each other's topics.
    """
    told = [one for one in here.heard.announcers if one.transports]
    if not told:
        return fine("nobody announces itself, so nobody is cut off")
    own = [one.transports for one in told if one.is_arpds]
    ((usual, _number),) = Counter(own or [one.transports for one in told]).most_common(1)
    apart = [one for one in told if not one.transports & usual]
    if not apart:
        return fine(f"all participants share {listed(sorted(usual))}")
    theirs = sorted(frozenset[str]().union(*(one.transports for one in apart)))
    names = listed(sorted({one.process if one.is_here else f"{one.process} of {one.host}" for one in apart}))
    have_tcp = any(name.startswith("TCP") for name in theirs)
    if own and have_tcp:
        mends: tuple[str, ...] = (_OVER_TCP_TOO, _AS_THE_NODES_USER)
    else:
        chosen = "unset FASTDDS_BUILTIN_TRANSPORTS" if have_tcp else "export FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"
        mends = (f"{chosen}   # before these nodes start",)
    return wrong(
        f"{names} and {'arpd' if own else 'the others'} never find each other's topics: {listed(theirs)} there, "
        f"{listed(sorted(usual))} here",
        *mends,
    )


CHECKS = (clock, power_save, signal, region, mtu, discovery, transports)
