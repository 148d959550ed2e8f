"""Adam with a learning rate per parameter, for parameters whose rows may be added and removed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

_BETAS, _EPS = (0.9, 0.99), 1e-15


class Adam:
    """The optimiser Adam with bias correction (Kingma and Ba 2015), for named parameters.

    The second decay is 0.99 instead of 0.999, because a run has thousands of steps, not tens of thousands.
    """

    def __init__(self, parameters: dict[str, torch.Tensor]) -> None:
        self.parameters = parameters
        self.steps = 0
        self.moments = {name: [torch.zeros_like(p), torch.zeros_like(p)] for name, p in parameters.items()}

    @torch.no_grad()
    def step(self, rates: Mapping[str, float | torch.Tensor]) -> None:
        """Update every parameter that has a derivative and a learning rate, and clear the derivatives."""
        self.steps += 1
        corrections = [1 - beta**self.steps for beta in _BETAS]
        for name, parameter in self.parameters.items():
            if parameter.grad is None:
                continue
            first, second = self.moments[name]
            first.lerp_(parameter.grad, 1 - _BETAS[0])
            second.mul_(_BETAS[1]).addcmul_(parameter.grad, parameter.grad, value=1 - _BETAS[1])
            denominator = (second / corrections[1]).sqrt_().add_(_EPS)
            change = (first / corrections[0]).div_(denominator)
            parameter.sub_(change * rates.get(name, 0.0))
            parameter.grad = None

    def rebuild(self, name: str, value: torch.Tensor, kept: NDArray[np.int64]) -> None:
        """Replace a parameter.

        Its first rows are the rows `kept` of the old parameter, and the others are new.
        """
        first, second = (torch.zeros_like(value) for _ in range(2))
        for moment, old in zip((first, second), self.moments[name], strict=True):
            moment[: len(kept)] = old[torch.from_numpy(kept)]
        self.moments[name] = [first, second]
        self.parameters[name] = value.detach().clone().requires_grad_()

    def state(self) -> dict[str, Any]:
        """Return everything as arrays."""
        found: dict[str, Any] = {"adam/steps": np.array(self.steps)}
        for name, parameter in self.parameters.items():
            found[f"parameter/{name}"] = parameter.detach().numpy()
            for number, moment in enumerate(self.moments[name]):
                found[f"adam/{number}/{name}"] = moment.numpy()
        return found

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore a value of `state`."""
        self.steps = int(state["adam/steps"])
        for name in self.parameters:
            self.parameters[name] = torch.from_numpy(state[f"parameter/{name}"].copy()).requires_grad_()
            self.moments[name] = [torch.from_numpy(state[f"adam/{k}/{name}"].copy()) for k in (0, 1)]
