"""The web-config file: the keys of exporters, one clear line for each fault, and changes while the daemon runs."""

import logging
import os
import re
import shutil
import ssl
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from prometheus_client import CollectorRegistry

from arpd.model.errors import ConfigError
from arpd.model.settings import HttpSettings
from arpd.web.access import Access, HttpCounts, exposure
from arpd.web.web_config import Protection, load_protection
from tests.unit.web_world import HASH, make_certificate

FAULT = re.compile(r".+?:[1-9]\d*:[1-9]\d*: [^ ].*?: .+; .+")
SECRET = "$2y$10$short-and-secret"
HTTP = HttpSettings(web_config="web.yaml")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certificates")
    make_certificate(folder, "server")
    make_certificate(folder, "other")
    make_certificate(folder, "ca")
    (folder / "text.txt").write_text("nothing of the kind")
    (folder / "large.crt").write_bytes(bytes(2**20))
    lock = ["openssl", "ec", "-in", "server.key", "-aes256", "-passout", "pass:x", "-out", "locked.key"]
    subprocess.run(lock, cwd=folder, check=True, capture_output=True)
    return folder


@pytest.fixture
def folder(certificates, tmp_path):
    shutil.copytree(certificates, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def load(certificates):
    def load(text):
        (certificates / "web.yaml").write_text(text)
        return load_protection(HTTP, directory=certificates)

    return load


TLS = "tls_server_config: {cert_file: server.crt, key_file: server.key"


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("tls_servr_config: {}", "1:1: tls_servr_config", "did you mean tls_server_config?"),
        ("tls_server_config: {key_file: server.key}", "1:20: tls_server_config.cert_file", "is missing"),
        ("tls_server_config:", "1:19: tls_server_config", "has no value"),
        (f"{TLS}, key: x}}", "1:66: tls_server_config.key", "known here: cert_file, key_file, client_auth_type"),
        ("basic_auth_users: [a]", "1:19: basic_auth_users", "is not a mapping"),
        (f"basic_auth_users: {{alice: {SECRET}}}", "1:27: basic_auth_users.alice", "not a bcrypt hash"),
        (f"basic_auth_users: {{a: '{HASH.replace('$04$', '$20$')}'}}", "1:23: basic_auth_users.a", "cost 20"),
        (f"basic_auth_users: {{'a:b': {HASH}}}", "1:27: basic_auth_users.'a:b'", "cannot be a name"),
        (f"{TLS}, client_auth_type: Any}}", "tls_server_config.client_auth_type", "write NoClientCert or"),
        (f"{TLS}, client_auth_type: RequireAndVerifyClientCert}}", "1:20: tls_server_config", "both or neither"),
        ("tls_server_config: {cert_file: no.crt, key_file: server.key}", "", "no.crt cannot be read (No such file"),
        ("tls_server_config: {cert_file: large.crt, key_file: server.key}", "", "large.crt is larger than 512 KiB"),
        ("tls_server_config: {cert_file: text.txt, key_file: server.key}", "", "cert_file and key_file cannot be used"),
        ("tls_server_config: {cert_file: server.crt, key_file: other.key}", "", "(KEY_VALUES_MISMATCH); name a"),
        ("tls_server_config: {cert_file: server.crt, key_file: locked.key}", "", "has a passphrase"),
    ],
)
def test_faults_name_place_key_and_way_out(load, text, place, words):
    """Each fault is one line, as for arpd.yaml, and no line shows a hash."""
    with pytest.raises(ConfigError) as refused:
        load(text)
    (fault,) = refused.value.faults
    assert FAULT.fullmatch(fault)
    assert f"{place}: " in fault
    assert words in fault
    assert SECRET not in fault
    assert "$2b$" not in fault


def test_every_fault_of_the_file_is_told(load):
    """One correction is enough, and TLS that was only begun is not taken for none."""
    with pytest.raises(ConfigError) as refused:
        load(f"tls_server_config:\nbasic_auth_users: {{alice: {SECRET}}}\nfoo: 1")
    assert [fault.split(": ")[1] for fault in refused.value.faults] == [
        "tls_server_config",
        "basic_auth_users.alice",
        "foo",
    ]


