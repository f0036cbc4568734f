import pathlib,sys
def edit(path,pairs):
    p=pathlib.Path(path); t=p.read_text()
    for a,b in pairs:
        if t.count(a)!=1: print('MISS',path,t.count(a),repr(a[:90])); continue
        t=t.replace(a,b)
    p.write_text(t)
edit('docs/design.md',[
("""takes and returns frozen values; `arpd/daemon/tick.py` shows the whole. What a tick costs grows with what has changed:

- Every tick observes the link, updates the estimate, and sends price and probes.
- While more than half of the link is used the daemon also looks every 30 ms, because a fall fills the queue within a few of these. A
  look sees reports that wait, bytes before the interface for 10 ms of link time, a ping that is 20 ms late, a probe that is due.
  Without any of these there is no tick.
- Twice a second a tick also *plans*: it solves the program, governs, applies and reports. One plans at once when the state of the
  link, the number of publishers, the interface or the configuration changes, or while a plan is under way and nodes have told
  something. After one that takes long none plans for thirty times its duration, two seconds at most. After one that raises, the
  next plans.
""",
"""takes and returns frozen values; `arpd/daemon/tick.py` shows the whole.

- Every tick observes the link, updates the estimate, and sends price and probes that are due.
- Twice a second a tick also *plans*: it solves the program, governs, applies and reports. One plans at once when the state of the
  link, the number of publishers, the active daemon, the interface or the configuration changes, or while a plan is under way and nodes
  have told something. After one that takes long none plans for thirty times its duration, two seconds at most. After one that raises,
  the next plans.
- While more than half of the link is used the daemon also looks every 30 ms, because a fall fills the queue within a few of these. A
  look sees reports that wait, bytes before the interface for 10 ms of link time, a ping that is 20 ms late, a probe that is due.
  Without any of these, a queue or an outage there is no tick.
"""),
("- A thread looks at the graph once a second, and reads it only after it has changed, which the middleware tells\n","- A thread looks at the graph five times a second, and reads it only after it has changed, which the middleware tells\n"),
("""`failed`, one whose ν misses B as `disagreed`; the closed form then answers. On random links of robots with up to 100 topics neither
happens in a thousand; on problems over six decades of weights and ceilings OSQP leaves one in 130 (`tests/agreement`).
""","""`failed`, one whose ν misses B as `disagreed`; the closed form then answers. On 1,000 random links of robots with up to 100 topics neither
happens; of 2,000 problems over six decades of weights and ceilings OSQP leaves 14 (`tests/agreement`).
"""),
("""peer` reports the delays of the pings, the dispersion of the trains, and the bytes and packets its interface received. Probes and
reports together take about 1 % of the capacity: pings and their reports 0.35 %, trains a token bucket with the rest. A calm link
gets at most one train in 2.5 s, and the savings are spent after a fall, or when a train contradicts the capacity. At least one
train leaves in 15 s, unless a queue stands or the link is out. While the link rests, one
leaves in 60 s, after the first eight.
""","""peer` reports the delays of the pings, the dispersion of the trains, and the bytes and packets its interface received. Probes and
reports together take 0.8 % of the capacity, more only on a very slow link: pings and their reports 0.35 %, trains a token bucket with
the rest. A calm link gets at most one train in 2.5 s, and the savings are spent after a fall, or when a train contradicts the capacity.
At least one train leaves in 15 s, unless a queue stands or the link is out. While the link rests, one leaves in 60 s, after the first
eight.
"""),
("| what was carried | at each report while nothing proves a busy link | low: the link may carry much more |","| what was carried | at each report of more than half of C, while nothing proves a busy link | low: the link may carry much more |"),
("| a ping meets no queue, or meets one | the link carries at least half of C, and the bytes show no queue; not with two ends,","| a ping meets no queue, or meets one | the link carries more than half of C, and the bytes show no queue; not with two ends,"),
("""The *stated* capacity is a little below the median, and the one stated before as long as that lies
between the 30 % and the 45 % quantile: a link that may have recovered or not has two likely capacities, and what lies between is
none of them. Until three trains have
arrived, the configured capacity is stated. A change of more than 1.5 % is an event, `down` or `up`; the others are `first`,
`outage`, `resume` and `local` (`arpd_estimator_events_total`).
""","""The *stated* capacity is the 45 % quantile, and the one stated before as long as that lies between the 30 % and the 45 % quantile: a
link that may have recovered or not has two likely capacities, and what lies between is none of them. Until three trains have arrived,
the configured capacity is stated. A change of more than 1.5 % is an event, `down` or `up`; the others are `first`, `outage`, `resume`
and `local`.
"""),
("""transmission of up to 16 packets, unseen. One seed each, so a difference of a third of a queue, or of a few per cent of error, may be
chance. What stands in italics was taken out for that.
""","""transmission of up to 16 packets, unseen. One seed each, so a difference of a third of a queue, or of a few per cent of error, may be
chance.
"""),
("| *debts of cross traffic* | 0.3 | 0.6 | 8 | 9.4 | 93 | 1174 | 61 | 149 | 4.5 |\n",""),
("""| *caution with a wide belief* | 0.3 | 0.6 | 8 | 9.3 | 96 | 1174 | 61 | 186 | 4.7 |
| *a train is no backlog* | 0.4 | 1.0 | 18 | 9.1 | 180 | 558 | 61 | 186 | 4.5 |
| *rest without topics* | 0.3 | 0.6 | 8 | 9.3 | 84 | 1174 | 61 | 186 | 4.5 |

Of the governor's rules, switched off one by one on links that swing, on the walk, on noise and on the cellular link (seeds 1 and 2), neither
the order of swaps by use, nor patience after a relapse, nor the wait before other topics join a plan changed the swaps on any but the
cellular link: 25.5 in two minutes there, and 26.5 without the order by use, 27 where every plan brings all that differs, 34.5 without the budget of swaps.
""",""),
("""`arpd/estimate/cross_traffic.py` measures what the interface carries and topics and probes do not explain, over 3 s. Bytes
of an outage may come again once.
40 kB/s and 5 % of the topics' own traffic do not count: discovery, reports and the error of the wire model. The rest is subtracted from
the capacity, up to half of the capacity, because a TCP upload takes all that arpd leaves it. The metric is
`arpd_link_foreign_bytes_per_second`.
""","""`arpd/estimate/cross_traffic.py` measures what the interface carries and topics and probes do not explain, over 3 s. Bytes of an outage
may come again once. 40 kB/s and 5 % of the topics' own traffic do not count: discovery, reports and the error of the wire model. The
rest is subtracted from the capacity, up to half of it, because a TCP upload takes all that arpd leaves it. The metric is
`arpd_link_foreign_bytes_per_second`.
"""),
("""reserve would only be lost, and the loop keeps the queue short. In an outage a twentieth of η·A goes on, halved every second, because
the silence may be the peer's alone: the floors of the heaviest topics last longest.

The *lasting* budget is η·A as it was for nine tenths of the last 30 s. It leaves out queues and outages, because they pass.
""","""reserve would only be lost, and the loop keeps the queue short. In an outage a twentieth of η·A goes on, halved every second, and nothing
after ten: the silence may be the peer's alone. The floors of the heaviest topics last longest.

The *lasting* budget is η·A as it was for nine tenths of the last 30 s, divided by what packets cost then. It leaves out queues and
outages, because they pass.
"""),
("""weight* have no floor, and those of that weight keep a part of it. It goes out when it has changed by more than 1 %, and once a
second (`arpd/model/price.py`, `arpd/govern/broadcast.py`).
""","""weight* have no floor, and those of that weight keep a part of it. It goes out when it has changed by more than 1 %, and once a
second; on a slow link less often, so that it takes 2 % at most, unless the price falls by more than a tenth (`arpd/model/price.py`,
`arpd/govern/broadcast.py`).
"""),
("is more than 10 % too short or shorter than the period of the rate, or when the history is more than 10 % and one sample too deep.","is more than 10 % too short or shorter than the period of the rate, or when the history is too deep by more than 10 % and one sample."),
("| `demand` | for `hold`, a source wants a rate that differs by more than 25 % from the one that the plan was made for |","| `demand` | for `hold`, the rate that a source wants or the size of its samples differs by more than 25 % from what the plan was made for |"),
("""themselves every 9 s. While no topic crosses the daemon pings every 0.55 s, and sends a train once a minute.
""","""themselves every 9 s.
"""),
("""| publishers of a process, each with 10 samples a second | 1 | 20 | 300 |
|---|---:|---:|---:|
| bytes a second, with headers; before: statuses and counters | 400 | 2,720 | 25,400 |
| now | 320 | 510 | 3,770 |

Silent publishers take 290, 350 and 1,420. Measured with real nodes; 20 publishers whose numbers all differ take less than 2 kB.
""","""Measured with real nodes, headers included: a process with 20 publishers of 10 samples a second sends 510 bytes a second, one with 300
sends 3.8 kB; 20 publishers whose numbers all differ take less than 2 kB.
"""),
])
edit('arpd/README.md',[
("| report | What do we tell people? | everything → `Snapshot`, events | `arpd/report/decision_log.py` |","| report | What do we tell people? | everything → `Snapshot`, events | `arpd/report/situation.py`, `arpd/report/decision_log.py` |"),
("`arpd/daemon/tick.py` is the tick itself; read it first. Ten times a second it observes, estimates and sends the price; all stages have\ntheir turn twice a second, or at once when something changes.","`arpd/daemon/tick.py` is the tick itself; read it first. Ten times a second it observes, estimates and prices; all stages have their turn\ntwice a second, or at once on news."),
("| change the relay with one end | `arpd/relay/ends/prefix.py`, `arpd/relay/ends/topic_readers.py` |","| change the relay with one end | `arpd/relay/ends/prefix.py`, `arpd/relay/ends/outgoing.py` |"),
("| change the relay with two ends | `arpd/relay/ends/end.py`, `arpd/relay` |","| change the relay with two ends | `arpd/relay/ends/end.py`, `arpd/relay/ends/incoming.py`, `arpd/relay/link_queue.py` |"),
("| add a metric | `arpd/web` |","| add a metric | `arpd/web/metrics.py`, `arpd/web/topic_metrics.py` |"),
("| change a message on the network | `node_snapshot.py`, `plan_message.py`, `probe_messages.py` in `arpd/ros` |","| change a message on the network | `node_snapshot.py`, `snapshot_decoder.py`, `plan_message.py`, `price_message.py`, `probe_messages.py` in `arpd/ros`; `arpd/relay/envelope.py`, `arpd/relay/offers.py` |"),
])
edit('etc/prometheus/RUNBOOKS.md',[
("- Do: nothing for arpd, which resumes by itself at 0.6 of the earlier estimate. A robot that loses coverage at the same place\n  each time needs an access point there.","- Do: nothing for arpd, which resumes by itself and measures the link anew. A robot that loses coverage at the same place each time needs\n  an access point there."),
("  `journalctl -u arpd ARPD_EVENT=swap`. A node that hangs answers no plan (`timeout`), and\n  `ros2 topic echo /arpd/publishers` has no message of its writer.\n","  `journalctl -u arpd ARPD_EVENT=swap`. A node that hangs answers no plan (`timeout`).\n"),
("*warning, at once, more than six plans up and down in five minutes.* What the topics can count on swings by more than a fifth, and each swing\nlasts long enough for a new plan. Every plan causes writer swaps.","*warning, at once, more than six plans up and down in five minutes.* What the topics can count on swings, and each swing lasts long enough\nfor a new plan. Every plan causes writer swaps."),
("*warning, after 30 s.* Prometheus does not reach arpd. Messages keep flowing under its last plan; `lease` in arpd.yaml says how long.","*warning, after 30 s.* Prometheus does not reach arpd. Messages keep flowing under its last plan; `on_lost` in arpd.yaml says how long."),
])
edit('systemd/arpd.catalog',[
("peer is left to wait for, and the plan stays in force. The estimate then starts below its value before the outage.\nIf this lasts, check that the access point is in reach and that arpd-peer runs on the other computer.","peer is left to wait for, and the plan stays in force. After an outage the link is measured anew. If this lasts, check\nthat the access point is in reach and that arpd-peer runs on the other computer."),
])
edit('docs/operating.md',[
("Rates follow the link within a tick and make no event; those that the link takes for ten seconds do.\n\nRates follow","Rates follow"),
("computer restart, and apt prints the fault and the line to run. If a unit does not run with the new version, the units after it still\nrun the old one. To go back, install the older package with `--allow-downgrades`. A package of a checkout has the date and the hash of\nits commit in its version, so that apt upgrades to a later one. Update the daemon before its peers: a daemon understands reports of\npeers one version older, not newer ones. Restart your nodes after an upgrade; a running one keeps the old library.",
"computer restart, and apt prints the fault and the line to run. If a unit does not run with the new version, the units after it still\nrun the old one. To go back, install the older package with `--allow-downgrades`. A package of a checkout has the date and the hash of\nits commit in its version, so that apt upgrades to a later one. Give both computers the same version, and restart your nodes after an\nupgrade: a running one keeps the old library, and no message is read in another version of its format."),
("ROS does not tell\n  DEPTH, so the far side's writers have 10, or what `relay.topics` says. A message type","ROS does not tell\n  DEPTH, so the far side's writers hold a second of each topic, or what `relay.topics` says. A message type"),
])
