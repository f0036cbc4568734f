"""Time the arithmetic of a published Python benchmark on this machine, to compare its core with a Raspberry Pi's.

Usage: python scripts/bench/pi_reference.py

Prints the CPU time (s) of the whole work of github.com/alexdedyura/cpu-benchmark, from a thirtieth of it. As there, the
loops are a module's own, whose names are slower than a function's. Any Python 3 runs it, without arpd.
"""

import time

WHOLE, PART = 10_000, 333

began_s = time.process_time()
for _ in range(PART):
    for x in range(1, 1000):
        3.141592 * 2**x
    for x in range(1, 10_000):
        float(x) / 3.141592
    for x in range(1, 10_000):
        float(3.141592) / x  # noqa: UP018 - the call is a part of the work
print((time.process_time() - began_s) * WHOLE / PART)
