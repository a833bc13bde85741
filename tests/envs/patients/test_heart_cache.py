"""A heart that is read back from the disk is the one that was baked: so is all that it shows."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from racines_data.geometry import Pose
from racines_data.patients import bake as bakery
from racines_data.patients.heart import make_heart
from racines_data.patients.patient import Patient
from racines_data.patients.population import draw_patient
from racines_data.patients.volume import HEART_BYTES
from racines_data.world import STEP_SECONDS
from racines_envs.worlds import ward
from racines_envs.worlds.making import make_core
from racines_envs.worlds.ward import make_ward

SEED, EPISODES = 10_008, 5


def shown() -> dict[str, Tensor]:
    """Return starts, pictures, masks and truths of episodes on one patient, nothing remembered."""
    for kept in (ward._pool, make_heart, draw_patient):
        kept.cache_clear()
    pool = make_ward("beating", "validation", [SEED]).pool
    core = make_core("AnyView-beating", EPISODES, observation="image", phantom=ward.Ward(pool))
    found = {f"seen {name}": each.clone() for name, each in core.reset(7).items()}
    core.step(torch.arange(EPISODES))
    found |= {f"told {name}": each for name, each in core.info().items()}
    state = core.state
    found |= {f"state {name}": each for name, each in vars(state).items()}
    phase = pool.phase(state.case, state.began + STEP_SECONDS * state.steps)
    places = pool.targets(state.case, phase)
    each = torch.arange(EPISODES)
    pose = Pose(*(part[each, each] for part in places))
    found |= {"image": pool.render(pose, state.case, phase, each)}
    found |= {"mask": pool.mask(pose, state.case, phase)}
    return found | pool.judge(pose, state.case, phase)._asdict() | places._asdict()


def test_a_heart_from_the_disk_shows_what_it_showed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    first = shown()
    (path,) = bakery.hearts_folder().glob("*.voxels")
    assert path.is_relative_to(tmp_path) and path.stat().st_size == HEART_BYTES

    def refuse(patient: Patient) -> Tensor:
        raise AssertionError(f"{patient.seed} is baked again")

    monkeypatch.setattr(bakery, "bake", refuse)
    second = shown()
    assert first.keys() == second.keys() and len(first["mask"].unique()) > 5
    for name, each in first.items():
        assert each.numpy().tobytes() == second[name].numpy().tobytes(), name
    path.unlink()
    with pytest.raises(AssertionError, match=f"{SEED} is baked again"):
        shown()
