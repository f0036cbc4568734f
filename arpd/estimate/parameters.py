"""The constants of the estimator's rules."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True, slots=True)
class EstimatorParameters:
    """Where they came from: a simulation study, then scripts/bench/estimate.py and the real link.

    Parameters
    ----------
    queue_high_s, queue_low_s : a standing queue, and next to none (s)
    burst_cap_s : most that the largest message adds to both (s)
    delivery_window_s, delay_window_s : over which delivery is averaged, and the least delay is looked for (s)
    burst_bytes, burst_share : least backlog that counts (bytes), and part of the largest message that does not
    down_interval_s, down_margin : a fall at most so often (s), and only to less than this part of the capacity
    undo_window_s, undo_ratio : so long after a fall, trains that see this part of what was before undo it
    agree_window_s, caution : two trains in this time (s) that see more are followed at once, to this part of the lesser
    train_window_s, train_memory_s : trains of this time are one opinion; older ones than this are none (s)
    up_after_down_s, climb_per_second : no rise so soon after a fall (s); most that one opinion moves the capacity
    outage_s, outage_forget_s : silence that is an outage, and one that changes what was known (s)
    peer_lost_s, resume_ratio : silence after which a peer is gone (s); part of the capacity believed after an outage
    resume_patience_s : how long after an outage a queue says nothing of the capacity (s)
    first_wait_s : how long the first plan waits for evidence (s)
    local_window_s : without a peer, span over which sending is averaged (s)
    clearly_more, fall_ratio : times the capacity: what is more than believed, and what is less
    surprise : part by which a train may differ before it is confirmed at once
    train_is_near_s : so long a train of ours may be part of what stands (s)
    alone_climb_per_second : without a peer, where only a queue tells that it was too much
    radio_share : most of a radio's bit rate that is ever left for data: 802.11 spends the rest on preambles,
        contention and acknowledgements
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
