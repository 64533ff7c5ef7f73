"""The documentation site shows pictures of results/, which lie beside docs/: they join its files, and links follow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

TOP = Path(__file__).parents[1]
OUTSIDE = {"](../results/": "](results/", "](../README.md": "](index.md"}


def on_files(files: Any, config: Any) -> Any:
    """Add the pictures of results."""
    for picture in sorted((TOP / "results").glob("*.png")):
        path = picture.relative_to(TOP).as_posix()
        files.append(File.generated(config, path, abs_src_path=str(picture)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Let links that leave docs/ point into the site."""
    for link, inside in OUTSIDE.items():
        markdown = markdown.replace(link, inside)
    return markdown
