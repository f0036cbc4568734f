"""Cost of a sample on the wire: payload, headers, heartbeats and acknowledgements."""

from __future__ import annotations

import math

MTU_BYTES = 1500
ETHERNET_BYTES = 14
IPV4_BYTES = 20
UDP_BYTES = 8
MOST_DOMAIN = 232  # of ROS; the ports of a higher one do not exist (RTPS 2.3 §9.6.1)
_HEADERS_BYTES = ETHERNET_BYTES + IPV4_BYTES + UDP_BYTES
# RTPS 2.3 §9.4: header 20 and INFO_DST 16. Fast DDS 2.14 ends every datagram with a submessage of 60 bytes for its
# statistics module. All sizes here are those of captured frames.
_RTPS_BYTES = 20 + 16 + 60
DATA_BYTES = _RTPS_BYTES + 12 + 24  # INFO_TS and the DATA submessage's header
_DATA_FRAG_BYTES = _RTPS_BYTES + 12 + 36
#: Largest RTPS message of arpd's writers (arpd/ros/fastdds.xml). Fast DDS keeps room for a heartbeat in each.
_MESSAGE_BYTES = 1392
FRAGMENT_BYTES = _MESSAGE_BYTES - _DATA_FRAG_BYTES - 32
_CUT_BYTES = MTU_BYTES - IPV4_BYTES  # of a datagram, in each packet
_DATAGRAM_BYTES = UDP_BYTES + DATA_BYTES  # its headers
#: Most packets of a small sample: it comes before larger ones, and the floor of `defaults` holds for it.
SMALL_PACKETS = 10
HEARTBEAT_BYTES = _HEADERS_BYTES + _RTPS_BYTES + 32
ACKNACK_BYTES = _HEADERS_BYTES + _RTPS_BYTES + 28
#: Largest IP packet of arpd's writers.
MOST_PACKET_BYTES = IPV4_BYTES + UDP_BYTES + _MESSAGE_BYTES
#: Heartbeat period of arpd's writers (arpd/ros/fastdds.xml) while something is unacknowledged.
HEARTBEAT_S = 0.05
#: And of those of a relay's two ends, where samples of many topics wait for a lost one before them.
LINK_HEARTBEAT_S = 0.03
#: A link that loses a smaller share of its packets is clean.
CLEAN_LOSS_RATIO = 0.005

# What Fast DDS 2.14 tells each participant of a writer that comes or goes; and rmw_dds_common's
# ParticipantEntitiesInfo: a GUID per endpoint, beside the names of the nodes.
_ENDPOINT_DATA_BYTES, _GUID_BYTES, _NODE_NAMES_BYTES = 1000, 16, 200


def domain_port(domain_id: int) -> int:
    """Return the UDP port of a domain's multicast discovery, the first of its ports (RTPS 2.3 §9.6.1)."""
    return 7400 + 250 * domain_id


def wire_size(payload_bytes: float, *, rate_hz: float) -> tuple[float, int]:
    """Return bytes and packets that one reliable sample puts on the link, for one reader.

    Fast DDS cuts a sample above ``FRAGMENT_BYTES`` into DATA_FRAG submessages, each in its own datagram (RTPS 2.3
    §8.3.7.3). A heartbeat asks for an acknowledgement at most once in ``HEARTBEAT_S``; on Wi-Fi both share the air with
    the data. So a slow topic pays for them with every sample, and several samples of a fast topic share them.

    Parameters
    ----------
    payload_bytes : serialized size of the sample (bytes)
    rate_hz : rate of the samples; ``inf`` = cost of the sample alone (Hz)

    Returns
    -------
    Wire bytes and packets, with heartbeat and acknowledgement.
    """
    fragments = max(1, math.ceil(payload_bytes / FRAGMENT_BYTES))
    headers = _HEADERS_BYTES + (DATA_BYTES if fragments == 1 else _DATA_FRAG_BYTES)
    acknowledgements = 1.0 / max(1.0, rate_hz * HEARTBEAT_S)  # and as many heartbeats
    wire_bytes = payload_bytes + fragments * headers + acknowledgements * (HEARTBEAT_BYTES + ACKNACK_BYTES)
    return wire_bytes, fragments + round(2.0 * acknowledgements)


def datagram_size(payload_bytes: float) -> tuple[float, int]:
    """Return bytes and packets of a sample in one datagram, which IP cuts at the MTU of Ethernet (RFC 791 §3.2)."""
    packets = math.ceil((_DATAGRAM_BYTES + payload_bytes) / _CUT_BYTES)
    return payload_bytes + _DATAGRAM_BYTES + packets * (ETHERNET_BYTES + IPV4_BYTES), packets


def datagram_payload(packets: int) -> int:
    """Return the payload of a datagram that fills so many packets (bytes)."""
    return packets * _CUT_BYTES - _DATAGRAM_BYTES


def swap_bytes(endpoints: int) -> float:
    """Return what a writer swap costs in discovery: its process tells each participant of the new and the old writer.

    100 swaps in a process of 100 relayed topics took 10.4 kB each and participant; this says 10.9.

    Parameters
    ----------
    endpoints : of the process of the writer
    """
    all_endpoints, _ = wire_size(_NODE_NAMES_BYTES + _GUID_BYTES * endpoints, rate_hz=math.inf)
    return 2.0 * (_ENDPOINT_DATA_BYTES + all_endpoints)


def probe_wire_bytes(data_bytes: int) -> int:
    """Return bytes that one best-effort probe packet with ``data_bytes`` of data puts on the link.

    It causes no heartbeat and no acknowledgement; the std_msgs layout and the CDR header take 16 bytes.
    """
    return _HEADERS_BYTES + DATA_BYTES + 16 + data_bytes
