"""`evpinn bench ablation`: what each part of the core is worth without the battery."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from benchmarks.ablation import CARS, VARIANTS, ablate
from benchmarks.variants import Row, read_car
from evpinn_ros.cli.console import progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption
from evpinn_ros.cli.tables import titled_table

COLUMNS = (
    "left out",
    "carried: net %",
    "in 90 %",
    "200 s: gross %",
    "in 90 %",
    "likelihood",
    "lost by leaving out",
)


def ablation(
    data: Annotated[str, typer.Argument(help="Folder of cars, as of `evpinn bench unseen`.")],
    cars: Annotated[str, typer.Option(help="Only these of them, by comma.")] = ",".join(CARS),
    json_file: JsonOption = None,
) -> None:
    """Leave out one part of the core after the other, and score drives without the battery.

    Example: evpinn bench ablation $DATA --cars i3,e208
    """
    rows: list[Row] = []
    keys = cars.split(",")
    with progress_bar("variants", len(keys) * len(VARIANTS), unit="variants") as progress:
        for key in keys:
            for row in ablate(read_car(data, key)):
                rows.append(row)
                progress(len(rows))
    for key in keys:
        table = titled_table(key)
        for name in COLUMNS:
            table.add_column(name, justify="left" if name == COLUMNS[0] else "right")
        whole, *_ = found = [each for each in rows if each.car == key]
        for row in found:
            table.add_row(
                row.variant,
                f"{row.carried_net[0]:.1f}; {row.carried_net[1]:.1f}",
                f"{row.carried_coverage:.0f}",
                f"{row.stretch_gross:.1f}",
                f"{row.stretch_coverage:.0f}",
                f"{row.likelihood:.2f}",
                "" if row is whole else "{:+.2f} +- {:.2f}".format(*whole.gain(row)),
            )
        show(table)
    if json_file is not None:
        write_json(json_file, [asdict(row) for row in rows])
