"""Odd configuration files."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.host.config.load import load_settings
from arpd.model.errors import ConfigError
from tests.examples import examples

SHIPPED = (Path(__file__).parents[4] / "etc" / "arpd" / "arpd.yaml").read_text(encoding="utf-8")
# Without its comments, which cost time and change nothing.
LINES = [line for line in SHIPPED.splitlines() if line.strip() and not line.lstrip().startswith("#")]
FAULT = re.compile(r"[^\n]+?:[1-9]\d*:[1-9]\d*: [^ \n][^\n]*?: [^\n]+; [^\n]+")
FOLDER = tempfile.TemporaryDirectory(prefix="arpd-test-fuzz-")


def load(raw):
    path = Path(FOLDER.name) / "arpd.yaml"
    path.write_bytes(raw)
    return load_settings(path, interfaces=None)


MANGLED = st.tuples(
    st.sampled_from(["drop", "double", "indent", "dedent", "cut", "swap"]), st.integers(0, 10**6), st.integers(0, 10**6)
)


def mangle(lines, edits):
    """Return the lines after slips of an editor."""
    lines = list(lines)
    for what, one, other in edits:
        i, j = one % len(lines), other % len(lines)
        match what:
            case "drop" if len(lines) > 1:
                del lines[i]
            case "double":
                lines.insert(j, lines[i])
            case "indent":
                lines[i] = "  " + lines[i]
            case "dedent":
                lines[i] = lines[i].removeprefix("  ")
            case "cut":
                lines[i] = lines[i][: other % (len(lines[i]) + 1)]
            case "swap":
                lines[i], lines[j] = lines[j], lines[i]
    return "\n".join(lines) + "\n"


@examples(40)
@given(st.lists(MANGLED, min_size=1, max_size=6), st.binary(max_size=4), st.integers(0, 10**6))
def test_a_mangled_file_loads_or_says_where_it_is_wrong(edits, junk, at):
    """Any edit of the shipped file loads, or each fault names a line of that file."""
    raw = mangle(LINES, edits).encode()
    raw = raw[: at % (len(raw) + 1)] + junk + raw[at % (len(raw) + 1) :]
    try:
        load(raw)
    except ConfigError as error:
        for fault in error.faults:
            assert FAULT.fullmatch(fault)
            assert 1 <= int(fault.split(":")[1]) <= raw.count(b"\n") + raw.count(b"\r") + raw.count(b"\xc2\x85") + 1


@pytest.mark.parametrize(
    "raw", [b"topics: [" + b"[]," * 30_000 + b"]", b"".join(b"k%d: 1\n" % k for k in range(25_000))]
)
def test_a_costly_file_is_refused_early(raw):
    """Reading stops early at a file that would take a quarter of a minute and half a gigabyte."""
    with pytest.raises(ConfigError) as refused:
        load(raw)
    (fault,) = refused.value.faults
    assert "yaml: holds more than 20,000 keys and values;" in fault


def test_of_many_faults_the_first_hundred_are_told():
    """A file with many faults does not fill the journal: one line counts the faults above a hundred."""
    with pytest.raises(ConfigError) as refused:
        load(b"".join(b"k%d: 1\n" % k for k in range(150)))
    assert len(refused.value.faults) == 101
    assert refused.value.faults[-1].endswith(":101:1: file: has 50 more faults; correct those above first")
