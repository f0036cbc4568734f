"""The checks of `arpd doctor`, one function each: what it finds fine or wrong; NotKnownError where nobody tells."""

from __future__ import annotations

import re
from collections import Counter
from functools import partial
from shlex import quote
from typing import TYPE_CHECKING, Literal, NamedTuple

from arpd import __version__
from arpd.cli.no_daemon import failure
from arpd.host import kernel, radio
from arpd.host.interface import interface_to, ipv4_addresses, is_port, read_number
from arpd.model.errors import NotKnownError
from arpd.model.quantities import format_duration, format_number, format_share, format_size, printable
from arpd.model.wire import MOST_PACKET_BYTES, MTU_BYTES
from arpd.report.wording import count, listed
from arpd.ros.profile import profile_line
from arpd.ros.rmw import chosen_rmw

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from arpd.cli.here import Here
    from arpd.web.api import Peer

_MOST_OFFSET_S = 0.02  # a robot that turns at 1 rad/s is 1.1° further on by then
_LEAST_SIGNAL_DBM = -75
# Plain ROS 2 at rest: 0.5 kB/s per participant with its unicast part (docs/results.md, A link at rest), so this is 1 %
# of a link that carries 8 Mbit/s.
_MANY_PARTICIPANTS = 20
_ARPDS_PROCESSES = 2  # on another host, with one end: `arpd run` and `arpd relay`, or `arpd peer`
_ENOUGH_BUFFER_BYTES = 2 * 2**20  # 20 ms of a link that carries 100 MB/s
_SIZES = "rmem_default", "rmem_max"
_FEW_LOST, _LITTLE_LOST, _LITTLE_INCOMPLETE = 10, 1e-4, 0.01
_FAST_DDS = "RMW_IMPLEMENTATION=rmw_fastrtps_cpp"
_FOR_ARPD = "echo {} | sudo tee -a /etc/default/arpd && sudo systemctl restart 'arpd*'"
_LONGEST_LINE = 400
_TWO_ENDS = (
    "carry the topics with two ends: relay.link_domain in arpd.yaml, and ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST "
    "for your nodes"
)
# As `status_line` of the relay and `ProbeStatus` of the peer have it, and a far end that has nothing to do.
_HEARS_ITS_ROBOT = re.compile(
    r"\d+ of \d+ topics cross to the robot, \d+ of \d+ to the base computer$|.*; probes arrive since|nothing to do"
)
_KEEP_THE_CLOCK = (
    "sudo apt install chrony   # on both computers",
    *(
        f"{write} && sudo systemctl restart chrony   # without internet, on the {where}"
        for write, where in {
            "printf 'allow\\nlocal stratum 10\\n' | sudo tee /etc/chrony/conf.d/arpd.conf": "base computer",
            "echo 'server ADDRESS_OF_BASE iburst' | sudo tee /etc/chrony/sources.d/base.sources": "robot",
        }.items()
    ),
)
_BY_NETWORK_MANAGER = (
    "printf '[connection]\\nradio.powersave = 2\\n' | sudo tee /etc/NetworkManager/conf.d/zz-no-powersave.conf"
)
# udev knows the name that an interface gets from rule 80-net-setup-link on; NAME matches only those that are renamed.
_BY_UDEV = (
    'echo \'ACTION=="add", SUBSYSTEM=="net", ENV{DEVTYPE}=="wlan", RUN+="/usr/sbin/iw dev $name set power_save off"\' '
    "| sudo tee /etc/udev/rules.d/81-arpd-no-powersave.rules"
)
_LARGER_BUFFERS = (
    "printf 'net.core.rmem_default=8388608\\nnet.core.rmem_max=8388608\\n' | sudo tee "
    "/etc/sysctl.d/60-arpd-buffers.conf && sudo sysctl --system   # then restart arpd and your nodes"
)
# As "DDS tuning" of the ROS 2 documentation has it.
_SHORT_REASSEMBLY_S = 3
_SHORTER_REASSEMBLY = (
    f"printf 'net.ipv4.ipfrag_time={_SHORT_REASSEMBLY_S}\\nnet.ipv4.ipfrag_high_thresh=134217728\\n' | sudo tee "
    "/etc/sysctl.d/60-arpd-fragments.conf && sudo sysctl --system"
)
_AS_THE_NODES_USER = (
    "sudo systemctl edit arpd   # and the other services: User= and Group= of your nodes, as processes of different "
    "users exchange nothing then"
)


