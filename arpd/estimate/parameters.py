"""Constants of the estimator."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorParameters:
    """Constants of the estimator, from scripts/bench/estimate.py and the real link.

    Parameters
    ----------
    queue_low_s : delay that is no queue for the gauges of pings and bytes (s)
    burst_cap_s : most that the largest message adds to it (s)
    standing_s : a queue that stays for so long stands (s)
    busy_s, busy_after_s : by the pings, the link is never idle while a longer queue stays for so long (s)
    idle_s : a ping that is delayed by less met no queue (s)
    used : part of the capacity from which on the absence of a queue shows that there is more
    ping_weight, look_weight : evidence in a ping, and in a look at an empty queue of this host: several meet one burst
    queued_here_s : such a look counts for so long after a queue was seen there, so it is the one of the link (s)
    recent_s : span of the delivery that counts while a queue stays (s)
    caution : part of what arrived that counts as carried
    foreign : a peer that receives this multiple of what this host sends hears others, too
    noticed, fallen : relative change that is stated; part of the capacity below which trains are urgent
    urgent_s : time in which they are (s)
    delivery_window_s, delay_window_s : span of the mean delivery, and of the least delay (s)
    burst_bytes, burst_share : backlog that is no queue: so many bytes, or this part of the largest message
    train_memory_s : age at which a train is forgotten (s)
    outage_s, outage_forget_s : silence that is an outage, and silence after which measurements are forgotten (s)
    peer_lost_s : silence after which a peer is gone (s)
    resume_patience_s : time after an outage in which deliveries say nothing of the capacity (s)
    first_wait_s : time that the first plan waits for evidence (s)
    local_window_s : span over which sending is averaged without a peer (s)
    surprise : relative difference at which a train is confirmed at once
    train_is_near_s : age up to which a train of ours may be part of a backlog (s)
    radio_share : most of a radio's bit rate that carries data: 802.11 spends the rest on preambles, contention and
        acknowledgements
    """

    queue_low_s: float = 0.050
    burst_cap_s: float = 0.200
    standing_s: float = 0.2
    busy_s: float = 0.012
    busy_after_s: float = 0.5
    idle_s: float = 0.003
    used: float = 0.5
    ping_weight: float = 0.8
    look_weight: float = 0.3
    queued_here_s: float = 5.0
    recent_s: float = 0.15
    caution: float = 0.95
    foreign: float = 1.1
    noticed: float = 0.015
    fallen: float = 0.8
    urgent_s: float = 10.0
    delivery_window_s: float = 0.300
    delay_window_s: float = 10.0
    burst_bytes: float = 15_000.0
    burst_share: float = 0.5
    train_memory_s: float = 30.0
    outage_s: float = 0.4
    outage_forget_s: float = 1.0
    peer_lost_s: float = 10.0
    resume_patience_s: float = 0.5
    first_wait_s: float = 3.0
    local_window_s: float = 1.0
    surprise: float = 0.2
    train_is_near_s: float = 0.4
    radio_share: float = 0.7
