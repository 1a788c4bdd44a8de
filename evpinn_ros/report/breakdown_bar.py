"""Breakdown of the energy of a drive on the page: a stacked bar with sigmas, words, a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from evpinn_ros.replay.breakdown_text import COLUMNS, breakdown_lines, breakdown_rows, shown
from evpinn_ros.report.html import table

WIDTH, HEIGHT, BAR = 1000.0, 56.0, 34.0  # of the picture, and of the bar in it


def breakdown_section(found: Mapping[str, Any]) -> str:
    """The breakdown of a drive as HTML.

    Args:
        found: the metrics under `breakdown`.
    """
    title = "<h3>Where the energy went</h3>"
    first, *rest = breakdown_lines(found)
    if found["unknown"] is not None:
        return f"{title}<p>{escape(first)}</p>"
    more = "".join(f"<p class='muted'>{escape(line)}</p>" for line in rest)
    text = (
        "Whiskers are the 1-sigma of each part; the dashed line is what was measured: beyond it "
        "is what slopes or speed gave back. Brought back by braking is beside the sum."
    )
    return (
        f"{title}<p><b>{escape(first)}</b></p>{_bar(found)}<p class='muted'>{text}</p>"
        f"{table(COLUMNS, breakdown_rows(found))}{more}"
    )


def _bar(found: Mapping[str, Any]) -> str:
    """The picture: what took energy side by side; nothing where nothing did."""
    parts = [(name, part) for name, part in shown(found) if part["kwh"] > 0.0]
    whole = sum(part["kwh"] for _, part in parts)
    if not whole > 0.0:
        return ""
    scale = WIDTH / max(whole, found["measured"]["kwh"])
    pieces = "".join(_pieces(parts, scale))
    at = max(found["measured"]["kwh"], 0.0) * scale
    words = ", ".join(_words(name, part) for name, part in parts)
    return (
        f"<svg class='parts' viewBox='0 0 {WIDTH:.0f} {HEIGHT:.0f}' role='img' "
        f"aria-label='{escape(words)}'>{pieces}"
        f"<path class='measured' d='M{at:.1f} 0V{HEIGHT:.0f}'/></svg>{_key(parts)}"
    )


def _pieces(parts: list[tuple[str, Any]], scale: float) -> Iterator[str]:
    """Boxes side by side, then the whiskers of all, in three rows so that none hides another."""
    begin, whiskers = 0.0, []
    for index, (name, part) in enumerate(parts):
        width, sigma = part["kwh"] * scale, part["sigma_kwh"] * scale
        yield (
            f"<rect class='part{index}' x='{begin:.1f}' y='4' width='{width:.1f}' "
            f"height='{BAR:.0f}'><title>{escape(_words(name, part))}</title></rect>"
        )
        begin += width
        left, right = max(begin - sigma, 0.0), min(begin + sigma, WIDTH)
        row = BAR + 8.0 + 3.0 * (index % 3)
        whiskers.append(f"M{left:.1f} {row:.0f}H{right:.1f}M{begin:.1f} {row - 3:.0f}v6")
    yield f"<path class='sigma' d='{''.join(whiskers)}'/>"


def _key(parts: list[tuple[str, Any]]) -> str:
    """The colours by name."""
    return "<p class='keys'>{}</p>".format(
        " ".join(
            f"<span><i class='part{index}'></i>{escape(_words(name, part))}</span>"
            for index, (name, part) in enumerate(parts)
        )
    )


def _words(name: str, part: Mapping[str, Any]) -> str:
    return f"{name} {part['kwh']:.2f} \u00b1 {part['sigma_kwh']:.2f} kWh"
