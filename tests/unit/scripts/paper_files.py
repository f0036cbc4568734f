"""The files that the nodes of the paper's benchmark write, for tests of what reads them."""

from array import array


class PaperFiles:
    """Keeps columns of whole numbers as files."""

    def __init__(self, folder):
        self.folder = folder

    def pairs(self, name, pairs):
        return {
            "numbers": self.keep(f"{name}-n", [n for n, _ in pairs]),
            "received": self.keep(f"{name}-r", [at for _, at in pairs]),
        }

    def keep(self, name, values):
        path = self.folder / f"{name}.i64"
        path.write_bytes(array("q", values).tobytes())
        return str(path)
