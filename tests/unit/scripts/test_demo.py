"""scripts/demo and scripts/simlink: the place of the bottleneck, and a system that has no link."""

import shutil
import socket
import sys
from unittest.mock import Mock

import pytest

from scripts.netns import __main__ as simlink
from scripts.robot import demo


@pytest.mark.parametrize("more", [[], ["--serve"]], ids=["compared", "served"])
@pytest.mark.parametrize(
    ("options", "wanted"),
    [([], "sender"), (["--bottleneck", "sender"], "sender"), (["--bottleneck", "middle"], "middle")],
)
def test_the_bottleneck_of_the_demo_is_where_its_user_wants_it(monkeypatch, tmp_path, options, more, wanted):
    """It is at the sender unless the option says otherwise, with two runs and with one that goes on."""
    world_of = Mock(side_effect=demo.DemoError("that is enough"))
    monkeypatch.setattr(demo, "world_of", world_of)
    monkeypatch.setattr(demo, "_need_link", lambda: None)
    monkeypatch.setattr(demo, "_listen", lambda: socket.create_server(("127.0.0.1", 0)))
    monkeypatch.setattr(demo.tempfile, "mkdtemp", lambda **_: str(tmp_path))
    monkeypatch.setenv("ARPD_DEMO_LISTENER", "")
    monkeypatch.setattr(sys, "argv", ["scripts/demo", *options, *more])
    assert demo.main() == 1
    assert [asked.kwargs["bottleneck"] for asked in world_of.call_args_list] == [wanted]


def test_another_bottleneck_is_refused_with_those_there_are(monkeypatch, capsys):
    """As every option with a choice."""
    monkeypatch.setattr(sys, "argv", ["scripts/demo", "--bottleneck", "base"])
    with pytest.raises(SystemExit, match="2"):
        demo.main()
    assert "middle" in capsys.readouterr().err


def test_a_user_without_root_and_unshare_is_told_what_to_install(monkeypatch, capsys):
    """No link can be made then, and a traceback would not say why."""
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    monkeypatch.setattr(sys, "argv", ["scripts/simlink"])
    assert simlink.main() == 1
    assert "not root, and unshare: command not found; on Debian and Ubuntu: apt install" in capsys.readouterr().err
