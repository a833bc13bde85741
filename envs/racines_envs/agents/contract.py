"""The contract of a policy, clause by clause, as checks that name the clause that is broken.

What each clause means stands in docs/agents.md, under "The contract". A trace has none to keep: it
is what was done, not what decides.
"""

from collections.abc import Callable

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_envs.agents.networks import SEEN
from racines_envs.task.actions import ACTIONS
from racines_models.contract import ContractError, check_rows

CLAUSES = {
    "A1": "action",
    "A2": "repeats",
    "A3": "new process",
    "A4": "own row",
    "A5": "seed",
    "A6": "sight",
}
"""Names of the clauses by number, in the order in which they are checked."""
DRAWS = 8
"""Further seeds with which a policy that draws its actions may show it."""
LEAST = 0.01
"""How far the logits have to follow an input, as a share of how far they differ between rows."""

Seen = dict[str, Tensor]
"""`image` (N, 128, 128) uint8 and/or `params` (N, 9) float32, as the environment shows them."""
Act = Callable[[Seen, Tensor], Tensor]
"""From what N rows see, and (N,) seeds, to (N,) actions."""


def check_policy(
    act: Act,
    logits: Callable[[Seen], Tensor],
    observation: str,
    seen: Seen,
    seeds: Tensor,
    temperature: float,
    twists: bool = False,
) -> Tensor:
    """Check all that one process can tell (clauses A1, A2 and A4 to A6); return the actions.

    Args:
        act: Asked for actions some thirty times.
        logits: (N, 13) scores of the actions.
        observation: What it declares to see: `image`, `params` or `multimodal`.
        seen: Of (N,) rows, more than eight, from different places.
        seeds: (N,) int64.
        temperature: What it declares; above 0 actions are drawn.
        twists: Whether it declares to act by (N, 6) twists, not by one of the thirteen steps.

    Raises:
        ContractError: the clause that is broken.
    """
    keys = SEEN[observation]
    seen = {key: seen[key] for key in keys}
    actions = act(seen, seeds)
    _check_actions(act({key: seen[key][:0] for key in keys}, seeds[:0]), 0, twists)
    _check_actions(actions, len(seeds), twists)
    check_same_actions(actions, act(seen, seeds), "A2")
    _check_own_rows(act, seen, seeds)
    _check_seed(act, seen, seeds, actions, temperature)
    for key in keys:
        _check_seen(act, logits, key, seen, seeds, actions)
    return actions


def check_same_actions(first: Tensor, again: Tensor, clause: str) -> None:
    """Check that actions chosen a second time of the same sight and seeds are the same."""
    if first.shape != again.shape or not torch.equal(first, again):
        where = "in a new process" if clause == "A3" else "a second time"
        found = f"asked {where} of the same sight and seeds, it chooses other actions"
        raise ContractError(clause, f"{found}: draw all chance from the seed", CLAUSES)


def _check_actions(actions: Tensor, count: int, twists: bool) -> None:
    if twists:
        if actions.dtype != torch.float32 or tuple(actions.shape) != (count, 6):
            found = f"{count} rows gave {actions.dtype} {tuple(actions.shape)}"
            raise ContractError("A1", f"{found}: give float32 ({count}, 6)", CLAUSES)
        return
    fits = actions.dtype == torch.int64 and tuple(actions.shape) == (count,)
    if not fits or bool(((actions < 0) | (actions >= len(ACTIONS))).any()):
        came = f"{actions.dtype} {tuple(actions.shape)}"
        wanted = f"int64 ({count},) of 0 to {len(ACTIONS) - 1}"
        raise ContractError("A1", f"{count} rows gave {came}: give {wanted}", CLAUSES)


def _check_own_rows(act: Act, seen: Seen, seeds: Tensor) -> None:
    def of(*columns: Tensor) -> Tensor:
        return act(dict(zip(seen, columns[:-1], strict=True)), columns[-1])

    try:
        check_rows(of, *seen.values(), seeds)
    except RacinesError:
        raise
    except AssertionError as error:
        found = f"an action depends on its batch: {error}"
        remedy = "it may depend on the row's own sight and seed alone"
        raise ContractError("A4", f"{found}; {remedy}", CLAUSES) from error


def _check_seed(act: Act, seen: Seen, seeds: Tensor, actions: Tensor, temperature: float) -> None:
    others = (act(seen, seeds + draw + 1) for draw in range(DRAWS))
    changes = any(not torch.equal(actions, other) for other in others)
    if changes is not (temperature > 0):
        does = "changes actions" if changes else "changes no action"
        found = f"declared temperature {temperature:g}, but the seed {does}"
        remedy = "declare a temperature" if changes else "declare temperature 0"
        raise ContractError("A5", f"{found}: {remedy}", CLAUSES)


def _check_seen(
    act: Act,
    logits: Callable[[Seen], Tensor],
    key: str,
    seen: Seen,
    seeds: Tensor,
    actions: Tensor,
) -> None:
    """Check that what one input shows counts: rows that are shown each other's act differently."""
    other = seen | {key: seen[key].roll(len(seeds) // 2, 0)}
    if not torch.equal(actions, act(other, seeds)):
        return
    own = logits(seen).double()
    moved = (logits(other).double() - own).abs().mean()
    apart = (own.roll(len(seeds) // 2, 0) - own).abs().mean()
    if not float(moved) > LEAST * float(apart):  # true where both are 0
        found = f"declares to see {key}, but acts alike whatever it shows"
        raise ContractError("A6", f"{found}: leave the input out, or let it count", CLAUSES)
