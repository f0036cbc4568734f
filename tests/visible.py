"""What a reader sees of the page when no script runs."""

from __future__ import annotations

from html.parser import HTMLParser

_INLINE = {"span", "time", "strong", "code"}
_VOID = {"meta", "link", "br", "img", "input"}


class _Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.said: list[str] = []
        self._unseen: list[str] = []  # elements entered since one that is not shown

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        names = {name for name, _ in attrs}
        if tag not in _INLINE:
            self.said.append(" ")
        if tag not in _VOID and (self._unseen or "hidden" in names or tag in {"template", "script", "style"}):
            self._unseen.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self._unseen:
            assert self._unseen.pop() == tag, f"</{tag}> closes nothing"

    def handle_data(self, data: str) -> None:
        if not self._unseen:
            self.said.append(data)


def visible(page: str) -> str:
    """Return the text of the page that is shown, its white space joined."""
    reader = _Reader()
    reader.feed(page)
    reader.close()
    return " ".join("".join(reader.said).split())


class _Places(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: dict[str, list[str]] = {}
        self._open: list[str] | None = None
        self._templates = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self._templates += tag == "template"
        if "data-field" in named and tag == "span" and not self._templates:
            self._open = self.found.setdefault(f"{named['data-field']}|{named['data-format']}", [])
            self._open.append("")

    def handle_endtag(self, tag: str) -> None:
        self._templates -= tag == "template"
        self._open = None

    def handle_data(self, data: str) -> None:
        if self._open is not None:
            self._open[-1] += data


def fields(page: str) -> dict[str, list[str]]:
    """Return what stands in each place of the page, by path and format; times aside."""
    places = _Places()
    places.feed(page)
    places.close()
    return places.found
