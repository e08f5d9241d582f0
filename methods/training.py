"""What every network here is trained with: one loop, one way to seed, one way to store weights."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn


def seeded(seed: int) -> tuple[np.random.Generator, torch.Generator]:
    """Random streams of one fit; torch's global stream, which initialises layers, is set too."""
    torch.manual_seed(seed)
    return np.random.default_rng(seed), torch.Generator().manual_seed(seed)


def adamw(
    model: nn.Module,
    loss: Callable[[int], Tensor],
    iterations: int,
    learning_rate: float = 2e-3,
    weight_decay: float = 1e-5,
) -> list[float]:
    """AdamW with a short warm-up and a cosine to a hundredth of the rate; ``loss(i)`` draws its batch.

    Returns the losses of every tenth iteration.

    Raises:
        FloatingPointError: the loss is not finite.
    """
    optimiser = torch.optim.AdamW(model.parameters(), lr=learning_rate, weight_decay=weight_decay)
    warm = max(1, min(200, iterations // 10))

    def rate(i: int) -> float:
        if i < warm:
            return (i + 1) / warm
        return 0.01 + 0.99 * 0.5 * (1.0 + np.cos(np.pi * (i - warm) / max(1, iterations - warm)))

    schedule = torch.optim.lr_scheduler.LambdaLR(optimiser, rate)
    losses = []
    for i in range(iterations):
        optimiser.zero_grad(set_to_none=True)
        value = loss(i)
        value.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        if i % 10 == 0:
            losses.append(float(value.detach()))
            if not np.isfinite(losses[-1]):
                raise FloatingPointError(f"training loss is {losses[-1]} at iteration {i}")
    return losses


def weights_of(model: nn.Module, prefix: str = "net.") -> dict[str, np.ndarray]:
    """A network's weights as arrays, for ``Estimator.arrays``."""
    return {prefix + name: value.detach().numpy().copy() for name, value in model.state_dict().items()}


def load_weights(model: nn.Module, arrays: dict[str, np.ndarray], prefix: str = "net.") -> None:
    """The inverse of ``weights_of``.

    Args:
        model: that gets them.
        arrays: by name, weights of any shape, dimensionless; what does not start with ``prefix`` is left out.
        prefix: of the names.
    """
    state = {n.removeprefix(prefix): torch.from_numpy(a.copy()) for n, a in arrays.items() if n.startswith(prefix)}
    model.load_state_dict(state)
