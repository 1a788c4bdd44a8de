"""Effect of each choice that the paper leaves open: the table in `docs/explanation/paper.md`.

python docs/paper_choices.py LOG VEHICLE [EPOCHS]
"""

from collections.abc import Callable
from pathlib import Path
import sys

import torch

from evpinn_ros.common.arrays import chosen_rows
from evpinn_ros.common.blas_threads import limit_blas_threads
from evpinn_ros.core.vehicle.files import Vehicle, load_vehicle
from evpinn_ros.core.vehicle.physics import RegenForm
from evpinn_ros.extras.paper import network, problem
from evpinn_ros.extras.paper.drive_log import DriveLog, read_drive_log
from evpinn_ros.extras.paper.optimizers import Adam
from evpinn_ros.extras.paper.problem import InputForm, Problem, chronological_split, random_split
from evpinn_ros.extras.paper.scores import combinations, least_squares_power, power_score

Choice = Callable[[DriveLog, Vehicle, int], Adam]  # takes the epochs as well


def published(log: DriveLog, vehicle: Vehicle, epochs: int, **options: object) -> Adam:
    """Adam on the problem as `evpinn reproduce` sets it."""
    split = random_split(len(log.time), 0)
    return Adam(Problem(log, vehicle, split, **options), epochs, seed=0)


def without_time(log: DriveLog, vehicle: Vehicle, epochs: int) -> Adam:
    """Speed alone: time is held at zero."""
    still = log._replace(time=log.time * 0.0)
    return published(still, vehicle, epochs)


def pytorch_start(log: DriveLog, vehicle: Vehicle, epochs: int) -> Adam:
    """PyTorch's own initial weights in place of Glorot's."""
    adam = published(log, vehicle, epochs)
    torch.manual_seed(0)
    for layer in adam.network.layers:
        layer.reset_parameters()
    return adam


class BatchedAdam(Adam):
    """Adam on batches of `SIZE`: an epoch is then as many steps as there are batches."""

    SIZE = 256

    def step(self) -> None:
        """One pass over the training data."""
        whole = self.problem.training
        for rows in torch.randperm(len(whole.power)).split(self.SIZE):
            self.problem.training = chosen_rows(whole, rows)
            super().step()
        self.problem.training = whole


def batched(log: DriveLog, vehicle: Vehicle, epochs: int) -> Adam:
    """Twenty-four steps an epoch in place of one."""
    torch.manual_seed(0)
    return BatchedAdam(Problem(log, vehicle, random_split(len(log.time), 0)), epochs, seed=0)


def chronological(log: DriveLog, vehicle: Vehicle, epochs: int) -> Adam:
    """Trained on the first four fifths."""
    return Adam(Problem(log, vehicle, chronological_split(len(log.time))), epochs, seed=0)


CHOICES: dict[str, Choice] = {
    "as `evpinn reproduce`": published,
    "inputs mapped to [-1, 1]": lambda *a: published(*a, inputs=InputForm.UNIT),
    "PyTorch's own start": pytorch_start,
    "eq. 21 as printed": lambda *a: published(*a, form=RegenForm.PRINTED),
    "`wheel_power`": lambda *a: published(*a, form=RegenForm.WHEEL_POWER),
    "speed alone, no time": without_time,
    "chronological split": chronological,
    "batches of 256": batched,
}


def row(title: str, adam: Adam) -> str:
    """One line of the table, after training."""
    adam.run_to(adam.epochs)
    own = adam.problem
    held = chosen_rows(own.log, own.split.validation)
    score = power_score(own.predicted_power(adam.network, held), held.power, own.scale)
    losses = own.losses(own.validation, adam.network, adam.log_scale.detach())
    values = adam.values
    determined = combinations(values, own.vehicle.frontal_area, RegenForm.RECOVERY)
    return (
        f"| {title} | {losses.total:.4f} | {losses.data:.4f} | {score.r2:.3f} | "
        f"{determined['mass_over_eta']:.0f} | {values.mu:.3f} | {values.c_rr:.4f} |"
    )


def fit_rows(log: DriveLog, vehicle: Vehicle) -> list[str]:
    """Fits of the readings of eq. 21 by least squares, without any network."""
    rows = []
    for form in RegenForm:
        problem = Problem(
            log, vehicle, random_split(len(log.time), 0), form=form, dtype=torch.float64
        )
        fit = problem.fit(problem.training, problem.training.power)
        values = problem.values(fit.log_scale)
        determined = combinations(values, vehicle.frontal_area, RegenForm.RECOVERY)
        held = chosen_rows(log, problem.split.validation)
        score = power_score(least_squares_power(problem)[0], held.power, problem.scale)
        rows.append(
            f"| {form.value} | {score.rmse_w:.0f} | {score.r2:.4f} | "
            f"{determined['mass_over_eta']:.0f} | {values.mu:.3f} | {values.c_rr:.4f} |"
        )
    return rows


def main(path: str, vehicle_name: str, epochs: str = "1000") -> None:
    """Print both tables."""
    limit_blas_threads()
    vehicle = load_vehicle(vehicle_name)
    log = read_drive_log(Path(path), vehicle).drive
    print("| least squares | RMSE, W | R\u00b2 | m/eta | mu | C_rr |\n|---|---|---|---|---|---|")
    print("\n".join(fit_rows(log, vehicle)))
    print(f"\n| choice, {epochs} epochs of Adam | total | data | R\u00b2 | m/eta | mu | C_rr |")
    print("|---|---|---|---|---|---|---|")
    for title, choice in CHOICES.items():
        print(row(title, choice(log, vehicle, int(epochs))), flush=True)
    for rate in (3e-4, 3e-3):
        network.NETWORK_RATE = rate
        print(row(f"learning rate {rate:g}", published(log, vehicle, int(epochs))), flush=True)
    network.NETWORK_RATE = 1e-3
    problem.PHYSICS_LOSS = 1.0  # `Problem.terms` looks it up there
    print(row("lambda = 1", published(log, vehicle, int(epochs))), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
