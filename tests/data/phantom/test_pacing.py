"""Sweeps within an arm's limits: time goes to moves that need it, and bytes of others stay."""

from dataclasses import replace

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose
from racines_data.phantom.acquisition import AcquisitionConfig
from racines_data.phantom.pacing import MARGIN, CannotFollow, check_followed, paced
from racines_data.sources.phantom import PhantomSource

LENGTH = 41


def rail(pose: Pose) -> torch.Tensor:
    """Ask an arm whose only joint is x, at most 1 m/s, at 10 frames a second; not below 0."""
    x = pose.position[:, 0]
    there = x >= 0.0
    return (x.diff().abs() * 10.0).where(there[1:] & there[:-1], torch.inf)


def along(*places: float):
    """Return a function from shares to poses that go straight from place to place."""

    def poses(shares: torch.Tensor) -> Pose:
        ends = torch.cat([shares.new_zeros(1), (shares / shares.sum()).cumsum(0)])
        time = torch.linspace(0.0, 1.0, LENGTH)
        leg = torch.searchsorted(ends, time, right=True).sub(1).clamp(0, len(shares) - 1)
        phase = ((time - ends[leg]) / (ends[leg + 1] - ends[leg])).clamp(0.0, 1.0)
        at = torch.tensor(places)
        x = torch.lerp(at[leg], at[leg + 1], phase)
        position = torch.stack([x, torch.zeros_like(x), torch.zeros_like(x)], 1)
        return Pose(position, torch.eye(3).expand(LENGTH, 3, 3))

    return poses


def test_moves_get_the_time_that_they_need():
    # 4 s: 1 m, then 0.1 m, by a hand that gives both the same time.
    shares, path = torch.tensor([0.5, 0.5]), along(0.0, 1.0, 1.1)
    assert paced(shares, rail, LENGTH, path).tolist() == [0.5, 0.5]
    hasty = torch.tensor([0.1, 0.9])
    assert float(rail(path(hasty)).max()) > 1.0
    found = paced(hasty, rail, LENGTH, path)
    assert float(found.sum()) == pytest.approx(1.0)
    # 1 m at 0.8 m/s of 4 s, and no more than it needs.
    assert float(found[0]) == pytest.approx(1.0 / MARGIN / 4.0, rel=0.03)
    check_followed(path(found), rail)


def test_a_sweep_that_is_too_short_or_out_of_reach_is_refused():
    shares = torch.tensor([0.5, 0.5])
    with pytest.raises(CannotFollow, match=r"a sweep of 41 frames takes the arm \d\d$"):
        paced(shares, rail, LENGTH, along(0.0, 2.0, 0.0))
    with pytest.raises(CannotFollow, match="leads where the arm cannot be"):
        paced(shares, rail, LENGTH, along(0.0, -0.1, 0.0))
    with pytest.raises(CannotFollow, match=r"takes the arm to 2.00 of its speed"):
        check_followed(along(0.0, 8.0)(torch.ones(1)), rail)


def test_the_arm_follows_every_sweep_that_is_drawn_for_it():
    pytest.importorskip("pytorch_kinematics")
    from racines_envs.robots.ur5e import UR5E
    from tests.envs.studies.arm_sweeps import hurries

    config = AcquisitionConfig(frames=500, shortest=90, longest=110, seed=3)
    free, arm = hurries(config), hurries(replace(config, robot=UR5E.name))
    assert float(free.max()) > 1.0 >= float(arm.max())


def test_short_sweeps_say_what_to_change():
    pytest.importorskip("pytorch_kinematics")
    settings = {"frames": 16, "shortest": 16, "longest": 16, "robot": "ur5e"}
    source = PhantomSource.from_config(settings, ())
    with pytest.raises(RacinesError, match="raise data.phantom.shortest"):
        source.produce(source.plan()[0])


def test_a_recipe_names_an_arm_only_where_there_is_one():
    assert "robot" not in PhantomSource(AcquisitionConfig()).recipe()["acquisition"]
    named = PhantomSource(AcquisitionConfig(robot="ur5e")).recipe()["acquisition"]
    assert named["robot"] == "ur5e"
    with pytest.raises(RacinesError, match="robot 'kuka'"):
        PhantomSource.from_config({"robot": "kuka"}, ())
