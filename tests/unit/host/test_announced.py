"""Participants of the other side that announce themselves on the link."""

import socket

from arpd.host import discovery
from arpd.host.discovery import AnnouncedParticipants
from arpd.model.wire import domain_port

DOMAIN = 97  # that no other test has
GUID = bytes(range(12))


def test_an_interface_that_comes_later_is_heard(monkeypatch, request):
    """A radio that is plugged in after the relay's start brings participants, too."""
    interfaces = []
    monkeypatch.setattr(socket, "if_nameindex", lambda: interfaces)
    heard = AnnouncedParticipants(DOMAIN)
    request.addfinalizer(heard.close)

    def announce():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
            mouth.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
            mouth.sendto(b"RTPS" + bytes(4) + GUID, ("239.255.0.1", domain_port(DOMAIN)))
        return [*heard.recent()]

    assert announce() == []
    interfaces.append((socket.if_nametoindex("lo"), "lo"))
    heard.recent()
    assert announce() == [GUID.hex()]
    assert announce() == [GUID.hex()]  # joined once


def test_interfaces_that_come_and_go_leave_room_for_the_next(monkeypatch, request):
    """Where containers come and go, the kernel's twenty memberships of a socket do not run out."""
    present, joined = [(1, "lo")], set()

    def kernel(_socket, index, *, is_gone=False):
        if len(joined) == 20 and not is_gone:
            raise OSError
        (joined.remove if is_gone else joined.add)(index)

    monkeypatch.setattr(socket, "if_nameindex", lambda: present)
    monkeypatch.setattr(discovery, "join_discovery", kernel)
    heard = AnnouncedParticipants(DOMAIN)
    request.addfinalizer(heard.close)
    for index in range(2, 32):
        present = [(1, "lo"), (index, f"veth{index}")]
        heard.recent()
        assert joined == {1, index}
