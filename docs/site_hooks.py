"""Hooks of MkDocs (mkdocs.yml): the page of the API, and links that lead out of docs/."""

from __future__ import annotations

import posixpath
import re
from typing import Any

from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import evpinn_ros

API = "reference/api.md"
BLOCK = """\
::: evpinn_ros.api.{name}
    options:
      heading: ev.{name}
      toc_label: {name}
"""
LINK = re.compile(r"(!?)\[([^]]*)\]\(([^):#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the page of the public API, made of its docstrings."""
    names = [name for name in evpinn_ros.__all__ if not name.startswith("_")]
    blocks = "\n".join(BLOCK.format(name=name) for name in names)
    text = f"# Python API\n\n[In use](../guides/python.md): `import evpinn_ros as ev`.\n\n{blocks}"
    files.append(File.generated(config, API, content=text))
    return files


def on_page_markdown(markdown: str, page: Page, config: Any, files: Files) -> str:
    """Keep of a link to what is not on the site its text."""
    folder = posixpath.dirname(page.file.src_uri)

    def kept(link: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, link[3]))
        return link[0] if files.get_file_from_path(target) else link[2]

    return LINK.sub(kept, markdown)
