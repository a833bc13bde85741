"""Feeling out, step by step, where a view is best: a pattern search by what images are worth.

    best pose --- a step ---> another pose, looked at --- better? it is the best from now on
        ^                                            |
        +------------------ back --------------------+  worse

After Hooke and Jeeves, "Direct Search" Solution of Numerical and Statistical Problems (1961).
"""

import torch
from torch import Tensor

from racines_envs.task.actions import IDLE

ORDER = (6, 7, 2, 3, 10, 11, 8, 9, 0, 1, 4, 5)
"""Actions as they are tried: first those that leave the plane, by which most views are lost."""
LOOKS = 2
"""Images that a pose is judged by before it is accepted or left."""


class Search:
    """Where N rows are in their searches."""

    def __init__(self, count: int, device: torch.device, margin: float) -> None:
        """Begin none.

        Args:
            count: rows.
            device: where what is asked lies.
            margin: by how much another pose has to be worth more than the best.
        """
        self._order = torch.tensor(ORDER, device=device)
        self._margin = margin
        self.searching = torch.zeros(count, dtype=torch.bool, device=device)
        self._out = torch.zeros_like(self.searching)  # at a pose that is tried
        zeros = torch.zeros(count, device=device)
        self._best, self._best_looks = zeros, zeros.clone()
        self._tried, self._looks = zeros.clone(), zeros.clone()
        self._next = torch.zeros(count, dtype=torch.int64, device=device)
        self._failed = torch.zeros_like(self._next)

    @property
    def through(self) -> Tensor:
        """(N,) bool: all steps from the best pose were tried in vain."""
        return self.searching & ~self._out & (self._failed >= len(ORDER))

    @property
    def best(self) -> Tensor:
        """(N,) what the best pose is worth."""
        return self._best

    def forget(self, rows: Tensor) -> None:
        """Drop the searches of (N,) bool rows: their episodes are over."""
        for each in vars(self).values():
            if isinstance(each, Tensor) and each is not self._order:
                each.masked_fill_(rows, 0)

    def act(self, worth: Tensor, moved: Tensor, begin: Tensor) -> Tensor:
        """Return the (N,) next actions of searching rows, idle where no step is worth more.

        Args:
            worth: (N,) of the images that are seen now.
            moved: (N,) bool, whether the last action changed the pose, or was idle.
            begin: (N,) bool, rows that begin to search, from where they are.
        """
        self.searching = self.searching | begin
        refused = self._out & ~moved & (self._looks == 0)
        out = self._out & ~refused
        # Means over the looks at the best pose, and at the one that is tried.
        self._looks = torch.where(out, self._looks + 1, 0.0)
        self._tried = self._tried + (worth - self._tried) / self._looks.clamp_min(1.0)
        self._best_looks = torch.where(out, self._best_looks, self._best_looks + 1)
        gained = (worth - self._best) / self._best_looks.clamp_min(1.0)
        self._best = torch.where(out, self._best, self._best + gained)
        ready = out & (self._looks >= LOOKS)
        better = ready & (self._tried > self._best + self._margin)
        worse = ready & ~better
        self._best = torch.where(better, self._tried, self._best)
        self._best_looks = torch.where(better, self._looks, self._best_looks)
        back = self._order[self._next] ^ 1
        vain = worse | refused
        # At a better pose one direction is known to be worse: the way back.
        self._failed = torch.where(better, 1, self._failed + vain.long())
        self._next = torch.where(vain, (self._next + 1) % len(ORDER), self._next)
        known = ~out & (self._best_looks >= LOOKS) | better
        go = known & (self._failed < len(ORDER))
        action = torch.where(go, self._order[self._next], torch.full_like(self._next, IDLE))
        action = torch.where(worse, back, action)
        self._looks = torch.where(go | worse, 0.0, self._looks)
        self._out = (out & ~ready) | go
        return torch.where(self.searching, action, IDLE)
