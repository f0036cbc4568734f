"""`arpd run` on its own: a taken port, a missing interface, an unknown name, and a stop."""

import json
import socket

from tests.waiting import PATIENCE_S


def test_without_a_port_and_an_interface_it_runs_and_stops_cleanly(arpd, tmp_path, eventually):
    """It names a taken port and a missing interface, serves once the port is free, and exits 0."""
    path, log = tmp_path / "arpd.yaml", (tmp_path / "log").read_text
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        path.write_text(json.dumps({"link": {"interface": "wlan9"}, "http": {"port": port}}))
        process = arpd("run", "--config", path)
        eventually("it ticks", lambda: "wlan9 is not there yet" in log())
        assert f"cannot listen on 127.0.0.1:{port}" in log()
    eventually("it serves", lambda: "metrics at" in log())
    process.terminate()
    assert process.wait(timeout=PATIENCE_S) == 0
    assert "Traceback" not in log()


def test_a_peer_tells_that_its_interface_is_missing(arpd, tmp_path, eventually):
    """Its line for systemd and the log say so; it waits for the interface."""
    arpd("peer", "--interface", "wlan9")
    eventually("it says so", lambda: "arrives on wlan9 (which is gone) as" in (tmp_path / "log").read_text())


def test_an_end_whose_name_nobody_knows_is_named(arpd, tmp_path, eventually):
    """It is no fault of ROS, and the message says which key to look at."""
    (tmp_path / "arpd.yaml").write_text(json.dumps({"relay": {"link_domain": 77, "base": "no-such-host.invalid"}}))
    process = arpd("run", "--config", tmp_path / "arpd.yaml")
    eventually("it ends", lambda: process.poll() is not None)
    said = (tmp_path / "log").read_text().splitlines()[-1]
    assert (process.returncode, said.startswith("arpd: relay.robot or relay.base: this computer")) == (1, True)
    assert "no-such-host.invalid" in said
