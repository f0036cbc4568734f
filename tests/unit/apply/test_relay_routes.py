"""What a relay with one end must not carry."""

from arpd.apply.relay_routes import circle, own_output

CARRIERS, OUTPUT = {"/relay", "/relay_2"}, "/link/x"


def test_circles_are_refused_and_named():
    """A topic that the carrier writes, or that a reader of the output writes, goes round."""
    own = circle({"/a", "/relay"}, carriers=CARRIERS, output=OUTPUT, output_readers=())
    assert own == "/relay publishes it itself, so its output would be its own input"
    loop = circle({"/a", "/back"}, carriers=CARRIERS, output=OUTPUT, output_readers={"/back", "/far"})
    assert loop == "/back reads /link/x and publishes it, so messages would loop"
    assert not circle({"/a"}, carriers=CARRIERS, output=OUTPUT, output_readers={"/far"})


def test_output_names_are_no_input():
    """A name under the prefix, and one that a rule maps to itself, are refused; a longer name is not."""
    assert "already carries the prefix /link" in own_output("/link/x", prefix="/link", output="/link/link/x")
    assert "remapping rule" in own_output("/x", prefix="/link", output="/x")
    assert not own_output("/linked", prefix="/link", output="/link/linked")
