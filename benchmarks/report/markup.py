"""From the markdown of the tables to HTML that needs nothing beside it."""

from __future__ import annotations

import base64
import html
import re
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from matplotlib.colors import to_hex

from benchmarks.curves import COLORS
from benchmarks.tables_columns import COLUMNS

MIME = {".png": "image/png", ".gif": "image/gif", ".svg": "image/svg+xml", ".mp4": "video/mp4"}
MISSING = ("", "-", "not run")
NUMBER = re.compile(r"[+-]?\d+(\.\d+)?(?![\w.])")
INTERVAL = re.compile(r"(\[[^\]]*\d[^\]]*\])")
OF_A_METHOD = ("method", "training")
SHORT = 26  # characters that stay on one line


def data_uri(content: bytes, suffix: str) -> str:
    """A file as part of the page."""
    return f"data:{MIME[suffix]};base64,{base64.b64encode(content).decode()}"


def figure(content: bytes, suffix: str, caption: str) -> str:
    """A picture over its caption."""
    words = html.escape(caption)
    return f'<figure><img src="{data_uri(content, suffix)}" alt="{words}"><figcaption>{words}</figcaption></figure>'


def sort_key(cell: str) -> str:
    """What a cell is sorted by: its first number, which is the mean; nothing where there is no result.

    What never happened comes after all numbers.
    """
    text = cell.strip("` ")
    if text in MISSING:
        return ""
    if text.startswith("never"):
        return "Infinity"
    number = NUMBER.match(text)
    return number.group() if number else text


class Markup:
    """Renders the lines of a table: headings sort and explain themselves, pictures are part of the page.

    Attributes:
        shown: the picture files that were met.
    """

    def __init__(self) -> None:
        self.shown: set[Path] = set()
        self._columns: list[str] = []
        self._at = 0
        self._markdown = MarkdownIt("commonmark").enable("table")
        for name in ("table_open", "table_close", "th_open", "th_close", "tr_open", "td_open", "image", "link_open",
                     "link_close", "paragraph_open", "paragraph_close", "text"):  # fmt: skip
            self._markdown.renderer.rules[name] = getattr(self, f"_{name}")

    def __call__(self, lines: list[str]) -> str:
        """HTML of markdown lines."""
        return self._markdown.render("\n".join(lines))

    def _table_open(self, *_: Any) -> str:
        self._columns = []
        return '<div class="wide"><table>'

    def _table_close(self, *_: Any) -> str:
        return "</table></div>"

    def _th_open(self, tokens: Any, index: int, *_: Any) -> str:
        name = tokens[index + 1].content
        self._columns.append(name)
        meaning = html.escape(COLUMNS.get(name, ""))
        return f'<th scope="col"><button type="button" title="{meaning}">'

    def _th_close(self, *_: Any) -> str:
        return "</button></th>"

    def _tr_open(self, *_: Any) -> str:
        self._at = 0
        return "<tr>"

    def _td_open(self, tokens: Any, index: int, *_: Any) -> str:
        cell, column = tokens[index + 1].content, self._columns[self._at]
        self._at += 1
        key = sort_key(cell)
        classes = "missing" if not key else "short" if len(cell) <= SHORT or NUMBER.fullmatch(key) else ""
        return f'<td class="{classes}" data-key="{html.escape(key)}">{self._dot(cell) if column in OF_A_METHOD else ""}'

    @staticmethod
    def _dot(cell: str) -> str:
        """The colour of a method, the same as in figures."""
        method = re.match(r"\w+", cell)
        colour = COLORS.get(method.group()) if method else None
        return f'<i class="dot" style="background:{to_hex(colour)}"></i>' if colour else ""

    @staticmethod
    def _text(tokens: Any, index: int, *_: Any) -> str:
        return INTERVAL.sub(r'<span class="interval">\1</span>', html.escape(tokens[index].content, quote=False))

    def _image(self, tokens: Any, index: int, *_: Any) -> str:
        path = Path(tokens[index].attrs["src"])
        self.shown.add(path)
        return figure(path.read_bytes(), path.suffix, tokens[index].content)

    @staticmethod
    def _link_open(*_: Any) -> str:
        return '<span class="link">'  # to files that are not part of the page

    @staticmethod
    def _link_close(*_: Any) -> str:
        return "</span>"

    @staticmethod
    def _holds_picture(tokens: Any, index: int) -> bool:
        return any(child.type == "image" for child in tokens[index].children or ())

    def _paragraph_open(self, tokens: Any, index: int, *_: Any) -> str:
        return "" if self._holds_picture(tokens, index + 1) else "<p>"

    def _paragraph_close(self, tokens: Any, index: int, *_: Any) -> str:
        return "" if self._holds_picture(tokens, index - 1) else "</p>"
