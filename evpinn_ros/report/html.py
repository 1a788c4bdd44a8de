"""One self-contained HTML file: pictures, tables and the command that made them."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from html import escape
import io
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

STYLE = """body { font: 16px/1.5 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto;
padding: 0 1rem; color: #222 } img { width: 100% } table { border-collapse: collapse }
td, th { padding: .2rem .8rem; text-align: left; border-bottom: 1px solid #ddd }
code { background: #f3f3f3; padding: .1rem .3rem }"""


def write_html(
    path: Path, drives: Sequence[tuple[Figure, Mapping[str, Any]]], command: str
) -> None:
    """Write the report of one or several drives, each a figure and its metrics."""
    write_page(path, "evpinn report", command, [_section(*drive) for drive in drives])


def write_page(path: Path, title: str, command: str, sections: Sequence[str]) -> None:
    """Write a page of sections that are HTML already."""
    body = "\n".join(sections)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'>"
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>\n"
        f"<h1>{escape(title)}</h1>\n<p>Made by <code>{escape(command)}</code></p>\n"
        f"{body}\n</body></html>\n",
        encoding="utf-8",
    )


def embedded(figure: Figure, description: str) -> str:
    """A picture inside the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    image = base64.b64encode(buffer.getvalue()).decode()
    return f"<img alt='{escape(description)}' src='data:image/png;base64,{image}'>"


def _section(figure: Figure, found: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><th>{escape(key)}</th><td>{escape(_text(value))}</td></tr>"
        for key, value in _flat(found)
    )
    return (
        f"<h2>{escape(str(found['input']['path']))}</h2>\n"
        f"{embedded(figure, 'power, energy and parameters over time')}\n<table>{rows}</table>"
    )


def _flat(found: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in found.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "unknown" if value is None else "none" if value == {} else str(value)
