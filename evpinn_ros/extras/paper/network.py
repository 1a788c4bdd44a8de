"""The fully connected tanh network of the paper (Fig. 4) and its Adam (section III.D)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import nn

PAPER_WIDTHS = (2, 128, 128, 128, 128, 1)  # speed and time in, power out
PHYSICS_LOSS = 0.1  # lambda of eq. 22
NETWORK_RATE = 1e-3  # Adam
PARAMETER_RATE = 2e-3  # Adam, of log values


class PowerNetwork(nn.Module):
    """Layers with tanh between them: normalised inputs (n, widths[0]), outputs (n,)."""

    def __init__(self, widths: Sequence[int], *, seed: int, dtype: torch.dtype) -> None:
        """Initialise by Glorot's rule from a seed, so that runs repeat exactly."""
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.layers = [
            nn.Linear(inputs, outputs, dtype=dtype) for inputs, outputs in pairwise(widths)
        ]
        for index, layer in enumerate(self.layers):
            self.add_module(f"layer_{index}", layer)
            nn.init.xavier_normal_(layer.weight, generator=generator)
            nn.init.zeros_(layer.bias)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return the output, shape (n,)."""
        hidden = inputs
        for layer in self.layers[:-1]:
            hidden = torch.tanh(layer(hidden))
        output: torch.Tensor = self.layers[-1](hidden)
        return output[:, 0]

    @torch.no_grad()
    def sweep(
        self, inputs: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor], list[torch.Tensor]]:
        """Output, input activations A_l of each layer, and derivatives D_l by its outputs."""
        activations = [inputs]
        for layer in self.layers[:-1]:
            activations.append(torch.tanh(layer(activations[-1])))
        output = self.layers[-1](activations[-1])[:, 0]
        derivatives = [inputs.new_ones(len(inputs), 1)]
        for layer, leaving in zip(self.layers[:0:-1], activations[:0:-1], strict=True):
            derivatives.append((derivatives[-1] @ layer.weight) * (1.0 - leaving**2))
        return output, activations, derivatives[::-1]

    def vector(self) -> torch.Tensor:
        """All weights as one vector, detached."""
        return nn.utils.parameters_to_vector(self.parameters()).detach().clone()

    def load_vector(self, weights: torch.Tensor) -> None:
        """Take all weights from one vector."""
        nn.utils.vector_to_parameters(weights, self.parameters())


def paper_adam(network: PowerNetwork, log_scale: torch.Tensor) -> torch.optim.Adam:
    """Adam as published: one rate for the layers, one for z of the parameters, shape (5,)."""
    return torch.optim.Adam(
        [
            {"params": list(network.parameters()), "lr": NETWORK_RATE},
            {"params": [log_scale], "lr": PARAMETER_RATE},
        ]
    )


@torch.no_grad()
def spread_over_time(
    network: PowerNetwork, generator: torch.Generator, first: float, last: float, sharpness: float
) -> None:
    """Spread the kinks of the first layer's units evenly between two times, in place.

    Time is the second input; `sharpness` is the distance of two kinks over the width of one.
    """
    layer = network.layers[0]
    units = len(layer.bias)
    slope = sharpness * units / (last - first)
    signs = torch.randint(0, 2, (units,), generator=generator) * 2.0 - 1.0
    layer.weight[:, 1] = (signs * slope).to(layer.weight)
    layer.bias.copy_(-signs * slope * torch.linspace(first, last, units))
