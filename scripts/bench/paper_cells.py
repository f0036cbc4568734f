"""The configurations of the paper's evaluation, its links, and the turns of one round."""

from __future__ import annotations

import random
from dataclasses import dataclass

from arpd.solve.eq4 import Eq4Problem, whole

SENSORS = 11
TOPICS = SENSORS + 1  # N: all sensing topics and the one of actuation
RMAX_HZ = (100, 200, 500, 1000)
FIXED_DEPTHS = (1, 5000)
PAYLOADS_BYTES = (10, 100, 1000)
LIVE_HZ = 100  # of every source under arpd: more than 2.4 GHz carries of 1000 B, less than it carries of 10 B

FIGURES, LOSS, LIVE = "figures", "loss", "live"
DEFAULT, ARPD = "rclpy's default", "arpd's"
HEARTBEAT_S = {DEFAULT: 3.0, ARPD: 0.05}

# Residual loss of Wi-Fi. A station tries a frame seven times (IEEE 802.11 dot11ShortRetryLimit, 7 by default), so a
# packet that DDS misses has failed seven times: if three frames of ten fail, as on a busy 2.4 GHz channel, that is
# 0.3^7 = 0.02 %. A bench with a limit of eight measured 0.03 %, with three 0.26 %
# (github.com/OpenIPC/devourer/pull/367). Not simulated: the time of repetitions, and a frame's fixed airtime; small
# samples are cheaper here than on air.
FRAME_ERROR = 0.3
ATTEMPTS = 7


@dataclass(frozen=True, kw_only=True, slots=True)
class LinkProfile:
    """A link, the same in both directions.

    Parameters
    ----------
    rate_bytes_per_second, queue_bytes : of the token bucket (bytes/s, bytes)
    loss : probability that a packet is lost behind it (0..1)
    """

    name: str
    rate_bytes_per_second: float
    queue_bytes: int
    loss: float


# 8 Mbit/s is what one station may get of a shared 20 MHz channel; 256 kB is about the queue of a driver.
WIFI = LinkProfile(
    name="2.4 GHz", rate_bytes_per_second=8e6 / 8, queue_bytes=256_000, loss=round(FRAME_ERROR**ATTEMPTS, 6)
)
WIRED = LinkProfile(name="wired", rate_bytes_per_second=1e9 / 8, queue_bytes=1_000_000, loss=0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Configuration:
    """DEPTH (samples) and DEADLINE (as a rate, Hz) of both ends of all topics, and the payload of each sample.

    Under arpd the rate is that of the sources, and DEPTH 0 stands for what arpd chooses.
    """

    depth: int
    deadline_hz: int
    payload_bytes: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Turn:
    """One run of one configuration.

    Parameters
    ----------
    experiment : FIGURES, LOSS or LIVE
    loss : of the link in this turn (0..1)
    heartbeat : whose heartbeat period the writers have: DEFAULT or ARPD
    """

    experiment: str
    link: LinkProfile
    loss: float
    heartbeat: str
    configuration: Configuration


def optimum(rmax_hz: int) -> tuple[int, int]:
    """Return (R, D) of Eq. (4) as in the paper's Table 2 (Hz, samples)."""
    rate_hz, depth = Eq4Problem(max_rate_hz=rmax_hz, topics=TOPICS).vertex()
    return whole(rate_hz), whole(depth)


def configurations(payload_bytes: int) -> list[Configuration]:
    """Return DEPTH {1, 5000, D} × DEADLINE {Rmax, R} for each Rmax and its own (R, D): 24."""
    cells = set()
    for rmax_hz in RMAX_HZ:
        rate_hz, depth = optimum(rmax_hz)
        cells |= {(d, hz) for hz in (rmax_hz, rate_hz) for d in (*FIXED_DEPTHS, depth)}
    return [Configuration(depth=d, deadline_hz=hz, payload_bytes=payload_bytes) for d, hz in sorted(cells)]


def figure_turns(links: tuple[LinkProfile, ...] = (WIFI, WIRED)) -> list[Turn]:
    """Return every turn of Figures 3 and 4."""
    return [
        Turn(experiment=FIGURES, link=link, loss=link.loss, heartbeat=DEFAULT, configuration=cell)
        for link in links
        for payload_bytes in PAYLOADS_BYTES
        for cell in configurations(payload_bytes)
    ]


def loss_turns() -> list[Turn]:
    """Return the turns on the cost of a lost packet: an optimum and its rate at DEPTH 5000, with both heartbeats."""
    rate_hz, depth = optimum(max(RMAX_HZ))
    return [
        Turn(
            experiment=LOSS,
            link=WIFI,
            loss=loss,
            heartbeat=heartbeat,
            configuration=Configuration(depth=each, deadline_hz=rate_hz, payload_bytes=100),
        )
        for loss in (0.0, 0.0001, 0.001, 0.01)
        for heartbeat in HEARTBEAT_S
        for each in (depth, max(FIXED_DEPTHS))
    ]


def live_turns(payloads_bytes: tuple[int, ...] = PAYLOADS_BYTES) -> list[Turn]:
    """Return the turns under `arpd run` with the uniform policy, which finds Rmax, R and D itself."""
    return [
        Turn(
            experiment=LIVE,
            link=WIFI,
            loss=WIFI.loss,
            heartbeat=ARPD,
            configuration=Configuration(depth=0, deadline_hz=LIVE_HZ, payload_bytes=payload_bytes),
        )
        for payload_bytes in payloads_bytes
    ]


def command_number(index: int, number: int) -> int:
    """Return the number of the command that answers a sample of a sensor; divmod by SENSORS gives both back."""
    return number * SENSORS + index


def quick_turns() -> list[Turn]:
    """Return turns that a busy machine can generate, on the lossy link: both depths, an optimum, and arpd."""
    rate_hz, depth = optimum(max(RMAX_HZ))
    cells = [
        Configuration(depth=d, deadline_hz=hz, payload_bytes=100) for d, hz in ((1, 100), (5000, 100), (depth, rate_hz))
    ]
    figures = [Turn(experiment=FIGURES, link=WIFI, loss=WIFI.loss, heartbeat=DEFAULT, configuration=c) for c in cells]
    return [*figures, *live_turns(payloads_bytes=(max(PAYLOADS_BYTES),))]


def shuffled(turns: list[Turn], *, seed: int) -> list[Turn]:
    """Return a round: every turn once, in random order."""
    return random.Random(seed).sample(turns, len(turns))
