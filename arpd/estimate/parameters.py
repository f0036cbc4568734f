"""Constants of the estimator's rules."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorParameters:
    """Constants of the rules, from a simulation study, scripts/bench/estimate.py and the real link.

    Parameters
    ----------
    queue_high_s, queue_low_s : a queue stands above the one, and is gone below the other (s)
    burst_cap_s : most that the largest message adds to both (s)
    delivery_window_s, delay_window_s : span of the mean delivery, and of the least delay (s)
    burst_bytes, burst_share : backlog that is no queue: so many bytes, or this part of the largest message
    down_interval_s, down_margin : least time between falls (s); a fall needs a delivery below this part of the capacity
    undo_window_s, undo_ratio : time in which trains may undo a fall (s), and part of the earlier capacity they must see
    agree_window_s, caution : span of two trains that agree on more (s), and part of the lesser to believe then
    train_window_s, train_memory_s : span of trains that count together, and age at which a train is forgotten (s)
    up_after_down_s, climb_per_second : time after a fall without *follow* (s), and the most it moves the capacity (1/s)
    outage_s, outage_forget_s : silence that is an outage, and silence after which measurements are forgotten (s)
    peer_lost_s, resume_ratio : silence after which a peer is gone (s); part of the capacity believed after an outage
    resume_patience_s : time after an outage in which deliveries say nothing of the capacity (s)
    first_wait_s : time that the first plan waits for evidence (s)
    local_window_s : span over which sending is averaged without a peer (s)
    clearly_more, fall_ratio : multiples of the capacity that count as more, and as less
    surprise : relative difference at which a train is confirmed at once
    train_is_near_s : age up to which a train of ours may be part of a backlog (s)
    alone_climb_per_second : rise without a peer, where only a queue shows that it went too far (1/s)
    radio_share : most of a radio's bit rate that carries data: 802.11 spends the rest on preambles, contention and
        acknowledgements
    """

    queue_high_s: float = 0.100
    queue_low_s: float = 0.050
    burst_cap_s: float = 0.200
    delivery_window_s: float = 0.300
    delay_window_s: float = 10.0
    burst_bytes: float = 15_000.0
    burst_share: float = 0.5
    down_interval_s: float = 0.250
    down_margin: float = 0.95
    undo_window_s: float = 10.0
    undo_ratio: float = 0.85
    agree_window_s: float = 2.5
    caution: float = 0.95
    train_window_s: float = 4.0
    train_memory_s: float = 30.0
    up_after_down_s: float = 0.5
    climb_per_second: float = 0.5
    outage_s: float = 0.4
    outage_forget_s: float = 1.0
    peer_lost_s: float = 10.0
    resume_ratio: float = 0.6
    resume_patience_s: float = 0.5
    first_wait_s: float = 3.0
    local_window_s: float = 1.0
    clearly_more: float = 1.1
    fall_ratio: float = 0.96
    surprise: float = 0.2
    train_is_near_s: float = 0.4
    alone_climb_per_second: float = 0.025
    radio_share: float = 0.7