class Finding(NamedTuple):
    """What a check found, and the lines to type, or to do: the first one mends it now, others for good.

    Nothing that came from the network stands in a line: people copy them into a shell.
    """

    health: Literal["fine", "unknown", "wrong"]
    text: str
    remedies: tuple[str, ...] = ()


fine = partial(Finding, "fine")


def wrong(text: str, *remedies: str) -> Finding:
    """Find that something should be done."""
    return Finding("wrong", text, remedies)


def clock(here: Here) -> Finding:
    """Judge the offset between the ends: that of the peer that is worst, and of such ones the farthest off."""
    if not any(peer.clock for peer in here.status.peers):
        raise NotKnownError("no peer answered a probe in the last 30 s; run `arpd peer` on the base computer")
    farthest_first = sorted(here.status.peers, key=lambda peer: -abs(peer.clock.offset_s if peer.clock else 0.0))
    return max(map(_clock_of, farthest_first), key=lambda found: ("fine", "unknown", "wrong").index(found.health))


def _clock_of(peer: Peer) -> Finding:
    if peer.clock is None:
        return Finding("unknown", f"{peer.peer} answered no probe in the last 30 s")
    offset_s, error_s = peer.clock.offset_s, peer.clock.uncertainty_s
    found = f"the clock of {peer.peer} is {format_duration(abs(offset_s))} {'ahead of' if offset_s > 0 else 'behind'} "
    found += f"the robot's (± {format_duration(error_s)})"
    if abs(offset_s) - error_s > _MOST_OFFSET_S:
        return wrong(f"{found}: tf2 finds poses of another time, or none", *_KEEP_THE_CLOCK)
    if abs(offset_s) + error_s > _MOST_OFFSET_S:
        return Finding("unknown", f"{found}, too vague to judge; look again while the link is idle")
    return fine(found)


def power_save(here: Here) -> Finding:
    """Judge whether a radio sleeps between beacons."""
    for name in (radios := radio.radios_of(here.interface)):
        if radio.power_save(name):
            lasting = _BY_NETWORK_MANAGER if radio.runs_network_manager() else _BY_UDEV
            return wrong(
                f"{name} saves power: the access point holds its packets until the next beacon, 100 ms and more",
                f"sudo iw dev {quote(name)} set power_save off",
                f"{lasting}   # from the next start",
            )
    return fine(f"{listed(radios)} does not save power" if radios else f"{here.interface} has no radio")


def signal(here: Here) -> Finding:
    """Judge the strength of the signal."""
    signals = {name: radio.signal(name) for name in radio.radios_of(here.interface)}
    if not signals:
        return fine(f"{here.interface} has no radio")
    weakest = min(signals, key=signals.__getitem__)
    found = f"{weakest} receives {signals[weakest]} dBm"
    if signals[weakest] >= _LEAST_SIGNAL_DBM:
        return fine(found)
    return wrong(
        f"{found} now; below {_LEAST_SIGNAL_DBM} dBm the bit rate falls, and packets are lost",
        f"bring robot and access point closer, or use a better antenna; `iw dev {quote(weakest)} link` shows it",
    )


def region(here: Here) -> Finding:
    """Judge the regulatory domain; ``00`` is the one that holds everywhere."""
    if "00" not in (regions := [radio.region(name) for name in radio.radios_of(here.interface)]):
        return fine(f"the regulatory domain is {listed(regions)}" if regions else f"{here.interface} has no radio")
    return wrong(
        "no regulatory domain is set: the radio sends with little power, and on few channels of 5 GHz",
        "sudo iw reg set YOUR_COUNTRY   # its two letters",
        "echo 'options cfg80211 ieee80211_regdom=YOUR_COUNTRY' | sudo tee /etc/modprobe.d/arpd-region.conf   # lasting",
    )


