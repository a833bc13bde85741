"""The distance to the nearest pose that truly shows the view."""

import math

import pytest
import torch

from racines_data.geometry import Pose, axis_angle_to_matrix, geodesic, matmul3
from racines_envs.task.starts import nearest_showing
from racines_envs.worlds.making import make_core

UNITS = (0.003, 0.06)


def test_it_is_the_way_to_the_border_of_the_view(phantom):
    """The stand-in shows a view within sqrt(1.5) cm, or sqrt(1.5) times 0.4 rad, of its pose."""
    target = phantom.target("SC")
    for metres in (0.02, 0.03):
        away = Pose(target.position + torch.tensor([0.0, -metres, 0.0]), target.rotation)
        near = nearest_showing(phantom, away, target, 1, UNITS)
        error = (near.position - away.position).norm().item()
        assert 0 <= error - (metres - 0.01 * math.sqrt(1.5)) <= metres / 32 + 1e-6
        assert phantom.judge(near).view.item() == 1
    turn = axis_angle_to_matrix(torch.tensor([[0.0, 0.0, 0.9]]))
    away = Pose(target.position, matmul3(target.rotation, turn))
    near = nearest_showing(phantom, away, target, 1, UNITS)
    error = geodesic(near.rotation, away.rotation).item()
    assert 0 <= error - (0.9 - 0.4 * math.sqrt(1.5)) <= 0.04
    assert torch.equal(near.position, away.position)  # the shift was not needed


def test_info_has_it_for_every_row_and_it_is_nothing_where_the_view_is_shown(phantom):
    core = make_core("SC", 9, observation="params", reward="oracle", phantom=phantom)
    core.reset(seed=0)
    info = core.info()
    assert bool((info["view_position_error"] <= info["position_error"] + 1e-6).all())
    assert bool((info["view_position_error"] + info["view_rotation_error"] > 0).all())
    some = core.view_error(torch.tensor([7, 2]))
    assert torch.equal(some[0], info["view_position_error"][[7, 2]])
    assert "view_position_error" not in core.info(view_error=False)
    core.reset(pose=Pose(*(x.expand(9, *x.shape[1:]) for x in core.target)))
    info = core.info()
    assert info["view_position_error"].abs().max() == info["view_rotation_error"].abs().max() == 0


@pytest.mark.parametrize("view", ["A4C", "PSMV"])
def test_on_the_phantom_every_pose_found_shows_the_view(real_phantom, view):
    core = make_core(view, 30, observation="params", reward="oracle", phantom=real_phantom)
    core.reset(seed=0)
    near = nearest_showing(real_phantom, core.state.pose, core.target, core.task.target, UNITS)
    assert bool((real_phantom.judge(near).view == core.task.target).all())
    metres, radians = core.view_error()
    nominal = core.pose_error()
    assert bool((metres <= nominal[0] + 1e-6).all()) and bool((radians <= nominal[1] + 1e-3).all())
    assert metres.mean() < 0.8 * nominal[0].mean()
