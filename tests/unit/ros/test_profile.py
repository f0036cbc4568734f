"""The Fast DDS profile that arpd's processes choose."""

import pytest

from arpd.ros.profile import missing_in_profile
from arpd.ros.runtime import FASTDDS_PROFILE, PROFILE_VARIABLES, TWO_ENDED_PROFILE, prepare_environment


@pytest.mark.parametrize("name", PROFILE_VARIABLES)
def test_a_profile_of_the_users_own_stays(name, tmp_path):
    """A profile that the user has chosen is not replaced, also if it is missing."""
    for content in ("<dds/>", None):
        path = tmp_path / "own.xml"
        path.unlink(missing_ok=True) if content is None else path.write_text(content)
        environment = {name: str(path)}
        prepare_environment(FASTDDS_PROFILE, environment)
        assert environment == {name: str(path)}


@pytest.mark.parametrize("name", PROFILE_VARIABLES)
def test_two_ends_replace_arpds_profile_for_nodes(name, tmp_path):
    """An environment that names arpd's profile for all nodes, or a copy of it, does not make an end hear itself."""
    copy = tmp_path / "copy.xml"
    copy.write_bytes(FASTDDS_PROFILE.read_bytes())
    for path in (FASTDDS_PROFILE, copy):
        environment = {name: str(path)}
        prepare_environment(TWO_ENDED_PROFILE, environment)
        assert environment["FASTRTPS_DEFAULT_PROFILES_FILE"] == str(TWO_ENDED_PROFILE)
        assert len(environment.keys() & set(PROFILE_VARIABLES)) == 1


def test_two_ends_stay_on_their_host_unless_told_otherwise():
    """The node in the local domain is confined to its host, but a range that the user has chosen stays."""
    environment: dict[str, str] = {}
    prepare_environment(TWO_ENDED_PROFILE, environment)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    prepare_environment(TWO_ENDED_PROFILE, environment)
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"


@pytest.mark.parametrize("name", PROFILE_VARIABLES)
@pytest.mark.parametrize("profile", [FASTDDS_PROFILE, TWO_ENDED_PROFILE], ids=lambda path: path.stem)
def test_arpds_profiles_miss_nothing(name, profile, tmp_path):
    """Both profiles are right, whatever variable names them."""
    assert missing_in_profile({name: str(profile)}, folder=tmp_path) == ""


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
    assert missing_in_profile({PROFILE_VARIABLES[0]: str(path)}, folder=tmp_path) == missing.format(path)
