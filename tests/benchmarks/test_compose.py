"""Speed of an episode's picture: driving by hand shows ten a second at least."""

from racines_envs.apis.rendering import compose
from racines_envs.worlds.making import make_core


def test_a_picture_of_an_episode(benchmark) -> None:
    core = make_core("SC", 1, observation="image", reward="oracle")
    core.reset(seed=3)
    picture = benchmark(compose, core)
    assert picture.shape == (540, 960, 3)
    if benchmark.stats is not None:  # none where pytest-xdist switches measuring off
        assert benchmark.stats.stats.median < 0.1
