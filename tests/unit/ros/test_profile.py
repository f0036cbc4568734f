"""What arpd's processes choose of Fast DDS: profile, transports, discovery servers."""

from xml.etree import ElementTree as ET

import pytest

from arpd.model.settings import LinkDomain
from arpd.ros.profile import missing_in_profile
from arpd.ros.runtime import (
    DAEMON_PROFILE,
    FASTDDS_PROFILE,
    OWN_PROFILE,
    PROFILE_VARIABLE,
    TWO_ENDED_PROFILE,
    _discovery,
    any_user_heard,
    prepare_environment,
    send_without_waiting,
)
from arpd.ros.topic_measuring import is_confined

OURS = OWN_PROFILE, TWO_ENDED_PROFILE, DAEMON_PROFILE


def test_a_profile_of_the_users_own_stays_and_that_of_users_nodes_does_not(tmp_path):
    """With arpd's for all nodes, or a copy, an end would hear itself; one that cannot be read is no choice."""
    path, ours = tmp_path / "own.xml", FASTDDS_PROFILE.read_text()
    for content, used in ((None, TWO_ENDED_PROFILE), ("<dds/>", path), (ours, TWO_ENDED_PROFILE)):
        if content:
            path.write_text(content)
        prepare_environment(TWO_ENDED_PROFILE, environment := {PROFILE_VARIABLE: str(path)})
        assert environment[PROFILE_VARIABLE] == str(used)


def test_two_ends_stay_on_their_host_unless_told_otherwise():
    """The node in the local domain is confined to its host, but a range that the user has chosen stays."""
    for before, after in (({}, "LOCALHOST"), ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "SUBNET")):
        prepare_environment(TWO_ENDED_PROFILE, environment := dict(before))
        assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == after


