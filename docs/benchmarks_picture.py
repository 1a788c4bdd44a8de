"""The table and the picture of docs/project/benchmarks.md: errors by car and method.

Run: python docs/benchmarks_picture.py (`make docs` does), which draws the picture and prints the
table. A test compares the table with the page. With COMMIT and files of `bench unseen --json`, it
first writes their cars into unseen.json.
"""

from collections.abc import Sequence
from datetime import date
import json
from pathlib import Path
import sys
from typing import Any

from matplotlib.figure import Figure
import numpy as np

from evpinn_ros.report.figure import save_figure

ROOT = Path(__file__).resolve().parents[1]
SCORES = ROOT / "docs" / "project" / "unseen.json"
OURS, HOLDS = "this package", "90 %"
MARKS = {
    OURS: ("o", "tab:blue", 90),
    "vehicle file alone": ("s", "tab:orange", 45),
    "energy per km so far": ("^", "tab:gray", 45),
    "least squares, 13 terms": ("D", "tab:green", 35),
}
METHODS = dict(zip(MARKS, ("core", "prior", "per_km", "weak_ls"), strict=True))
CARS = {
    "i3": "BMW i3, laboratory log, 10 Hz",
    "i3_speed": "BMW i3, speed alone",
    "e208": "Peugeot e-208, Car Scanner, no heights",
    "leaf2013": "Nissan Leaf 2013, LeafSpy, every 2 to 6 s",
    "three_wheeler": "Cargo three-wheeler, 1 Hz, generic vehicle",
    "changchun": "Changchun sedan, 20 Hz, generic vehicle",
}
RIGHT = (85, 95)  # % of intervals that hold: as many as they promise


def taken(commit: str, files: Sequence[Path]) -> dict[str, Any]:
    """The contents of unseen.json with what files that were written on one commit score.

    A method that no file scores keeps its error, and the row names the commit of that too, the
    oldest if there are several.
    """
    rows = {row["car, log"]: row for row in cars()}
    for file in files:
        for key, scored in json.loads(file.read_text(encoding="utf-8"))["cars"].items():
            methods, row = scored["methods"], rows[CARS[key]]
            left = ", ".join(name for name, method in METHODS.items() if method not in methods)
            row["drives"] = scored["drives"]
            before = row["commit"].rpartition(": ")[2]  # of what was measured longest ago
            row["commit"] = f"{commit}; {left}: {before}" if left else commit
            for name, method in METHODS.items():
                if method in methods:
                    row[name] = round(methods[method]["carried"]["net_median_percent"], 1)
            row[HOLDS] = round(methods[METHODS[OURS]]["carried"]["inside_90_percent"])
    methods = ",".join(METHODS.values())
    return {
        "command": f"evpinn bench unseen DATA --methods {methods} --json unseen.json",
        "date": date.today().isoformat(),
        "unit": "median error of the energy of a drive, %; share of 90 % intervals that hold, %",
        "cars": [rows[name] for name in CARS.values() if name in rows],
    }


def cars() -> list[dict[str, str | float]]:
    """The scores of each car, by the title of the column."""
    return list(json.loads(SCORES.read_text(encoding="utf-8"))["cars"])


def table() -> str:
    """The scores as the page shows them; the best error of a car is bold."""
    titles = ("car, log", "drives", OURS, HOLDS, *[name for name in MARKS if name != OURS])
    lines = [titles, ("---",) * len(titles)]
    for car in cars():
        best = min(float(car[name]) for name in MARKS)
        lines.append(
            tuple(
                f"**{car[title]}**" if title in MARKS and car[title] == best else f"{car[title]}"
                for title in titles
            )
        )
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Take new scores if there are any, draw a line of marks for each car, print the table."""
    if len(sys.argv) > 2:
        document = taken(sys.argv[1], [Path(name) for name in sys.argv[2:]])
        SCORES.write_text(
            json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    scored = cars()
    figure = Figure(figsize=(9.0, 1.2 + 0.55 * len(scored)), layout="constrained")
    axes = figure.add_subplot()
    place = np.arange(len(scored))[::-1]
    for name, (marker, color, size) in MARKS.items():
        errors = [float(row[name]) for row in scored]
        axes.scatter(errors, place, s=size, c=color, marker=marker, label=name, zorder=3)
    for where, row in zip(place, scored, strict=True):
        right = RIGHT[0] <= float(row[HOLDS]) <= RIGHT[1]
        color = "tab:green" if right else "tab:red"
        text = f"{row[HOLDS]} %"
        axes.annotate(
            text, (1.02, where), xycoords=("axes fraction", "data"), color=color, va="center"
        )
    axes.annotate("90 % intervals\nthat hold", (1.02, 1.02), xycoords="axes fraction")
    axes.set_yticks(place, [f"{row['car, log']}\n{row['drives']} drives" for row in scored])
    axes.set_ylim(-0.6, len(scored) - 0.4)
    axes.set_xscale("log")
    ticks = (1, 3, 5, 10, 20, 50)
    axes.set_xticks(ticks, [f"{tick} %" for tick in ticks])
    axes.minorticks_off()
    axes.grid(axis="x", alpha=0.3)
    axes.set_xlabel("median error of the energy of a drive, battery hidden")
    figure.legend(loc="outside upper left", ncols=len(MARKS), frameon=False)
    save_figure(figure, ROOT / "docs" / "benchmarks.png")
    print(table())


if __name__ == "__main__":
    main()
