"""`evpinn bench ablation`: what each part of the core is worth without the battery."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from benchmarks.ablation import CARS, VARIANTS, ablate
from benchmarks.cli.output import table_of
from benchmarks.variants import SCORE_COLUMNS, VariantRow, read_car
from evpinn_ros.cli.console import progress_bar, show, write_json
from evpinn_ros.cli.options import JsonOption


def ablation(
    data: Annotated[str, typer.Argument(help="Folder of cars, as of `evpinn bench unseen`.")],
    cars: Annotated[str, typer.Option(help="Only these of them, by comma.")] = ",".join(CARS),
    json_file: JsonOption = None,
) -> None:
    """Leave out each part of the core in turn, and score drives.

    Example: evpinn bench ablation $DATA --cars i3,e208
    """
    rows: list[VariantRow] = []
    keys = cars.split(",")
    with progress_bar("variants", len(keys) * len(VARIANTS), unit="variants") as progress:
        for key in keys:
            for row in ablate(read_car(data, key)):
                rows.append(row)
                progress(len(rows))
    for key in keys:
        whole, *_ = own = [row for row in rows if row.car == key]
        lost = ["{:+.2f} +- {:.2f}".format(*whole.gain(row)) for row in own]
        columns = ("left out", "{0.variant}"), *SCORE_COLUMNS, ("lost by leaving out", "{1}")
        show(table_of(key, list(zip(own, ["", *lost[1:]], strict=True)), columns))
    if json_file is not None:
        write_json(json_file, [asdict(row) for row in rows])
