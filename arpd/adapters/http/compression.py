"""Answers made smaller: whoever reads them may sit on the other side of the link that arpd keeps free."""

from __future__ import annotations

import gzip
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from arpd.adapters.http.answers import Answer

_LEAST_BYTES = 1024  # a packet holds less than this anyway
_LEVEL = 1  # a tenth of the size already; more costs the robot more time than the link


def compressed(answer: Answer) -> Answer:
    """Return the answer in gzip, or as it is where that would not pay."""
    if len(answer.body) < _LEAST_BYTES:
        return answer
    body = gzip.compress(answer.body, compresslevel=_LEVEL, mtime=0)
    return replace(answer, body=body, headers={**answer.headers, "Content-Encoding": "gzip"})
