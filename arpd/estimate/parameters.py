"""Constants of the estimator, from scripts/bench/estimate.py and the real link."""

from __future__ import annotations

# The queue.
QUEUE_LOW_S = 0.050  # delay that is no queue for the gauges of pings and bytes
BURST_CAP_S = 0.200  # most that the largest message adds to it
STANDING_S = 0.2  # a queue that stays for so long stands
BUSY_S, BUSY_AFTER_S = 0.012, 0.5  # by the pings, the link is never idle while a longer queue stays for so long
IDLE_S = 0.003  # a ping that is delayed by less met no queue
BURST_BYTES, BURST_SHARE = 15_000.0, 0.5  # backlog that is no queue: so many bytes, or this part of the largest message
DELIVERY_WINDOW_S, DELAY_WINDOW_S = 0.300, 10.0  # span of the mean delivery, and of the least delay

RESTING, RESTING_S = 0.02, 2.0  # part of the capacity below which the link rests, after so long
SHOWS_S = 0.8  # time in which a train may show in the reports of a link that rests

# The capacity.
USED = 0.5  # part of the capacity from which on the absence of a queue shows that there is more
# Evidence in a ping, and without a peer in a look at an empty queue of this host: several meet one burst.
PING_WEIGHT, LOOK_WEIGHT = 0.8, 0.3
RECENT_S = 0.15  # span of the delivery that counts while a queue stays
CAUTION = 0.95  # part of what arrived that counts as carried
OTHERS = 1.1  # a peer that receives this multiple of what this host sends hears others, too
NOTICED = 0.015  # relative change that is stated
FALLEN, URGENT_S = 0.8, 10.0  # part of the capacity below which trains are urgent, and time in which they are
# Most of a radio's bit rate that carries data: 802.11 spends the rest on preambles, contention and acknowledgements.
RADIO_SHARE = 0.7

# Silence.
OUTAGE_S, OUTAGE_FORGET_S = 0.4, 1.0  # silence that is an outage, and silence after which measurements are forgotten
OUTAGE_QUIETS = 2.2  # the same in periods at which a peer reports without being asked: one of them may be lost
LATE_QUEUE_S = 1.0  # queue that explains why a peer is silent
PEER_LOST_S = 10.0  # silence after which a peer is gone
RESENDS_S = 1.0  # time after an outage in which what it took is sent again
FIRST_WAIT_S = 3.0  # time that the first plan waits for evidence
