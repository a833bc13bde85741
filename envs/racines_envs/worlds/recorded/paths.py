"""What can be reached: the recorded frames as a graph, and ways through it to a goal.

Frames are thinned along their trajectories to nodes; two nodes are linked where a probe can pass
from one to the other and stays within reach of what was recorded. Lengths of ways follow Dijkstra
(A Note on Two Problems in Connexion with Graphs, 1959).
"""

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree
from torch import Tensor

THINNED = 0.25
"""Distance between successive nodes, of that within which nodes are linked."""
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
    """The graph of M frames."""

    def __init__(self, keys: Tensor, trajectory: Tensor, link: float) -> None:
        """Link the frames of (M, K) keys and (M,) trajectories that lie within `link`, m."""
        gap = gaps(keys, trajectory).numpy()
        begins = ~(gap <= link)
        along = np.cumsum(np.where(begins, 0.0, gap))
        cell = np.floor(along / (THINNED * link))
        kept = begins | (np.diff(cell, prepend=-1.0) != 0)
        self.node = np.cumsum(kept) - 1
        """(M,) the node that stands for each frame."""
        self.keys = keys.cpu().numpy()[kept]
        pairs = KDTree(self.keys).query_pairs(link, output_type="ndarray")
        later = np.flatnonzero(~begins[kept])  # nodes whose trajectory goes on from the one before
        pairs = np.concatenate([pairs, np.stack([later - 1, later], 1)])
        pairs = np.unique(np.sort(pairs, 1), axis=0)
        away = np.linalg.norm(self.keys[pairs[:, 0]] - self.keys[pairs[:, 1]], axis=1)
        # A link of length 0, between nodes at one pose, would be taken for none.
        lengths, count = np.maximum(away, 1e-9), len(self.keys)
        self._graph = coo_matrix((lengths, pairs.T), (count, count)).tocsr()

    def lengths(self, goals: np.ndarray) -> np.ndarray:
        """Return the (nodes,) length, m, of the way to the nearest of the (G,) frames' nodes.

        Infinite where none leads there.
        """
        nodes = np.unique(self.node[goals])
        found = dijkstra(self._graph, directed=False, indices=nodes, min_only=True)
        return np.asarray(found)
