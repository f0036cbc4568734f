"""What one sample costs on the wire: RTPS, UDP, IP and Ethernet around the payload."""

from __future__ import annotations

import math

MTU_BYTES = 1500
ETHERNET_BYTES = 14
IPV4_BYTES = 20
UDP_BYTES = 8
# RTPS 2.3 §9.4: header 20, INFO_DST 16, INFO_TS 12, DATA 24 and a HEARTBEAT 32 with it.
RTPS_BYTES = 104
# A reliable reader answers with an ACKNACK in a packet of its own; on Wi-Fi it shares the air with the data.
ACKNACK_BYTES = ETHERNET_BYTES + IPV4_BYTES + UDP_BYTES + 72


def wire_size(payload_bytes: float) -> tuple[float, int]:
    """Bytes and packets one reliable sample puts on the link, for one reader.

    Fast DDS sends up to 64 kB in one UDP datagram, which IP cuts into fragments of the MTU.

    Parameters
    ----------
    payload_bytes : serialized size of the sample (bytes)

    Returns
    -------
    Wire bytes, acknowledgement included, and packets of the sample itself.
    """
    datagram = UDP_BYTES + RTPS_BYTES + payload_bytes
    packets = max(1, math.ceil(datagram / (MTU_BYTES - IPV4_BYTES)))
    return datagram + packets * (ETHERNET_BYTES + IPV4_BYTES) + ACKNACK_BYTES, packets


def probe_wire_bytes(data_bytes: int) -> int:
    """Bytes one best-effort probe packet with ``data_bytes`` of data puts on the link.

    No heartbeat and no acknowledgement; the std_msgs layout and CDR header cost 20 bytes.
    """
    return ETHERNET_BYTES + IPV4_BYTES + UDP_BYTES + RTPS_BYTES - 32 + 20 + data_bytes
