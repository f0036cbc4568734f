"""Announcements of participants, as Fast DDS sends them, heard without joining the domain."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from arpd.host.discovery import announced, heard

GUID = bytes.fromhex("010f78fd686e94d300000000")


def padded(text):
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data + bytes(-len(data) % 4)


def announcement(properties, *, guid=GUID, kinds=(), addresses=()):
    """Return an announcement with properties, locators of these kinds, and addresses (OMG DDSI-RTPS 2.3, 8.5.3)."""
    pairs = struct.pack("<I", len(properties)) + b"".join(map(padded, [w for pair in properties.items() for w in pair]))
    parameters = struct.pack("<HH", 0x15, 4) + b"\x02\x02\0\0"
    parameters += b"".join(struct.pack("<HHiI16x", 0x32, 24, kind, 7410) for kind in kinds)
    parameters += b"".join(struct.pack("<HHiI12x4s", 0x31, 24, 1, 7411, bytes(each)) for each in addresses)
    parameters += struct.pack("<HH", 0x59, len(pairs)) + pairs + struct.pack("<HH", 0x01, 0)
    body = bytes(20) + b"\0\x03\0\0" + parameters
    stamp = struct.pack("<BBH", 0x09, 1, 8) + bytes(8)
    return b"RTPS\x02\x02\x01\x0f" + guid + stamp + struct.pack("<BBH", 0x15, 5, len(body)) + body


@pytest.fixture
def run(tmp_path):
    """Run a process; returns what the kernel tells of all."""

    def run(number, *command, inside=""):
        process = tmp_path / f"{number}"
        process.mkdir()
        (process / "status").write_text(f"Name:\tx\nNSpid:\t{number}{inside}\nNSpgid:\t9\n")
        (process / "cmdline").write_text("".join(f"{word}\0" for word in command))
        return tmp_path

    return run


def heard_with(proc, *packets):
    return heard(packets, own={"10.0.0.1"}, domain_id=7, duration_s=2.0, proc=proc)


TOLD = {
    "PARTICIPANT_TYPE": "SIMPLE",
    "fastdds.physical_data.host": "vm:1716",
    "fastdds.physical_data.process": "4711",
}


@given(st.binary(max_size=200), st.integers(0, 300))
def test_no_packet_raises(tail, cut):
    """Whatever arrives at the port."""
    announced(b"RTPS" + tail)
    announced(announcement(TOLD, kinds=(1, 4), addresses=[(10, 0, 0, 1)])[:cut] + tail)


@given(st.sets(st.sampled_from([1, 2, 4, 8, 16])))
def test_transports_are_those_of_the_locators_for_discovery(kinds):
    """Shared memory, which serves one computer only, is none of them."""
    names = {1: "UDPv4", 2: "UDPv6", 4: "TCPv4", 8: "TCPv6"}
    assert announced(announcement(TOLD, kinds=kinds)).transports == {names[kind] for kind in kinds if kind in names}


@pytest.mark.parametrize(
    ("command", "name", "is_arpds"),
    [
        (("/opt/ros/jazzy/lib/demo_nodes_cpp/talker", "--ros-args"), "talker", False),
        (("/usr/bin/python3", "/opt/ros/jazzy/lib/x/listener.py", "-r"), "listener.py", False),
        (("/usr/lib/arpd/env/bin/python", "/usr/lib/arpd/env/bin/arpd", "run"), "arpd", True),
        (("python3", "-u", "-m", "arpd.cli", "peer"), "arpd.cli", True),
        (("python3", f"/home/u/{'workspace/' * 9}install/arpd/lib/arpd/relay"), "relay", True),
        (("/usr/bin/python3", "/home/arpd/relay"), "relay", False),
        (("python3",), "python3", False),
        (("/usr/bin/python3", "-u", "-c", "import arpd; arpd.spin()", "x"), "python3", False),
        ((), "process 4711", False),
    ],
)
def test_a_process_is_named_by_its_command(run, command, name, is_arpds):
    """Scripts and modules by their own names."""
    (found,) = heard_with(run(4711, *command), (announcement(TOLD), "10.0.0.1")).announcers
    assert (found.process, found.is_arpds) == (name, is_arpds)


def test_participants_are_counted_once_and_named(run):
    """Own ones by their commands, others by what they tell of their hosts, or by their addresses."""
    packets = [
        (announcement(TOLD), "10.0.0.1"),
        (announcement(TOLD), "10.0.0.1"),
        (announcement(TOLD | {"fastdds.physical_data.host": "laptop:9"}, guid=b"\x02" * 12), "10.0.0.2"),
        (announcement({}, guid=b"\x03" * 12), "10.0.0.3"),
        (b"no RTPS at all", "10.0.0.4"),
    ]
    found = heard_with(run(4711, "/bin/talker", "--ros-args"), *packets)
    assert [(one.host, one.process, one.is_here) for one in found.announcers] == [
        ("vm", "talker", True),
        ("10.0.0.3", "process unknown", False),
        ("laptop", "process 4711", False),
    ]
    assert found.bytes_per_second == sum(len(packet) + 42 for packet, _ in packets) / 2.0


def test_the_addresses_of_a_participant_are_all_that_it_has_told():
    """It may tell one more later, of an interface that came."""
    parts = [announcement(TOLD, addresses=each) for each in ([(10, 0, 0, 1)], [(10, 0, 0, 1), (172, 17, 0, 1)])]
    (found,) = heard_with(Path("/nowhere"), *((part, "10.0.0.3") for part in parts)).announcers
    assert found.addresses == {"10.0.0.1", "172.17.0.1"}


def test_a_process_of_a_container_is_found_by_the_number_it_has_there(run):
    """A process of this computer with that number is another one; where both have it, nobody knows which announces."""
    run(4711)  # of the kernel
    proc = run(9, "/bin/talker", inside="\t4711")
    assert [one.process for one in heard_with(proc, (announcement(TOLD), "10.0.0.1")).announcers] == ["talker"]
    proc = run(10, "/usr/bin/arpd", inside="\t4711")
    (found,) = heard_with(proc, (announcement(TOLD), "10.0.0.1")).announcers
    assert (found.process, found.is_arpds, found.memory) == ("process 4711", False, None)
