"""The difference of two JSON documents."""

from __future__ import annotations

import copy
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from arpd.report.json_patch import patch_between

LEAVES = st.none() | st.booleans() | st.integers(0, 3) | st.sampled_from(["", "a", "b/~"])
DOCUMENTS = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["a", "b/~", ""]), inner)
)


def applied(document, patch):
    """Return the document after a JSON Patch, as RFC 6902 says, for the operations that arpd uses."""
    whole: Any = {"": copy.deepcopy(document)}
    for operation in patch:
        keys = [key.replace("~1", "/").replace("~0", "~") for key in operation["path"].split("/")]
        place: Any = whole
        for key in keys[:-1]:
            place = place[int(key)] if isinstance(place, list) else place[key]
        last = int(keys[-1]) if isinstance(place, list) and keys[-1] != "-" else keys[-1]
        if operation["op"] == "remove":
            del place[last]
        elif operation["op"] == "add":
            assert last == "-"
            place.append(operation["value"])
        else:
            place[last] = operation["value"]
    return whole[""]


@given(old=DOCUMENTS, new=DOCUMENTS)
def test_the_patch_leads_from_the_old_to_the_new(old, new):
    """Whoever applies the patch has the new document."""
    got = applied(old, patch_between(old, new))
    assert got == new
