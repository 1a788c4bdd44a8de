"""The network that corrects the physics on the window, in numpy.

It has a few hundred weights, whose derivatives are written down below. So a car does without
torch, which takes longer to load than all else together.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
import math

import numpy as np


class WindowNetwork:
    """Fully connected layers with tanh between them; never changed, so that threads may share it.

    Attributes:
        weights: all of them, shape (w,): of each layer the matrix, row by row, then the biases.
    """

    def __init__(self, widths: Sequence[int], weights: Sequence[float] | np.ndarray) -> None:
        """Take the weights of layers that are so wide.

        Raises:
            ValueError: they are of another shape.
        """
        self._widths = tuple(widths)
        self.weights = np.array(weights, dtype=float)
        if self.weights.shape != (sum(a * b + b for a, b in pairwise(widths)),):
            raise ValueError("weights of another shape")
        self._layers: list[tuple[np.ndarray, np.ndarray]] = []
        begin = 0
        for inputs, outputs in pairwise(widths):
            end = begin + inputs * outputs
            matrix = self.weights[begin:end].reshape(outputs, inputs)
            begin = end + outputs
            self._layers.append((matrix, self.weights[end:begin]))

    @classmethod
    def silent(cls, widths: Sequence[int], seed: int) -> WindowNetwork:
        """Weights by Glorot's rule, but for those of the last layer: it says zero everywhere."""
        source = np.random.default_rng(seed)
        parts: list[np.ndarray] = []
        for inputs, outputs in pairwise(widths):
            std = math.sqrt(2.0 / (inputs + outputs))
            parts += [std * source.standard_normal(inputs * outputs), np.zeros(outputs)]
        parts[-2][:] = 0.0
        return cls(widths, np.concatenate(parts))

    def with_weights(self, weights: np.ndarray) -> WindowNetwork:
        """The same layers with other weights, shape (w,)."""
        return WindowNetwork(self._widths, weights)

    def at(self, inputs: np.ndarray) -> float:
        """Output at one input of shape (widths[0],)."""
        hidden = inputs
        for matrix, bias in self._layers[:-1]:
            hidden = np.tanh(matrix @ hidden + bias)
        matrix, bias = self._layers[-1]
        return float(matrix[0] @ hidden) + float(bias[0])

    def jacobian(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Output, shape (n,), and its derivative by every weight, shape (n, w).

        Forwards and backwards once for all samples, inputs of shape (n, widths[0]): with A_l the
        activations that enter a layer and D_l the derivative of the output by what leaves it,
        dy/dW_l = D_l A_l^T and dy/db_l = D_l.
        """
        entering = [inputs]
        for matrix, bias in self._layers[:-1]:
            entering.append(np.tanh(entering[-1] @ matrix.T + bias))
        matrix, bias = self._layers[-1]
        output = entering[-1] @ matrix[0] + bias[0]
        derivative = np.ones((len(inputs), 1))
        columns: list[np.ndarray] = []
        for (matrix, _), activation in zip(self._layers[::-1], entering[::-1], strict=True):
            by_matrix = derivative[:, :, None] * activation[:, None, :]
            columns = [by_matrix.reshape(len(inputs), -1), derivative, *columns]
            derivative = (derivative @ matrix) * (1.0 - activation**2)
        return output, np.concatenate(columns, axis=1)