def address(here: Here) -> Finding:
    """Judge whether DDS can use the link."""
    interface, own = here.interface, here.own_end
    if own and not kernel.is_own_address(own):
        return wrong(
            f"{own} is no address of this computer, though relay.{'base' if here.is_far else 'robot'} says so",
            "ip -4 -br address   # correct both files, then: sudo systemctl restart 'arpd*'; start your nodes again",
        )
    if addresses := ipv4_addresses().get(interface):
        return fine(f"{interface} has {listed(sorted(addresses))}")
    if is_port(interface):
        return fine(f"{interface} is a port of another interface, which has the address")
    return wrong(
        f"{interface} has no IPv4 address, so nothing of arpd or of nodes with UDPv4 crosses it",
        f"ip address show dev {quote(interface)}   # give it one, by DHCP or as `ip address add ADDRESS/24 dev` does",
    )


def mtu(here: Here) -> Finding:
    """Judge the largest packet that the link takes whole."""
    interface, mtu_bytes = here.interface, kernel.read_mtu(here.interface)
    cut = f"arpd's packets have up to {MOST_PACKET_BYTES}, so IP cuts each"
    if mtu_bytes < MOST_PACKET_BYTES:
        return wrong(
            f"{interface} has an MTU of {mtu_bytes} bytes; {cut}",
            f"sudo ip link set dev {quote(interface)} mtu {MTU_BYTES}   # a tunnel takes less: {MOST_PACKET_BYTES}",
        )
    route_bytes = (here.other_end and kernel.route_mtu(here.other_end)) or mtu_bytes
    if route_bytes < MOST_PACKET_BYTES:
        return wrong(
            f"the route to the other end takes {route_bytes} bytes, less than {interface} ({mtu_bytes}); {cut}",
            f"raise the MTU on the way to {MOST_PACKET_BYTES} or more; `tracepath` to the other end shows where",
        )
    return fine(f"{interface} takes packets of {min(mtu_bytes, route_bytes)} bytes")


def discovery(here: Here) -> Finding:
    """Judge how many participants other than arpd's announce themselves on the link.

    With two ends nobody needs to. With one end the nodes find each other across the link, so only many are too many,
    and those that tell of two networks get each sample twice.
    """
    heard, has_two_ends = here.heard, here.settings.relay.link_domain is not None
    for one in (one for one in heard.announcers if not one.is_here and not has_two_ends):
        reached = [address for address in sorted(one.addresses) if interface_to(address) == here.interface]
        if len(reached) > 1:
            return wrong(
                f"{one.process} of {one.host} tells {len(reached)} addresses that {here.interface} leads to "
                f"({listed(reached)}), so every sample for it crosses {len(reached)} times",
                _TWO_ENDS,
                "or keep its nodes off the other network: an interfaceWhiteList in their Fast DDS profile",
            )
    own = [one.process for one in heard.announcers if one.is_here and not one.is_arpds]
    by_host = Counter(one.host for one in heard.announcers if not one.is_here)
    if not has_two_ends:  # else arpd's own are in the link domain
        by_host = +Counter({host: many - _ARPDS_PROCESSES for host, many in by_host.items()})
    where = f"{here.interface} (domain {heard.domain_id})"
    if not (others := len(own) + by_host.total()):
        return fine(f"no node but arpd's announces itself on {where}")
    names = [f"{len(own)} of this computer ({listed(sorted(set(own)))})"] if own else []
    names += [f"{many} of {host}" for host, many in sorted(by_host.items())]
    rate = f"{format_number(heard.bytes_per_second / 1e3, digits=2)} kB/s"
    found = f"{count(others, 'participant')} on {where}: {listed(names)}; all multicast discovery there takes {rate}"
    if has_two_ends:
        return wrong(
            f"{found}; the relay carries their topics already",
            "export ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST   # before your nodes start, on these computers",
        )
    if others <= _MANY_PARTICIPANTS:
        return fine(found)
    return wrong(f"{found}, and unicast discovery about twice as much", _TWO_ENDS)


def _may_share(memory: tuple[int, ...], shared: Iterable[tuple[int, ...]]) -> bool:
    """Return whether a process may share memory with one of others; of some nothing but the user is known."""
    return any(all(one == other for one, other in zip(memory, each, strict=False)) for each in shared)


