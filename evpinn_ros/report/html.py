"""A drive in one self-contained HTML file: its picture, its scores, the command that made it."""

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
    sections = "\n".join(_section(figure, found) for figure, found in drives)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width'>"
        f"<title>evpinn report</title><style>{STYLE}</style></head><body>\n"
        f"<h1>evpinn report</h1>\n<p>Made by <code>{escape(command)}</code></p>\n"
        f"{sections}\n</body></html>\n",
        encoding="utf-8",
    )


def _section(figure: Figure, found: Mapping[str, Any]) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    image = base64.b64encode(buffer.getvalue()).decode()
    rows = "".join(
        f"<tr><th>{escape(key)}</th><td>{escape(_text(value))}</td></tr>"
        for key, value in _flat(found)
    )
    return (
        f"<h2>{escape(str(found['input']['path']))}</h2>\n"
        f"<img alt='power, energy and parameters over time' "
        f"src='data:image/png;base64,{image}'>\n<table>{rows}</table>"
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
