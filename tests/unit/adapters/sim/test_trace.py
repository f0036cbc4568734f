"""Link traces: both formats, and faults with line and column."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arpd.adapters.sim.loss import LossStep
from arpd.adapters.sim.schedule import RateSchedule, RateStep
from arpd.adapters.sim.trace import LinkTrace, read_trace
from arpd.model.errors import TraceError


@pytest.fixture
def written(tmp_path):
    def write(content):
        path = tmp_path / "link.trace"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def steps_of(trace):
    return [(step.start_s, step.rate_bytes_per_second) for step in trace.rates.steps]


def total_bytes(trace):
    """Return the bytes that the trace carries in its duration."""
    ends = [step.start_s for step in trace.rates.steps[1:]] + [trace.duration_s]
    return sum(
        step.rate_bytes_per_second * (end - step.start_s) for step, end in zip(trace.rates.steps, ends, strict=True)
    )


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
    assert trace.duration_s == 31.0
    assert not trace.repeats


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "# first a comment\n\n" + text,
        lambda text: "\ufeff" + text,
        lambda text: text.rstrip("\n"),
        lambda text: text.replace("time_s,rate_bit_per_s,loss", " time_s , rate_bit_per_s , loss "),
    ],
    ids=["CRLF", "comment first", "byte order mark", "no last newline", "spaces"],
)
def test_how_an_editor_saves_a_csv_does_not_matter(written, change):
    """Line ends, byte order marks, comments and spaces do not change the rows."""
    assert read_trace(written(change(EXAMPLE))) == read_trace(written(EXAMPLE))


def test_loss_may_be_left_out(written):
    """Without the column the trace has no losses."""
    trace = read_trace(written("time_s,rate_bit_per_s\n0,8\n"))
    assert steps_of(trace) == [(0.0, 1.0)]
    assert trace.losses == ()
    assert trace.duration_s == 0.0


values = st.floats(0.0, 1e11).map(abs), st.floats(0.0, 1.0).map(abs)
rows = st.lists(st.tuples(st.floats(0.001, 1e4), *values), max_size=20, unique_by=lambda row: row[0]).map(sorted)
tables = st.tuples(st.tuples(st.just(0.0), *values), rows).map(lambda table: [table[0], *table[1]])


@settings(max_examples=100, deadline=None)
@given(tables, st.booleans(), st.sampled_from(["\n", "\r\n"]), st.sampled_from(["", "# x", " "]))
def test_a_written_trace_reads_back(tmp_path_factory, table, has_loss, newline, between):
    """Values written with full precision come back unchanged."""
    lines = ["time_s,rate_bit_per_s" + ",loss" * has_loss]
    for time_s, rate, loss in table:
        lines += [between, f"{time_s!r},{8.0 * rate!r}" + f",{loss!r}" * has_loss]
    path = tmp_path_factory.mktemp("trace") / "t.csv"
    path.write_text(newline.join(lines), newline="")
    assert read_trace(path) == LinkTrace(
        name="t.csv",
        rates=RateSchedule(steps=tuple(RateStep(start_s=t, rate_bytes_per_second=r) for t, r, _ in table)),
        losses=tuple(LossStep(start_s=t, loss=p) for t, _, p in table) if has_loss else (),
        duration_s=table[-1][0],
    )


# -- mahimahi


def test_a_mahimahi_trace_becomes_mean_rates(written):
    """Each span of 20 ms, and the shorter last one, gets the mean rate of its deliveries of 1500 bytes."""
    trace = read_trace(written("0\n1\n20\n45\n"))
    assert steps_of(trace) == [(0.0, 225_000.0), (0.02, 0.0), (0.04, 300_000.0)]
    assert trace.duration_s == 0.045
    assert trace.repeats
    assert trace.losses == ()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.integers(0, 500), min_size=1, max_size=200).filter(any), st.integers(1, 5))
def test_no_delivery_is_lost_or_invented(tmp_path_factory, moments, turns):
    """The trace carries 1500 bytes per line in its duration, and n times as many in n durations."""
    path = tmp_path_factory.mktemp("trace") / "t.up"
    path.write_text("".join(f"{moment}\n" for moment in sorted(moments)))
    trace = read_trace(path)
    assert trace.duration_s == max(moments) / 1000.0
    assert total_bytes(trace) == pytest.approx(1500.0 * len(moments), rel=1e-12)
    longer = trace.lasting((turns - 0.5) * trace.duration_s)
    assert longer.duration_s == pytest.approx(turns * trace.duration_s)
    assert total_bytes(longer) == pytest.approx(1500.0 * len(moments) * turns, rel=1e-9)


def test_a_run_longer_than_the_trace_plays_it_again(written):
    """Every turn has the rates of the first."""
    trace = read_trace(written("5\n30\n30\n100\n")).lasting(0.35)
    assert trace.duration_s == 0.4
    for t_s in (0.001, 0.021, 0.041, 0.079, 0.099):
        for turn in (1, 2, 3):
            assert trace.rates.rate_at(t_s + turn * 0.1) == trace.rates.rate_at(t_s)


def test_a_run_within_the_trace_is_the_trace(written):
    """A short run repeats nothing, and a CSV never repeats, because its last row holds."""
    mahimahi, csv = read_trace(written("5\n1000\n")), read_trace(written(EXAMPLE))
    assert mahimahi.lasting(1.0) is mahimahi
    assert csv.lasting(3600.0) is csv


def test_losses_repeat_with_the_rates():
    """A recording that repeats also repeats its losses."""
    trace = LinkTrace(
        name="t",
        rates=RateSchedule(steps=(RateStep(start_s=0.0, rate_bytes_per_second=1.0),)),
        losses=(LossStep(start_s=1.0, loss=0.5), LossStep(start_s=2.0, loss=0.0)),
        duration_s=4.0,
        repeats=True,
    ).lasting(8.0)
    assert [(step.start_s, step.loss) for step in trace.losses] == [(1.0, 0.5), (2.0, 0.0), (5.0, 0.5), (6.0, 0.0)]


def test_a_mahimahi_trace_may_have_comments_and_crlf(written):
    """Comments, blank lines and CRLF are ignored, as in a CSV."""
    assert read_trace(written("# home\r\n5\r\n\r\n 40 \r\n")) == read_trace(written("5\n40\n"))


# -- faults

HEADER = "time_s,rate_bit_per_s,loss\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", ":1:1: the trace is empty; start with time_s,rate_bit_per_s,loss or with a delivery in milliseconds"),
        ("# nothing\n\n", ":1:1: the trace is empty; start with"),
        ("hello\n", ":1:1: 'hello' starts no trace; start with"),
        ("\n  12.5\n", ":2:3: '12.5' starts no trace; start with"),
        ("0,20000000\n", ":1:1: '0' where 'time_s' was expected; write time_s,rate_bit_per_s,loss"),
        ("time_s,rate\n", ":1:8: 'rate' where 'rate_bit_per_s' was expected; write"),
        ("time_s\n0\n", ":1:7: the header has no rate; write time_s,rate_bit_per_s,loss"),
        ("time_s,rate_bit_per_s,loss,delay\n", ":1:28: unknown column 'delay'; write time_s,rate_bit_per_s,loss"),
        (HEADER, ":1:27: no row follows the header; add one at 0 s"),
        (HEADER + "0,1e6\n", ":2:6: 2 values; write 3: time_s,rate_bit_per_s,loss"),
        (HEADER + "0,1e6,0,9\n", ":2:9: 4 values; write 3: time_s,rate_bit_per_s,loss"),
        (HEADER + "0,1e6,\n", ":2:7: loss '' is not a number; write one from 0 to 1"),
        (HEADER + "0, fast,0\n", ":2:4: rate_bit_per_s 'fast' is not a number; write one from 0 to 1e+12"),
        (HEADER + "0,20mbit,0\n", ":2:3: rate_bit_per_s '20mbit' is not a number"),
        (HEADER + "0,1_000,0\n", ":2:3: rate_bit_per_s '1_000' is not a number"),
        (HEADER + "0,nan,0\n", ":2:3: rate_bit_per_s 'nan' is not a number"),
        (HEADER + "0,inf,0\n", ":2:3: rate_bit_per_s 'inf' is not a number"),
        (HEADER + "0,-1,0\n", ":2:3: rate_bit_per_s -1 is out of range; write a number from 0 to 1e+12"),
        (HEADER + "0,1e13,0\n", ":2:3: rate_bit_per_s 1e13 is out of range"),
        (HEADER + "0,1e999,0\n", ":2:3: rate_bit_per_s 1e999 is out of range"),
        (HEADER + "0,1e6,1.5\n", ":2:7: loss 1.5 is out of range; write a number from 0 to 1"),
        (HEADER + "-1,1e6,0\n", ":2:1: time_s -1 is out of range"),
        (HEADER + "1,1e6,0\n", ":2:1: the first row is at 1 s; start at 0"),
        (HEADER + "0,1e6,0\n\n5,1e6,0\n3,1e6,0\n", ":5:1: 3 s comes after 5 s; sort the rows by time, one per moment"),
        (HEADER + "0,1e6,0\n0,2e6,0\n", ":3:1: 0 s comes after 0 s; sort the rows by time, one per moment"),
        ("-5\n", ":1:1: '-5' is not a moment; write whole milliseconds from 0 to 10000000000"),
        ("5\n7.5\n", ":2:1: '7.5' is not a moment; write whole milliseconds"),
        ("5\n 6,7\n", ":2:2: '6,7' is not a moment"),
        ("5\n10000000001\n", ":2:1: '10000000001' is not a moment"),
        ("5\n\u0667\n", ":2:1: '\u0667' is not a moment"),
        ("5\n9\n8\n", ":3:1: 8 ms comes after 9 ms; sort the lines by time"),
        ("0\n0\n", ":1:1: the trace takes no time; its last delivery must come after 0 ms"),
        (b"time_s,rate_bit_per_s\n0,\xff\n", ":2:3: not UTF-8 text; save the trace as plain text"),
        (b"\x1f\x8b\x08\x00", ":1:2: not UTF-8 text; save the trace as plain text"),
    ],
)
def test_a_bad_trace_is_refused_where_it_goes_wrong(written, content, message):
    """The message names file, line and column, the fault and the way out."""
    path = written(content)
    with pytest.raises(TraceError) as refused:
        read_trace(path)
    assert str(refused.value).startswith(f"{path}{message}")


@pytest.mark.parametrize("name", ["missing.csv", "."])
def test_a_trace_that_cannot_be_read_is_refused(tmp_path, name):
    """A missing file and a folder raise TraceError."""
    with pytest.raises(TraceError, match=r"cannot be read \((No such file|Is a directory).*\); give a CSV"):
        read_trace(tmp_path / name)


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(
        st.binary(max_size=60),
        st.text(max_size=60),
        st.text("0123456789,.-+e# \n\r", max_size=60),
        st.text("0123456789,.-+e \n", max_size=60).map(lambda rest: HEADER + rest),
    )
)
def test_whatever_a_file_holds_it_is_a_trace_or_refused(tmp_path_factory, content):
    """Any content raises TraceError or gives a trace that can be played."""
    path = tmp_path_factory.mktemp("trace") / "t"
    path.write_bytes(content if isinstance(content, bytes) else content.encode(errors="surrogatepass"))
    try:
        trace = read_trace(path)
    except TraceError:
        return
    assert trace.lasting(2 * trace.duration_s).rates.rate_at(0.0) >= 0.0


@pytest.mark.parametrize("more", [{"duration_s": 4.0}, {"duration_s": 5.0, "repeats": True}])
def test_a_trace_that_ends_before_its_last_step_is_refused(more):
    """A trace may not end before its last step."""
    steps = tuple(RateStep(start_s=s, rate_bytes_per_second=1.0) for s in (0.0, 5.0))
    with pytest.raises(ValueError, match="no later than its last step"):
        LinkTrace(name="t", rates=RateSchedule(steps=steps), **more)
