"""The fully connected tanh network of both modes (paper, Fig. 4), as a torch module."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import nn

PAPER_WIDTHS = (2, 128, 128, 128, 128, 1)  # speed and time in, power out (section III.D)


class PowerNetwork(nn.Module):
    """Fully connected layers with tanh between them.

    Inputs of shape (n, widths[0]), output of shape (n,), both normalised by the caller.
    """

    def __init__(self, widths: Sequence[int], *, seed: int, dtype: torch.dtype) -> None:
        """Initialise by Glorot's rule from a seed of its own, so that runs repeat exactly."""
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

    def at(self, inputs: np.ndarray) -> float:
        """Output at one input of shape (widths[0],): as `forward`, in a tenth of its time."""
        hidden = inputs
        for layer in self.layers[:-1]:
            hidden = np.tanh(_array(layer.weight) @ hidden + _array(layer.bias))
        last = self.layers[-1]
        return float(_array(last.weight)[0] @ hidden) + float(_array(last.bias)[0])

    @torch.no_grad()
    def sweep(
        self, inputs: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor], list[torch.Tensor]]:
        """Forwards and backwards once for all samples; inputs of shape (n, widths[0]).

        Returns:
            The output, shape (n,); the activations A_l that enter each layer, shape
            (n, widths[l]); and the derivative D_l of the output by what leaves it, shape
            (n, widths[l + 1]).
        """
        activations = [inputs]
        for layer in self.layers[:-1]:
            activations.append(torch.tanh(layer(activations[-1])))
        output = self.layers[-1](activations[-1])[:, 0]
        derivatives = [inputs.new_ones(len(inputs), 1)]
        for layer, leaving in zip(self.layers[:0:-1], activations[:0:-1], strict=True):
            derivatives.append((derivatives[-1] @ layer.weight) * (1.0 - leaving**2))
        return output, activations, derivatives[::-1]

    def jacobian(self, inputs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Output, shape (n,), and its derivative by every weight, shape (n, weights).

        Back-propagation for all samples at once: dy/dW_l = D_l A_l^T and dy/db_l = D_l. The
        columns are in the order of `torch.nn.utils.parameters_to_vector`.
        """
        output, activations, derivatives = self.sweep(inputs)
        columns: list[torch.Tensor] = []
        for entering, derivative in zip(activations, derivatives, strict=True):
            by_weight = derivative[:, :, None] * entering[:, None, :]
            columns += [by_weight.flatten(1), derivative]
        return output, torch.cat(columns, dim=1)

    def vector(self) -> torch.Tensor:
        """All weights as one vector, detached."""
        return nn.utils.parameters_to_vector(self.parameters()).detach().clone()

    def load_vector(self, weights: torch.Tensor) -> None:
        """Take all weights from one vector."""
        nn.utils.vector_to_parameters(weights, self.parameters())


def _array(tensor: torch.Tensor) -> np.ndarray:
    """The memory of a tensor as an array."""
    array: np.ndarray = tensor.detach().numpy()
    return array
