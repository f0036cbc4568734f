"""Any bytes as the configuration file; the fuzzer of scripts/bench draws some, too."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import example, given
from hypothesis import strategies as st

from arpd.host.config.load import load_settings
from arpd.model.errors import ConfigError
from arpd.model.settings import Settings
from tests.examples import examples
from tests.unit.host.config.test_load import FAULT, SHIPPED

_FOLDER = tempfile.TemporaryDirectory(prefix="arpd-test-load-")  # scripts/bench/fuzz.py gives no fixtures
# Slips of an editor in the shipped file, without its comments, which cost time and change nothing.
_LINES = [line for line in SHIPPED.read_text().splitlines() if line.strip() and not line.lstrip().startswith("#")]
_SLIPS = {
    "drop": lambda lines, i, _: lines.pop(i),
    "double": lambda lines, i, j: lines.insert(j, lines[i]),
    "indent": lambda lines, i, _: lines.insert(i, "  " + lines.pop(i)),
    "dedent": lambda lines, i, _: lines.insert(i, lines.pop(i).removeprefix("  ")),
    "cut": lambda lines, i, j: lines.insert(i, lines.pop(i)[:j]),
    "swap": lambda lines, i, j: lines.insert(j, lines.pop(i)),
}


def _mangled(slips, junk, at):
    lines = list(_LINES)
    for slip, i, j in slips:
        _SLIPS[slip](lines, i, j)
    raw = "\n".join(lines).encode()
    return raw[:at] + junk + raw[at:]


_AT = st.integers(0, len(_LINES) - 7)
_YAML_BITS = st.sampled_from(
    [
        *"[]{}'\"|>#?~\t\n\x85é-",
        *("link", "topics", "name", ": ", ":\n", "  ", "- ", ", ", "&a", "*a", "!!str ", "---\n"),
        *("...\n", "%TAG ! x\n", '"\\U99999999"', "/a", "20mbit", "1e400", "<<"),
    ]
)
_ODD = (
    st.binary(max_size=200)
    | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass"))
    | st.lists(_YAML_BITS, max_size=40).map(lambda bits: "".join(bits).encode())
    | st.builds(
        _mangled,
        st.lists(st.tuples(st.sampled_from(list(_SLIPS)), _AT, _AT), min_size=1, max_size=6),
        st.binary(max_size=4),
        st.integers(0, 2000),
    )
)


@examples(100)
@given(_ODD)
@example(b'"\\xFFFF": &')
@example(b"? [a]\n: b")
@example(b"%YAML 1." + b"9" * 5000 + b"\n---\na: 1")
def test_a_mangled_file_loads_or_says_where_it_is_wrong(raw):
    """Any bytes, heap of YAML or edit of the shipped file loads, or each fault names a line of that file."""
    path = Path(_FOLDER.name) / "arpd.yaml"
    try:
        path.write_bytes(raw)
        assert isinstance(load_settings(path, interfaces=None), Settings)
    except ConfigError as error:
        for fault in error.faults:
            assert FAULT.fullmatch(fault)
            assert 1 <= int(fault.split(":")[1]) <= len(raw.decode(errors="replace").splitlines()) + 1