def test_nodes_confined_by_the_older_variable_do_not_confine_the_link():
    """ROS_LOCALHOST_ONLY overrides range and peers of every domain, so it becomes the range of the local one."""
    before = {"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "10.0.0.2"}
    prepare_environment(TWO_ENDED_PROFILE, environment := dict(before))
    environment = {name: value for name, value in environment.items() if name.startswith("ROS")}
    assert environment == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def test_in_the_range_of_this_host_nodes_of_any_user_are_heard_by_a_profile(tmp_path):
    """It leaves the range for as long as nodes are made, and a profile or transports of the user's own in force."""
    (own := tmp_path / "own.xml").write_text("<dds/>")
    name, local = "ROS_AUTOMATIC_DISCOVERY_RANGE", {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    for more, meanwhile in (
        ({}, "SYSTEM_DEFAULT"),
        ({PROFILE_VARIABLE: str(FASTDDS_PROFILE)}, "SYSTEM_DEFAULT"),
        ({PROFILE_VARIABLE: str(own)}, "LOCALHOST"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"}, "LOCALHOST"),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, "LOCALHOST"),
        ({"ROS_STATIC_PEERS": "10.0.0.2"}, "LOCALHOST"),
        ({name: "SUBNET"}, "SUBNET"),
    ):
        before = local | more
        with any_user_heard(environment := dict(before)):
            assert environment[name] == meanwhile
            assert is_confined(environment) is (name not in more), "whatever stands for the range"
        assert environment[name] == before[name]


@pytest.mark.parametrize(
    "profile", [FASTDDS_PROFILE, OWN_PROFILE, TWO_ENDED_PROFILE, DAEMON_PROFILE], ids=lambda path: path.stem
)
def test_arpds_profiles_miss_nothing(profile, tmp_path):
    """Each profile is right; by the name that a variable has for Fast DDS 3 it is not read."""
    assert missing_in_profile({PROFILE_VARIABLE: str(profile)}, folder=tmp_path) == ""
    assert missing_in_profile({"FASTDDS_DEFAULT_PROFILES_FILE": str(profile)}, folder=tmp_path)


@pytest.mark.parametrize("profile", OURS, ids=lambda path: path.stem)
def test_a_participant_announces_itself_from_another_thread_and_is_not_slowed(profile):
    """Only with a throughput controller Fast DDS listens before answers come; this one allows 8 Gbit/s.

    On the link it lets discovery send one packet a period, which IP does not cut, and samples are synchronous.
    """
    names = "{*}bytesPerPeriod", "{*}periodMillisecs"
    root = ET.parse(profile).getroot()
    nbytes, period_ms = (int(root.findtext(f".//{{*}}throughputController/{name}")) for name in names)
    prepare_environment(profile, environment := {"RMW_FASTRTPS_PUBLICATION_MODE": "ASYNCHRONOUS"})
    if environment["RMW_FASTRTPS_PUBLICATION_MODE"] == "SYNCHRONOUS":
        assert 1000 < nbytes <= 1472  # an announcement has up to 740; with headers of IP and UDP no more than 1500
    else:
        assert nbytes / period_ms >= 1e6
        assert nbytes < 2**31  # Fast DDS keeps it in 32 bits, with a sign


def test_nodes_of_the_user_announce_themselves_as_ever():
    """The controller's thread wakes twenty times a second, so only arpd's processes take the profile with it."""
    nodes, own = (ET.parse(profile).getroot() for profile in (FASTDDS_PROFILE, OWN_PROFILE))
    assert nodes.find(".//{*}participant") is None
    assert [*map(ET.tostring, nodes.find(".//{*}data_writer"))] == [*map(ET.tostring, own.find(".//{*}data_writer"))]
    prepare_environment(environment=(environment := {PROFILE_VARIABLE: str(FASTDDS_PROFILE)}))
    assert environment == {PROFILE_VARIABLE: str(OWN_PROFILE)}


def test_the_daemon_s_profile_is_that_of_the_ends_without_what_large_samples_need():
    """Of a socket's size Fast DDS makes shared memory, which the daemon would only fill; it has no large samples."""
    ends, daemon = (ET.parse(profile).getroot() for profile in (TWO_ENDED_PROFILE, DAEMON_PROFILE))
    (participant,) = ends.findall(".//{*}participant/{*}rtps")
    participant.remove(participant.find("{*}listenSocketBufferSize"))
    for topic in ends.findall(".//{*}data_writer")[1:]:
        ends.find("{*}profiles").remove(topic)
    for root in (ends, daemon):
        root.find(".//{*}periodMillisecs").text = ""
    lines = ([line.strip() for line in ET.tostring(root, encoding="unicode").splitlines()] for root in (ends, daemon))
    assert next(lines) == next(lines)


def test_an_end_is_on_its_host_what_it_is_on_the_link_but_for_announcements():
    """Over shared memory or UDP participants have the link's other settings; no two profiles have one name."""
    paths = TWO_ENDED_PROFILE, *map(TWO_ENDED_PROFILE.with_stem, ("fastdds-ghosts", "fastdds-udp"))
    link, here, udp = (ET.parse(path).getroot() for path in paths)
    names = [each.get("profile_name") for root in (link, here, udp) for each in root.iter() if each.get("profile_name")]
    assert len(names) == len({*names})
    discovery = [ET.tostring(root.find(".//{*}discovery_config")).split() for root in (here, udp)]
    assert discovery[0] == discovery[1]
    found = [root.find(".//{*}participant/{*}rtps") for root in (link, here, udp)]
    for participant in found:
        for name in (
            "builtin",
            "throughputController",
            "listenSocketBufferSize",
            "userTransports",
            "useBuiltinTransports",
        ):
            for each in participant.findall(f"{{*}}{name}"):
                participant.remove(each)
    lines = [ET.tostring(each).split() for each in found]
    assert lines[0] == lines[1] == lines[2]


HEARTBEAT = "<times><heartbeatPeriod><sec>0</sec></heartbeatPeriod></times>"


@pytest.mark.parametrize(
    ("content", "missing"),
    [
        (HEARTBEAT + "<maxMessageSize>1400</maxMessageSize>", ""),
        (HEARTBEAT, "{} sets no size of messages"),
        ("<dds/>", "{} sets no heartbeat period and no size of messages"),
        (None, "{} cannot be read"),
    ],
)
def test_a_profile_of_the_users_own_is_judged_by_its_settings(content, missing, tmp_path):
    """One with both settings is as good as arpd's; else what it lacks is named, and so is a file that is not there."""
    path = tmp_path / "own.xml"
    if content is not None:
        path.write_text(content)
    assert missing_in_profile({PROFILE_VARIABLE: str(path)}, folder=tmp_path) == missing.format(path)


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, "DEFAULT?non_blocking=true"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": ""}, "DEFAULT?non_blocking=true"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}, "UDPv4?non_blocking=true"),
        ({"FASTDDS_BUILTIN_TRANSPORTS": "LARGE_DATA?max_msg_size=1MB"}, "LARGE_DATA?max_msg_size=1MB"),
    ],
)
def test_the_transports_chosen_stay_and_only_an_option_is_added(before, after):
    """The user's transports stay, and so do the user's options if there are any."""
    send_without_waiting(before)
    assert before == {"FASTDDS_BUILTIN_TRANSPORTS": after}


@pytest.mark.parametrize(
    ("before", "wanted"),
    [({}, "TRUE"), ({"ROS_SUPER_CLIENT": "FALSE"}, "FALSE"), ({"ROS_SUPER_CLIENT": ""}, "TRUE")],
)
def test_a_discovery_server_tells_arpd_of_every_topic(before, wanted):
    """A plain client hears only of topics that it uses itself; arpd is a super client unless the user says no."""
    prepare_environment(OWN_PROFILE, alone := dict(before))
    assert alone.get("ROS_SUPER_CLIENT") == before.get("ROS_SUPER_CLIENT")
    prepare_environment(OWN_PROFILE, served := {**before, "ROS_DISCOVERY_SERVER": "127.0.0.1:11811"})
    assert served["ROS_SUPER_CLIENT"] == wanted


@pytest.mark.parametrize(("nodes", "link"), [("SHM", "UDPv4"), ("LARGE_DATA", "UDPv4"), ("", "DEFAULT")])
def test_the_link_s_participant_leaves_its_host_and_the_robot_s_discovery_server(nodes, link):
    """Nodes with transports of their own are met in their own domain; afterwards all is as before."""
    confined = {"ROS_DISCOVERY_SERVER": "127.0.0.1:11811", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    before = {**confined, "FASTDDS_BUILTIN_TRANSPORTS": nodes}
    with _discovery(LinkDomain(domain_id=77, peer="10.0.0.2"), environment := dict(before)):
        assert environment == {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "ROS_STATIC_PEERS": "127.0.0.1;10.0.0.2",
            "FASTDDS_BUILTIN_TRANSPORTS": f"{link}?non_blocking=true",
        }
    assert environment == before
