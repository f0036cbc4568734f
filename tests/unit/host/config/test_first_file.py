"""The first configuration file: always accepted, whatever the names and types on the network are."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from arpd.host.config.first_file import first_file
from arpd.host.config.load import load_settings
from arpd.model.errors import ConfigError
from arpd.model.link_topics import LinkTopic, TopicTraffic
from arpd.model.settings import RelaySettings, Settings
from arpd.report.first_guess import first_guess
from tests.examples import examples
from tests.unit.report.test_first_guess import TOPICS

ENDS = RelaySettings(link_domain=77, robot="10.0.0.1")
QUICK = examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
WORDS = st.text(max_size=80)
# What breaks a line somewhere: in YAML, in Python, on a terminal.
BREAKS = "\n", "\r", "\x85", "\u2028", "\u2029", "\x0b", "\x0c", "\x1b[2J", "\x00", "\ud800"


@pytest.fixture
def loaded(tmp_path):
    """Write a first file for topics, and read it as the daemon does."""

    def loaded(topics, ends=ENDS, guessed_from="wlan0", origin="a test"):
        path = tmp_path / "arpd.yaml"
        guess = first_guess(topics)
        path.write_bytes(first_file(guess, Settings(relay=ends), guessed_from=guessed_from, origin=origin).encode())
        return guess, load_settings(path, interfaces=None, local_domain=0)

    return loaded


@QUICK
@given(topics=TOPICS)
def test_every_guess_is_accepted_and_read_back(loaded, topics):
    """The daemon reads exactly the guessed preferences."""
    guess, read = loaded(topics)
    assert read.topics == tuple(each.settings for each in guess.topics)
    assert read.relay.groups == guess.groups
    assert (read.relay.link_domain, read.relay.robot, read.relay.base) == (77, "10.0.0.1", None)


@QUICK
@given(words=st.tuples(WORDS, WORDS, WORDS, WORDS), breaking=st.sampled_from(BREAKS))
def test_words_from_outside_stay_in_their_comments(loaded, words, breaking):
    """Types, nodes, reasons, interfaces and host names with line breaks and escapes change no value."""
    kind, reason, interface, origin = (f"{text}{breaking}topics: [evil]{breaking}" for text in words)
    found = [
        LinkTopic(name="/a", types=(kind,), readers=(reason,), unmeasured=reason),
        LinkTopic(name="/b", types=(kind,), writers=(kind,), traffic=TopicTraffic(samples=0, rate_hz=0.0)),
    ]
    _, read = loaded(found, RelaySettings(link_domain=77, robot="robot"), interface, origin)
    assert {topic.name for topic in read.topics} == {"/a", "/b"}
    assert (read.relay.robot, read.on_stop) == ("robot", "restore")


def test_without_an_address_check_names_the_line_to_fill_in(loaded):
    """A robot whose address is unknown gets a file with one fault, at the key that is missing."""
    with pytest.raises(ConfigError) as error:
        loaded([], RelaySettings(link_domain=77), "")
    assert len(error.value.faults) == 1
    assert "relay.robot" in error.value.faults[0]
