"""The ablation of a policy on the servo's belief, at its smallest size."""

from dataclasses import replace

import pytest

from racines_data.patients.splits import seeds_of
from racines_envs.evaluation.patients import StartSet
from tests.envs.studies import belief_ablation as study


def test_every_way_is_a_setting_and_nobody_is_chosen_and_judged_on():
    for _, changes in study.WAYS.values():
        replace(study.BASE, **changes)
    chosen = seeds_of("validation")[: max(1, study.BASE.patients // 2)]
    assert not set(chosen) & set(study.STARTS.patients)


@pytest.mark.thorough
def test_what_is_trained_and_judged_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "KEPT", tmp_path)
    monkeypatch.setattr(study, "TRAININGS", 2)
    few = replace(study.BASE, patients=2, frames=8, envs=2, update_every=4, minibatch=4, epochs=1,
                  imitate=0, validate_every=4, validation_starts=1)  # fmt: skip
    starts = StartSet((seeds_of("validation")[100],), 1, 0)
    way = "alone"
    told = study.point(way, few, starts)
    assert len([*tmp_path.glob(f"*/{study.METRICS}")]) == 2
    monkeypatch.setattr(study, "act_on_patients", None)
    assert study.point(way, few, starts) == told, "and not judged again"
    ((shown, *cells),) = study.figures({way: told})["tables"]["ablation"]["rows"]
    assert shown == study.WAYS[way][0] and len(cells) == 3
