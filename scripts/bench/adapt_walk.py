"""Make the trace that `adapt.py` plays as `wifi-walk`: a walk with a Wi-Fi robot, from a seed.

Usage: .venv/bin/python -m scripts.bench.adapt_walk [--seed N] [--to FILE]

The signal-to-noise ratio comes from log-distance path loss, shadowing that changes with the place (Gudmundson 1991) and
short fades when a person steps between robot and access point. The ratio gives the MCS of 802.11n (20 MHz, one stream,
800 ns guard interval). A channel shared with neighbours leaves about a third of the MCS's rate.
"""

from __future__ import annotations

import argparse
import math
import random
from pathlib import Path

TRACE = Path(__file__).with_name("wifi_walk.csv")
SEED = 4
DURATION_S = 28.0
_STEP_S = 0.2
_CALM_S = 5.0

# 802.11n, 20 MHz, one stream: rate (Mbit/s) and the least signal-to-noise ratio that carries it (dB)
_MCS = ((6.5, 5.0), (13.0, 8.0), (19.5, 11.0), (26.0, 14.0), (39.0, 18.0), (52.0, 22.0), (58.5, 24.0), (65.0, 26.0))
_EFFICIENCY = 0.31  # of the MCS's rate: preambles, acknowledgements, contention, the neighbours' traffic
_LEAST_BIT_PER_S = 1.5e6
_EIRP_DBM, _NOISE_DBM = 15.0, -92.0
_LOSS_AT_1_M_DB, _EXPONENT = 40.0, 3.3  # 2.4 GHz, indoors through some walls
_SHADOWING_DB, _DECORRELATION_M = 4.0, 3.0
_NEAR_M, _FAR_M = 6.0, 28.0
_FADE_EVERY_S, _FADE_DB, _FADE_S = 6.0, (6.0, 14.0), (0.4, 1.2)
_TIGHT_DB = 1.0  # above its least ratio; within this, an MCS loses packets in spite of retries
_TIGHT_LOSS = 0.02


def walk(seed: int = SEED) -> list[tuple[float, float, float]]:
    """Return time (s), rate (bit/s) and loss (0..1), one row per change."""
    rng = random.Random(seed)
    shadowing_db = 0.0
    fade_db = fade_until_s = 0.0
    rows: list[tuple[float, float, float]] = []
    before_m = _NEAR_M
    for k in range(round(DURATION_S / _STEP_S)):
        now_s = k * _STEP_S
        here_m = distance_m(now_s)
        kept = math.exp(-abs(here_m - before_m) / _DECORRELATION_M)
        shadowing_db = kept * shadowing_db + math.sqrt(1.0 - kept**2) * rng.gauss(0.0, _SHADOWING_DB)
        before_m = here_m
        if now_s >= _CALM_S and now_s >= fade_until_s:
            fade_db = 0.0
            if rng.random() < _STEP_S / _FADE_EVERY_S:
                fade_db, fade_until_s = rng.uniform(*_FADE_DB), now_s + rng.uniform(*_FADE_S)
        snr_db = _EIRP_DBM - _LOSS_AT_1_M_DB - 10.0 * _EXPONENT * math.log10(here_m) - _NOISE_DBM
        rate, loss = carried(snr_db + shadowing_db - fade_db + (rng.gauss(0.0, 0.7) if now_s >= _CALM_S else 0.0))
        if not rows or rows[-1][1:] != (rate, loss):
            rows.append((round(now_s, 1), rate, loss))
    return rows


def distance_m(now_s: float) -> float:
    """Return the distance to the access point: the robot stands, goes away and comes back (m)."""
    if now_s < _CALM_S:
        return _NEAR_M
    turned = (now_s - _CALM_S) / (DURATION_S - _CALM_S)
    return _NEAR_M + (_FAR_M - _NEAR_M) * 0.5 * (1.0 - math.cos(2.0 * math.pi * turned))


def carried(snr_db: float) -> tuple[float, float]:
    """Return rate (bit/s) and loss (0..1) of the best MCS for this signal-to-noise ratio."""
    usable = [(rate, least_db) for rate, least_db in _MCS if snr_db >= least_db] or [_MCS[0]]
    rate_mbit, least_db = usable[-1]
    is_tight = snr_db - least_db < _TIGHT_DB
    return max(_LEAST_BIT_PER_S, round(rate_mbit * 1e6 * _EFFICIENCY, -4)), _TIGHT_LOSS if is_tight else 0.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=SEED, metavar="N", help="default %(default)s")
    parser.add_argument("--to", type=Path, default=TRACE, metavar="FILE")
    options = parser.parse_args()
    options.to.write_text(text(options.seed), encoding="utf-8")


def text(seed: int = SEED) -> str:
    """Return the text of the trace file."""
    head = f"# made by scripts/bench/adapt_walk.py --seed {seed}\ntime_s,rate_bit_per_s,loss\n"
    return head + "".join(f"{time_s:g},{rate:.0f},{loss:g}\n" for time_s, rate, loss in walk(seed))


if __name__ == "__main__":
    main()