def transports(here: Here) -> Finding:
    """Judge whether all participants can tell each other of their topics.

    They do so over TCP alone with FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA, and over UDP alone without it. The two kinds
    hear each other's announcements, but never find each other's topics. With LARGE_DATA samples cross within one
    computer through shared memory alone, which processes of different users or containers do not have.
    """
    if not (told := [one for one in here.heard.announcers if one.transports]):
        return fine("nobody announces itself, so nobody is cut off")
    own = [one.transports for one in told if one.is_arpds]
    ((usual, _number),) = Counter(own or [one.transports for one in told]).most_common(1)
    if not (apart := [one for one in told if not one.transports & usual]):
        shared = [one.memory for one in told if one.is_arpds and one.memory]
        hidden = {one.process for one in told if one.memory and shared and not _may_share(one.memory, shared)}
        if not hidden or not any(name.startswith("TCP") for name in usual):
            return fine(f"all participants share {listed(sorted(usual))}")
        return wrong(
            f"{listed(sorted(hidden))} and arpd find each other and exchange nothing: with LARGE_DATA samples cross "
            "shared memory, and theirs is not arpd's (another user, or a container)",
            _AS_THE_NODES_USER,
            "docker run --ipc=host …   # for a node in a container",
        )
    theirs = sorted(frozenset[str]().union(*(one.transports for one in apart)))
    names = listed(sorted({one.process if one.is_here else f"{one.process} of {one.host}" for one in apart}))
    have_tcp = any(name.startswith("TCP") for name in theirs)
    if own and have_tcp:
        mends = [_FOR_ARPD.format("FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"), _AS_THE_NODES_USER]
    else:
        chosen = "unset FASTDDS_BUILTIN_TRANSPORTS" if have_tcp else "export FASTDDS_BUILTIN_TRANSPORTS=LARGE_DATA"
        mends = [f"{chosen}   # before these nodes start"]
    return wrong(
        f"{names} and {'arpd' if own else 'the others'} never find each other's topics: {listed(theirs)} there, "
        f"{listed(sorted(usual))} here",
        *mends,
    )


def receive_buffers(_here: Here, *, proc: Path = kernel.PROC) -> Finding:
    """Judge the receive buffers of sockets by what was lost for want of them.

    Nodes have the default size, and arpd asks for one, which the kernel cuts at its most.
    """
    sizes, udp = [read_number(proc / "sys/net/core" / name) for name in _SIZES], kernel.counters("Udp", proc=proc)
    if None in sizes or not {"InDatagrams", "RcvbufErrors"} <= udp.keys():
        raise NotKnownError("the kernel does not tell it (/proc/net/snmp, net.core.rmem_default, rmem_max)")
    size = min(each for each in sizes if each is not None)
    lost = udp["RcvbufErrors"]
    total = lost + udp["InDatagrams"]
    found = f"{lost} of {total} datagrams were lost for want of a receive buffer above {format_size(size)}"
    if size >= _ENOUGH_BUFFER_BYTES or lost < max(_FEW_LOST, _LITTLE_LOST * total):
        return fine(found)
    return wrong(f"{found} (net.core.rmem_default, rmem_max): {format_share(lost / total)}", _LARGER_BUFFERS)


def fragments(_here: Here, *, proc: Path = kernel.PROC) -> Finding:
    """Judge the reassembly of datagrams that IP cut; DDS cuts them itself in nodes with arpd's profile."""
    ip, kept_s = kernel.counters("Ip", proc=proc), read_number(proc / "sys/net/ipv4/ipfrag_time")
    if kept_s is None or not {"ReasmOKs", "ReasmFails"} <= ip.keys():
        raise NotKnownError("the kernel does not tell it (/proc/net/snmp, net.ipv4.ipfrag_time)")
    incomplete = ip["ReasmFails"]
    total = incomplete + ip["ReasmOKs"]
    found = f"{incomplete} of {total} datagrams that IP had cut never became whole, and were kept for {kept_s} s"
    if kept_s <= _SHORT_REASSEMBLY_S or incomplete < max(_FEW_LOST, _LITTLE_INCOMPLETE * total):
        return fine(found)
    return wrong(
        f"{found}; while they fill the memory no sample larger than a packet arrives from nodes without arpd's Fast "
        "DDS profile",
        _SHORTER_REASSEMBLY,
    )


def daemon(here: Here) -> Finding:
    """Judge what the daemon says of itself, as `arpd status` does; each sentence has its own way out."""
    said = [each.text for each in (here.status.verdict, *here.status.faults) if each.wrong]
    return wrong(" ".join(said)) if said else fine(here.status.verdict.text)