def test_a_fifo_is_no_certificate(folder):
    """What it holds is read once, and OpenSSL would wait for its next writer, and the HTTP server with it."""
    path = folder / "server.crt"
    certificate = path.read_text()
    path.unlink()
    os.mkfifo(path)
    (folder / "web.yaml").write_text(TLS + "}")
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK)):  # else nobody can write into it
        path.write_text(certificate)
        with pytest.raises(ConfigError, match="is no regular file; name a PEM file"):
            load_protection(HTTP, directory=folder)


def test_the_shipped_example_is_only_comments_and_right(load):
    """Without its comment signs, the example needs only files and a hash to load."""
    text = (Path(__file__).parents[3] / "etc" / "arpd" / "web-config.yaml").read_text()
    assert all(line.startswith("#") or not line for line in text.splitlines())
    live = re.sub(r"^#(?=[a-z]|  )", "", text, flags=re.MULTILINE)
    for name, here in (("robot", "server"), ("clients.crt", "other.crt"), ("$2y$10$...", HASH)):
        live = live.replace(name, here)
    protection = load(live)
    assert protection.tls.minimum_version is ssl.TLSVersion.TLSv1_2
    assert protection.requires_certificate
    assert [*protection.basic_auth_users.values()] == [HASH.encode()]
    assert HASH not in repr(protection)


# -- changes while the daemon runs


BOTH = f"{TLS}, client_auth_type: RequireAndVerifyClientCert, client_ca_file: ca.crt}}"


@pytest.fixture
def access(folder):
    path = folder / "web.yaml"
    path.write_text(f"{BOTH}\nbasic_auth_users: {{alice: {HASH}}}")
    registry = CollectorRegistry()
    access = Access(HTTP, directory=folder, counts=HttpCounts(registry))
    is_good = lambda: registry.get_sample_value("arpd_http_config_last_reload_successful")  # noqa: E731
    return SimpleNamespace(access=access, follow=access.follow, path=path, is_good=is_good)


def test_users_and_certificates_are_read_again_when_they_change(access, folder):
    """A new user and a renewed certificate are in force at the next look; unchanged files are not read."""
    assert not access.follow()
    access.path.write_text(f"{BOTH}\nbasic_auth_users: {{bob: {HASH}}}")
    assert access.follow()
    second = access.access.protection
    assert set(second.basic_auth_users) == {b"bob"}
    for ending in ("crt", "key"):
        (folder / f"other.{ending}").rename(folder / f"server.{ending}")
    assert access.follow()
    assert access.access.protection.tls is not second.tls
    assert not access.follow()


def test_a_broken_file_leaves_the_last_good_one_in_force(access, caplog):
    """A broken file is logged once and shows in the metrics; the next good file is in force."""
    first = access.access.protection
    access.path.write_text("basic_auth_users: {alice: x}")
    for _ in range(3):
        assert not access.follow()
    assert access.access.protection is first
    assert access.is_good() == 0
    assert len([r for r in caplog.records if r.levelno == logging.ERROR]) == 1
    access.path.write_text(f"{BOTH}\nbasic_auth_users: {{carol: {HASH}}}")
    assert access.follow()
    assert set(access.access.protection.basic_auth_users) == {b"carol"}
    assert access.is_good() == 1


@pytest.mark.parametrize(
    "text", ["", BOTH, f"basic_auth_users: {{alice: {HASH}}}", f"{TLS}}}\nbasic_auth_users: {{alice: {HASH}}}"]
)
def test_no_change_of_the_file_opens_the_port(access, text):
    """What asks of clients stays until a restart, so that an editor that writes a file in two steps opens nothing."""
    access.path.write_text(text)
    assert not access.follow()
    assert access.is_good() == 0


def test_what_is_open_to_the_network_is_said(load):
    """Beyond loopback there is a risk without TLS, and without users or client certificates."""
    tls, clients, users = load(f"{TLS}}}"), load(BOTH), load(f"basic_auth_users: {{alice: {HASH}}}")
    assert exposure(["127.0.0.1", "::1"], Protection()) == ""
    assert "anyone" in exposure(["127.0.0.1", "0.0.0.0"], Protection())
    assert "anyone" in exposure(["fe80::1%eth0"], tls)
    assert "unencrypted" in exposure(["::"], users)
    both = replace(tls, basic_auth_users=users.basic_auth_users)
    assert exposure(["192.0.2.1"], clients) == exposure(["192.0.2.1"], both) == ""
