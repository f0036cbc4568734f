"""What arpd keeps on an object of the application: one of a kind, made on first use."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")
_making = threading.RLock()  # what is made may need another one


def attached(owner: Any, kind: type[T], make: Callable[[], T]) -> T:
    """Return the object of this kind that a node or a context has, after making it on first use."""
    name = f"_arpd_{kind.__name__}"
    with _making:
        found = getattr(owner, name, None)
        if not isinstance(found, kind):
            found = make()
            setattr(owner, name, found)
    return found