def profile(here: Here) -> Finding:
    """Judge whether the processes of all AdaptivePublishers have arpd's Fast DDS profile."""
    if not (lacking := sorted({topic.node for topic in here.status.topics if topic.confirmed.lacks_profile})):
        return fine("no AdaptivePublisher says that it lacks arpd's Fast DDS profile")
    return wrong(
        f"{count(len(lacking), 'node')} with AdaptivePublishers without arpd's Fast DDS profile: {listed(lacking)}; "
        "their swaps take longer, and lost packets cost whole samples",
        f"{profile_line()}   # before they start",
    )


def rmw(here: Here) -> Finding:
    """Judge the middleware: the daemon's, as no shell's environment reaches its unit, else this shell's."""
    told = None if isinstance(here.told, NotKnownError) else here.told
    name, refusal = (told.rmw, told.rmw_refusal) if told else ((own := chosen_rmw()).name, own.refusal)
    if not refusal:
        return fine(name)
    return wrong(
        refusal,
        f"export {_FAST_DDS}   # for all nodes of both ends",
        f"{_FOR_ARPD.format(_FAST_DDS)}   # for arpd, on both ends",
    )


def versions(here: Here) -> Finding:
    """Judge whether the running daemon is of this command's version."""
    if __version__ == (daemon := here.status.version):
        return fine(f"arpd {__version__}{' at both ends' if here.is_far else ''}")
    if here.is_far:
        return wrong(
            f"arpd {__version__} here, {daemon} on the robot; they may not understand each other",
            "install the newer one on the other end: sudo apt install ./arpd-ros_*.deb",
        )
    return wrong(f"arpd {__version__} is installed, and the running daemon is {daemon}", "sudo systemctl restart arpd")


def units(here: Here) -> Finding:
    """Judge arpd's units: those that failed, once or in a loop, and those that are enabled but do not run."""
    if here.units is None:
        raise NotKnownError("systemd does not run here, or does not answer")
    faults: dict[str, str] = {}
    for name, unit in here.units.items():
        if why := failure(name, unit):
            faults[why] = f"journalctl -u {name} -n 30   # the last line says why"
        elif unit.is_enabled and unit.active == "inactive":
            faults[f"{name} is enabled, and does not run"] = f"sudo systemctl start {name}"
    if faults:
        return wrong("; ".join(faults), *faults.values())
    well = [f"{name} is {unit.active}" for name, unit in here.units.items() if unit.active != "inactive"]
    return fine(listed(well, most=4) if well else "no unit of arpd is enabled")


def robots(here: Here) -> Finding:
    """Judge whether the far ends and peers of a base computer hear their robots, by what they say of themselves."""
    running = {
        name: unit.says
        for name, unit in (here.units or {}).items()
        if unit.active == "active" and unit.says and name.startswith(("arpd-relay-far", "arpd-peer"))
    }
    silent: dict[str, str] = {}  # one sentence for each robot: its relay knows more than its peer
    for name, says in sorted(running.items(), reverse=True):
        if not _HEARS_ITS_ROBOT.match(says):
            silent.setdefault(name.partition("@")[2], f"{name}: {printable(says, longest=_LONGEST_LINE)}")
    if silent:
        return wrong("; ".join(sorted(silent.values())), "systemctl status arpd arpd-relay   # on that robot")
    return fine(f"{listed(sorted(running), most=4)} hear their robots" if running else "no robot is served from here")


def configuration(here: Here) -> Finding:
    """Judge the configuration by its faults."""
    known = {str(path): faults for path, faults in here.faults.items() if faults is not None}
    if faults := [fault for each in known.values() for fault in each]:
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        check = f"arpd check {'--far ' if here.is_far else ''}"
        return wrong(f"{faults[0]}{more}", *(f"{check}{quote(path)}" for path, each in known.items() if each))
    if unread := [str(path) for path, faults in here.faults.items() if faults is None]:
        raise NotKnownError(f"there is no {listed(unread)}, or this user may not read it")
    return fine(f"{listed(sorted(known))} {'is' if len(known) == 1 else 'are'} valid")


CHECKS = (
    *(daemon, clock, power_save, signal, region, address, mtu, discovery, transports, receive_buffers, fragments),
    *(profile, rmw, versions, units, robots, configuration),
)
