import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.scores.metrics import Neighbourhoods, distances


def cloud(n: int, seed: int, shift: float = 0.0) -> torch.Tensor:
    return torch.randn(n, 3, generator=torch.Generator().manual_seed(seed)) + shift


def by_hand(truth: np.ndarray, drawn: np.ndarray, k: int) -> dict[str, float]:
    """The four definitions, one pair at a time."""

    def radii(x: np.ndarray) -> list[float]:
        return [
            sorted(float(np.linalg.norm(a - b)) for j, b in enumerate(x) if j != i)[k - 1]
            for i, a in enumerate(x)
        ]

    true_radius, drawn_radius = radii(truth), radii(drawn)
    gap = [[float(np.linalg.norm(t - d)) for d in drawn] for t in truth]
    n = len(truth)
    hits = [[gap[i][j] <= true_radius[i] for j in range(n)] for i in range(n)]
    return {
        "precision": np.mean([any(hits[i][j] for i in range(n)) for j in range(n)]),
        "recall": np.mean([any(gap[i][j] <= drawn_radius[j] for j in range(n)) for i in range(n)]),
        "density": np.sum(hits) / (k * n),
        "coverage": np.mean([any(hits[i]) for i in range(n)]),
    }


@pytest.mark.parametrize("shift", [0.0, 0.7, 2.0])
def test_figures_are_those_of_the_definitions(shift):
    truth, drawn = cloud(40, 1), cloud(40, 2, shift)
    expected = by_hand(truth.double().numpy(), drawn.double().numpy(), 4)
    assert Neighbourhoods(truth, drawn, 4).figures() == pytest.approx(expected)


def test_a_subset_is_scored_as_if_it_were_all():
    truth, drawn = cloud(50, 1), cloud(50, 2, 0.5)
    keep = np.arange(50) % 3 != 0
    rows = torch.from_numpy(keep)
    alone = Neighbourhoods(truth[rows], drawn[rows]).figures()
    assert Neighbourhoods(truth, drawn).figures(keep) == pytest.approx(alone)


def test_the_extremes_mean_what_they_say():
    truth = cloud(200, 1)
    same = Neighbourhoods(truth, truth.clone()).figures()
    assert same["precision"] == same["recall"] == same["coverage"] == 1.0
    far = Neighbourhoods(truth, cloud(200, 2, 50.0)).figures()
    assert set(far.values()) == {0.0}
    # One good image, repeated: precise, dense if it lies in a crowd, and covering next to nothing.
    place = truth[[int(truth.norm(dim=1).argmin())]]
    collapsed = Neighbourhoods(truth, place.expand(200, 3) + 1e-4 * cloud(200, 3)).figures()
    assert collapsed["precision"] == 1.0 and collapsed["density"] >= 1.0
    assert collapsed["recall"] < 0.05 and collapsed["coverage"] < 0.3
    # One far outlier among the drawn fools recall's balls, not coverage.
    drawn = cloud(200, 4, 20.0)
    drawn[0] = -300.0
    fooled = Neighbourhoods(truth, drawn).figures()
    assert fooled["recall"] == 1.0 and fooled["coverage"] == 0.0


def test_too_few_or_unequal_sets_are_refused():
    for a, b in ((cloud(5, 1), cloud(5, 2)), (cloud(9, 1), cloud(8, 2))):
        with pytest.raises(RacinesError, match="scores.samples"):
            Neighbourhoods(a, b)


def test_distances_are_exact_in_batches():
    a, b = cloud(600, 1).double(), cloud(30, 2).double()
    expected = (a[:, None] - b).norm(dim=-1)
    assert torch.allclose(distances(a, b).double(), expected, atol=1e-5)
