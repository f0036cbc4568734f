"""What arpd keeps on an object of the application."""

import threading
import time
from types import SimpleNamespace

from arpd.ros.attached import attached


class Kept:
    """One of a kind."""


def test_two_threads_that_come_first_get_one_object():
    """Two publishers that are made at once share the thread of their participant."""
    owner, found = SimpleNamespace(), []

    def make():
        time.sleep(0.05)
        return Kept()

    threads = [threading.Thread(target=lambda: found.append(attached(owner, Kept, make))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found[0] is found[1]
