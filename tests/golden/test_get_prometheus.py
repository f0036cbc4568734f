"""scripts/get-prometheus on a machine with Prometheus and on one without."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

GET_PROMETHEUS = Path(__file__).parents[2] / "scripts" / "get-prometheus"
TOOLS = ("bash", "dirname", "mkdir", "mktemp", "rm", "mv", "grep", "id", "flock", "dpkg-deb", "tar", "xz", "zstd")


@pytest.fixture
def path(tmp_path):
    """Return a PATH with the script's tools, without Prometheus and apt-get."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for tool in TOOLS:
        if found := shutil.which(tool):
            (folder / tool).symlink_to(found)
    return folder


def get(path, cache, *arguments):
    environment = {**os.environ, "PATH": str(path), "ARPD_CACHE": str(cache)}
    command = [shutil.which("bash"), GET_PROMETHEUS, *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def program(folder, name, text="exit 0"):
    folder.mkdir(exist_ok=True)
    made = folder / name
    made.write_text(f"#!{shutil.which('bash')}\n{text}\n")
    made.chmod(0o755)
    return made


def test_one_on_path_is_taken(path, tmp_path):
    """The script prefers an installed program to the cache."""
    installed = program(path, "promtool")
    program(tmp_path / "cache", "promtool")
    assert get(path, tmp_path / "cache", "promtool").stdout == f"{installed}\n"


def test_one_in_the_cache_is_taken(path, tmp_path):
    """Without a program on PATH, the script uses the cached one."""
    cached = program(tmp_path / "cache", "prometheus")
    assert get(path, tmp_path / "cache", "prometheus").stdout == f"{cached}\n"


def test_both_come_out_of_one_package(path, tmp_path):
    """The script unpacks a download without installing it, and keeps only server and promtool in the cache."""
    tree = tmp_path / "package"
    (tree / "DEBIAN").mkdir(parents=True)
    (tree / "DEBIAN/control").write_text(
        "Package: prometheus\nVersion: 1\nArchitecture: all\nMaintainer: x\nDescription: x\n"
    )
    for name in ("prometheus", "promtool"):
        (tree / "usr/bin").mkdir(parents=True, exist_ok=True)
        program(tree / "usr/bin", name)
    package = tmp_path / "prometheus_1_all.deb"
    subprocess.run(["dpkg-deb", "--build", "--root-owner-group", tree, package], check=True, capture_output=True)
    shutil.copy(shutil.which("cp"), path / "cp")
    program(path, "apt-get", f'[ "$1" = download ] && cp {package} .')
    cache = tmp_path / "cache"
    got = get(path, cache, "promtool")
    assert got.stdout == f"{cache / 'promtool'}\n", got.stderr
    assert sorted(item.name for item in cache.iterdir()) == ["prometheus", "prometheus.lock", "promtool"]
    (path / "apt-get").unlink()
    assert get(path, cache, "prometheus").stdout == f"{cache / 'prometheus'}\n"


def test_it_says_why_there_is_none(path, tmp_path):
    """Without apt-get, or if it fails, the script exits 1 with the reason; another program is a usage error."""
    got = get(path, tmp_path / "cache", "promtool")
    assert (got.returncode, got.stdout) == (1, "")
    assert "no apt-get to fetch it with" in got.stderr
    program(path, "apt-get", "echo 'E: Unable to locate package prometheus'; exit 100")
    got = get(path, tmp_path / "cache", "promtool")
    assert got.returncode == 1
    assert "E: Unable to locate package prometheus" in got.stderr
    assert get(path, tmp_path / "cache", "grafana").returncode == 2
