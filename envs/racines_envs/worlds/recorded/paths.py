"""What can be reached: the recorded frames as a graph, and ways through it to where they hit.

Frames are thinned along their trajectories to nodes; two nodes are linked where a probe can pass
from one to the other and stays within reach of what was recorded. Lengths of ways follow Dijkstra
(Numerische Mathematik 1, 1959).
"""

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from torch import Tensor

from racines_envs.worlds.recorded.index import Nearest

THINNED = 0.25
"""Distance between successive nodes, of that within which nodes are linked."""
SEEN, AHEAD = 24, 24
"""Nodes about a pose among which the shortest way begins, and nodes that are looked ahead."""
GAP = 0.95
"""The share of gaps between successive frames that the usual reach passes over."""


def gaps(keys: Tensor, trajectory: Tensor) -> Tensor:
    """Return the (M,) distance of each frame's (M, K) key from the one before.

    Infinite where another of the (M,) trajectories begins.
    """
    step = torch.zeros(len(keys))
    step[1:] = (keys[1:] - keys[:-1]).norm(dim=-1).cpu()
    begins = torch.ones(len(keys), dtype=torch.bool)
    begins[1:] = (trajectory[1:] != trajectory[:-1]).cpu()
    return torch.where(begins, torch.inf, step)


def usual_reach(keys: Tensor, trajectory: Tensor, step: float) -> float:
    """Return how far from every recorded pose a probe may be, m, where it is not said.

    The longest unit `step`, so that one can be taken off the recorded way, and half the gap between
    successive frames, so that the middle between them is within. Of frames that are all alone in
    their trajectories, the gap to the nearest other.
    """
    known = gaps(keys, trajectory)
    known = known[torch.isfinite(known) & (known > 0)]
    if not len(known):
        tree = KDTree(np.unique(keys.cpu().numpy(), axis=0))
        if tree.n == 1:
            return step
        known = torch.from_numpy(tree.query(tree.data, k=2)[0][:, 1])
    return step + 0.5 * float(known.float().quantile(GAP))


class Ways:
    """The graph of M frames, and the shortest way from each to some of them."""

    def __init__(self, keys: Tensor, trajectory: Tensor, link: float, cost: Tensor) -> None:
        """Link the frames of (M, K) keys and (M,) trajectories that lie within `link`, m.

        Ways lead to the frames whose (M,) `cost` is finite; it is added to their length.
        """
        gap = gaps(keys, trajectory).numpy()
        begins = ~(gap <= link)
        along = np.cumsum(np.where(begins, 0.0, gap))
        cell = np.floor(along / (THINNED * link))
        ends = np.isfinite(cost.cpu().numpy())
        kept = begins | (np.diff(cell, prepend=-1.0) != 0) | ends
        node, frames = np.cumsum(kept) - 1, np.flatnonzero(kept)
        nodes = keys.cpu().numpy()[frames]
        pairs = KDTree(nodes).query_pairs(link, output_type="ndarray")
        later = np.flatnonzero(~begins[frames])  # their trajectory goes on from the node before
        pairs = np.concatenate([pairs, np.stack([later - 1, later], 1)])
        pairs = np.unique(np.sort(pairs, 1), axis=0)
        away = np.linalg.norm(nodes[pairs[:, 0]] - nodes[pairs[:, 1]], axis=1)
        # All ways end in one more node, to which those that they may lead to are linked.
        count = len(nodes)
        last = np.flatnonzero(ends[frames])
        to_end = np.stack([last, np.full_like(last, count)], 1)
        pairs = np.concatenate([pairs, to_end])
        lengths = np.concatenate([away, cost.cpu().numpy()[frames[last]]])
        # A link of length 0, as between nodes at one pose, would be taken for none.
        graph = coo_matrix((np.maximum(lengths, 1e-9), pairs.T), (count + 1, count + 1)).tocsr()
        found, after = dijkstra(graph, directed=False, indices=count, return_predecessors=True)
        self.joined = torch.from_numpy(np.isfinite(found)[node]).to(keys.device)
        """(M,) bool: a way leads on from the frame."""
        on = np.where((after[:-1] < 0) | (after[:-1] == count), np.arange(count), after[:-1])
        self._near = Nearest(torch.from_numpy(nodes), keys.device)
        self._frames, self._after, self._lengths = (
            torch.from_numpy(x).to(keys.device)
            for x in (frames, on.astype(np.int64), found[:-1].astype(np.float32))
        )

    def ahead(self, keys: Tensor, look: float, there: float) -> Tensor:
        """Return the (B,) frame to go to from (B, K) keys: `look`, m, ahead on the shortest way.

        The way begins at one of the `SEEN` nearest nodes that lie no farther than `look`, or at the
        nearest; within `there`, m, a node is passed.
        """
        node, _ = self._first(keys, look)
        for _ in range(AHEAD):
            further = self._after[node]
            near = (self._near.keys[further] - keys).norm(dim=-1) <= look
            passed = (self._near.keys[node] - keys).norm(dim=-1) <= there
            node = torch.where(near | passed, further, node)
        return self._frames[node]

    def lengths(self, keys: Tensor, look: float) -> Tensor:
        """Return the (B,) length, m, of the shortest ways from (B, K) keys; see `ahead`.

        Infinite where none is known.
        """
        return self._first(keys, look)[1]

    def _first(self, keys: Tensor, look: float) -> tuple[Tensor, Tensor]:
        """Return the (B,) nodes at which the shortest ways begin, and the ways' lengths."""
        index, away = self._near.several(keys, min(SEEN, len(self._frames)))
        seen = (away <= look) & self._lengths[index].isfinite()
        seen[:, 0] |= ~seen.any(1)
        length = torch.where(seen, away + self._lengths[index], torch.inf)
        place = length.argmin(1, keepdim=True)
        return index.gather(1, place).squeeze(1), length.gather(1, place).squeeze(1)
