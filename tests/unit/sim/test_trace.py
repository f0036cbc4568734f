"""Link traces: all formats, and faults with their line."""

import math
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.model.errors import TraceError
from arpd.sim.schedule import Service
from arpd.sim.trace import read_trace
from tests.examples import examples

# Not a fixture's: the fuzzer of scripts/bench calls a test without pytest.
FOLDER = tempfile.TemporaryDirectory(prefix="arpd-test-trace-")


@pytest.fixture
def written(tmp_path):
    def write(content):
        path = tmp_path / "link.trace"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def test_a_recording_of_something_else_is_not_read_whole(written, monkeypatch):
    """Its size is enough to refuse it."""
    monkeypatch.setattr("arpd.sim.trace._MOST_BYTES", 9)
    with pytest.raises(TraceError, match=r"link.trace: is larger than "):
        read_trace(written("1\n2\n3\n4\n5\n"))


def steps_of(trace):
    return [(step.start_s, step.rate_bytes_per_second) for step in trace.rates.steps]


# -- CSV

EXAMPLE = """time_s,rate_bit_per_s,loss
0,20000000,0
12.5,5e6,0.01
# a tunnel
30, 0, 1

31,20000000,0
"""


def test_the_documented_csv_reads_as_its_rows(written):
    """Rates become bytes per second; comments, blank lines and spaces around values are ignored."""
    trace = read_trace(written(EXAMPLE))
    assert trace.name == "link.trace"
    assert steps_of(trace) == [(0.0, 2_500_000.0), (12.5, 625_000.0), (30.0, 0.0), (31.0, 2_500_000.0)]
    assert [(step.start_s, step.loss) for step in trace.losses] == [(0.0, 0.0), (12.5, 0.01), (30.0, 1.0), (31.0, 0.0)]
    assert (trace.duration_s, trace.rates.period_s) == (31.0, math.inf)


def test_a_recording_of_seconds_and_mbit_is_read_as_it_is_published(written):
    """Rows have a tab or blanks between; the run begins at the first."""
    trace = read_trace(written("10.0\t20\n12.5\t0.8\n  13   0\n"))
    assert steps_of(trace) == [(0.0, 2_500_000.0), (2.5, 100_000.0), (3.0, 0.0)]
    assert math.isinf(trace.rates.period_s)


# -- mahimahi


def test_a_mahimahi_trace_becomes_mean_rates(written):
    """Each span of 20 ms, and the shorter last one, gets the mean rate of its deliveries of 1500 bytes."""
    trace = read_trace(written("0\n1\n20\n45\n"))
    assert steps_of(trace) == [(0.0, 225_000.0), (0.02, 0.0), (0.04, 300_000.0)]
    assert trace.duration_s == trace.rates.period_s == 0.045
    assert trace.losses == ()


@examples(100)
@given(st.lists(st.integers(0, 500), min_size=1, max_size=200).filter(any), st.integers(1, 5))
def test_no_delivery_is_lost_or_invented(tmp_path_factory, moments, turns):
    """The trace carries 1500 bytes per line in its duration, and n times as many in n durations, in a day as well."""
    path = tmp_path_factory.mktemp("trace") / "t.up"
    path.write_text("".join(f"{moment}\n" for moment in sorted(moments)))
    trace = read_trace(path)
    assert trace.duration_s == max(moments) / 1000.0
    service, size = Service(trace.rates), 1500.0 * len(moments)
    for turn in (turns, turns + 0.5, 86_400_000):
        carried = service.by(turn * trace.duration_s)
        assert carried == pytest.approx(int(turn) * size + service.by(turn % 1 * trace.duration_s), rel=1e-9)
        assert service.by(service.when(carried)) == pytest.approx(carried, rel=1e-9)
    assert service.by(trace.duration_s) == pytest.approx(size, rel=1e-12)


# -- faults

HEADER = "time_s,rate_bit_per_s,loss\n"


@pytest.mark.parametrize(
    ("content", "place", "words"),
    [
        ("# nothing\n\n", ":1: ", "empty"),
        ("\n  12.5\n", ":2: ", "'12.5'"),
        ("time_s,rate\n", ":1: ", "'time_s,rate'"),
        (HEADER, ":1: ", "no row"),
        (HEADER + "0,1e6,\n", ":2: ", "2 values; write 3"),
        (HEADER + "0, fast,0\n", ":2: ", "rate_bit_per_s 'fast'"),
        (HEADER + "0,nan,0\n", ":2: ", "rate_bit_per_s 'nan'"),
        (HEADER + "1,1e6,0\n", ":2: ", "start at 0"),
        (HEADER + "0,1e6,0\n\n5,1e6,0\n3,1e6,0\n", ":5: ", "3 s comes after 5 s"),
        ("0\t20\n1\t20000000\n", ":2: ", "rate_mbit_per_s '20000000'"),
        ("5\n 6,7\n", ":2: ", "'6,7'"),
        ("5\n\u0667\n", ":2: ", "'\u0667'"),
        ("5\n9\n8\n", ":3: ", "8 ms comes after 9 ms"),
        ("0\n0\n", ":1: ", "no time"),
        (b"time_s,rate_bit_per_s\n0,\xff\n", ":2: ", "UTF-8"),
    ],
)
def test_a_bad_trace_is_refused_where_it_goes_wrong(written, content, place, words):
    """The message names file and line, the fault and the way out."""
    path = written(content)
    with pytest.raises(TraceError) as refused:
        read_trace(path)
    assert str(refused.value).startswith(f"{path}{place}")
    assert words in str(refused.value)


@examples(300)
@given(
    st.one_of(
        st.binary(max_size=60),
        st.text(max_size=60),
        st.text("0123456789,.-+e# \n\r", max_size=60),
        st.text("0123456789,.-+e \n", max_size=60).map(lambda rest: HEADER + rest),
        st.text("0123456789. \t\n", max_size=60),
    )
)
def test_whatever_a_file_holds_it_is_a_trace_or_refused(content):
    """Any content raises TraceError or gives a trace that can be played."""
    path = Path(FOLDER.name) / "t"
    path.write_bytes(content if isinstance(content, bytes) else content.encode(errors="surrogatepass"))
    try:
        trace = read_trace(path)
    except TraceError:
        return
    assert trace.rates.rate_at(2 * trace.duration_s) >= 0.0
