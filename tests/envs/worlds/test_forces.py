"""Forces fitted on recordings."""

import json
from typing import Any

import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import Pose, parameters_to_pose
from racines_data.store.frames import open_store
from racines_envs.worlds.forces import FittedForces, ForceConfig, fit_forces, force_report, measured
from racines_envs.worlds.making import make_core
from tests.conftest import command

SETTINGS: dict[str, Any] = {"observation": "params", "reward": "oracle"}


@pytest.fixture(scope="module")
def store(tiny_root):
    return open_store(tiny_root)


def poses(count: int) -> torch.Tensor:
    draw = torch.rand(count, 12, generator=torch.Generator().manual_seed(count))
    low = torch.tensor([0.0] * 6 + [0.41, -0.05, 0.04, 2.7, -0.3, -1.0])
    high = torch.tensor([0.0] * 6 + [0.56, 0.06, 0.07, 3.1, 0.3, 1.0])
    return low + draw * (high - low)


def test_a_smooth_force_is_recovered_and_none_beyond_the_recorded_is_told():
    fitted_on, unseen = poses(4000), poses(300)

    def law(parameters):
        rotation, depth = parameters_to_pose(parameters).rotation, 0.065 - parameters[:, 8]
        return torch.stack(
            [depth * 900, depth**2 * 4e4, -2000 * depth, rotation[:, 2, 0], depth * 3, depth * 0]
            , -1)  # fmt: skip

    fitted_on[:, :6] = law(fitted_on)
    forces = FittedForces(fitted_on).to("cpu")
    error = forces.wrench(parameters_to_pose(unseen)) - law(unseen)
    spread = law(unseen).std(0).clamp_min(1e-3)
    assert bool((error.abs().mean(0) < 0.02 * spread + 1e-4).all())
    far = Pose(torch.tensor([[9.0, -9.0, -9.0]]), parameters_to_pose(unseen[:1]).rotation)
    wrench = forces.wrench(far)[0]
    assert bool((wrench >= fitted_on[:, :6].amin(0) - 1e-4).all())
    assert bool((wrench <= fitted_on[:, :6].amax(0) + 1e-4).all())


def test_a_rows_force_ignores_its_batch_and_a_fit_repeats(store):
    forces, again = (fit_forces(store).to("cpu") for _ in range(2))
    pose = parameters_to_pose(store.parameters[:50])
    together = forces.wrench(pose)
    assert torch.equal(together, again.wrench(pose))
    for row in (0, 17, 49):
        alone = forces.wrench(Pose(*(x[row : row + 1] for x in pose)))
        assert torch.equal(alone[0], together[row])


def test_an_environment_feels_the_fitted_forces(store, phantom):
    core = make_core("SC", 4, forces="fitted", data=store.root, phantom=phantom, **SETTINGS)
    core.reset(seed=0)
    expected = fit_forces(store).to("cpu").wrench(core.state.pose)
    assert torch.equal(core.state.wrench, expected)
    assert torch.equal(core.info()["force"], -expected[:, 2])
    contact = make_core("SC", 4, forces="contact", phantom=phantom, **SETTINGS)
    contact.reset(seed=0)
    assert torch.equal(contact.state.wrench, phantom.wrench(contact.state.pose))


def test_forces_of_ones_own_and_wrong_ones(phantom, store):
    class Hand:
        def wrench(self, pose):
            return torch.full((len(pose.position), 6), float("nan"))

    with pytest.raises(RacinesError, match="forces of Hand: row 0 is NaN"):
        make_core("SC", forces=Hand(), phantom=phantom, **SETTINGS).reset(seed=0)
    for forces, word in (
        ("felt", "unknown forces 'felt': choose one of auto, contact, recorded, fitted"),
        ("recorded", "backend 'replay'"),
        (7, "no wrench"),
    ):
        with pytest.raises(RacinesError, match=word):
            make_core("SC", forces=forces, phantom=phantom, **SETTINGS)
    blind = open_store(store.root)
    blind.parameters = blind.parameters.clone()
    blind.parameters[:, 2] = float("nan")
    with pytest.raises(RacinesError, match="has a pose and a force"):
        fit_forces(blind)
    with pytest.raises(RacinesError, match="positive"):
        ForceConfig(degree=0)


def test_the_report_is_of_trajectories_not_fitted_on(store):
    report = force_report(store, split="test")
    assert report["frames"] == {"train": len(measured(store, "train")), "test": 1 * len(
        measured(store, "test")
    )}  # fmt: skip
    errors = report["errors"]
    assert set(errors) == {"fitted", "mean", "contact"}
    truth = measured(store, "test")[:, :6]
    error = fit_forces(store).to("cpu").wrench(parameters_to_pose(measured(store, "test"))) - truth
    told = errors["fitted"]["force_z"]
    assert told["mae"] == pytest.approx(error[:, 2].abs().mean().item())
    assert told["rmse"] == pytest.approx(error[:, 2].square().mean().sqrt().item())
    assert errors["contact"]["force_z"]["rmse"] < errors["mean"]["force_z"]["rmse"]


def test_the_command_prints_the_errors_beside_those_of_the_mean(workplace):
    done = command(workplace, "racines", "study", "forces")
    assert "force_z, N" in done.stdout and "mean RMSE" in done.stdout
    told = command(workplace, "racines", "study", "forces", "--split", "validation", "--json")
    report = json.loads(told.stdout)
    assert report == json.loads((workplace / "envs/runs/scores/forces.json").read_text())
    assert report["split"] == "validation" and "fitted" in report["errors"]
    refused = command(workplace, "racines", "study", "forces", "--split", "train", code=1)
    assert "fitted on it" in refused.stderr
