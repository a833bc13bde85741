"""The study of a memory's further settings, at its smallest size."""

from dataclasses import asdict, replace

import pytest

from racines_data.patients.splits import seeds_of
from racines_envs.agents.memory.learner import MemoryConfig
from racines_envs.evaluation.patients import StartSet
from tests.envs.studies import memory_search as study


def test_ways_are_settings_and_the_first_is_what_holds_where_nothing_is_said():
    first, *others = (asdict(replace(MemoryConfig(), **way)) for way in study.WAYS.values())
    assert first == asdict(MemoryConfig()) and all(other != first for other in others)
    assert len(study.STARTS.patients) == study.JUDGED.patients


def test_its_table_has_a_row_a_way():
    share = {"value": 0.5, "low": 0.4, "high": 0.6, "settings": {"level": 0.91}}
    told = {"steps": 150.0, "trainings": 3, "seconds": 60.0}
    told |= {key: share for key in study.SHARES}
    made = study.figures({way: {view: told for view in study.VIEWS} for way in study.WAYS})
    assert made["figures"]["level"] == 91 and made["figures"]["minutes"] == 8
    table = made["tables"]["search"]
    assert [len(row) for row in table["rows"]] == [len(table["columns"])] * len(study.WAYS)
    assert table["rows"][1] == ["`bounded`", *["50 % (40 – 60)"] * 4, "150"]


@pytest.mark.thorough
def test_what_was_judged_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "KEPT", tmp_path)
    starts = StartSet((seeds_of("validation")[600],), 1, 0)
    told = study.point("both", "PL", starts)
    assert told["trainings"] == 3 and told["steps"] > 100
    monkeypatch.setattr(study, "act_on_patients", None)
    assert study.point("both", "PL", starts) == told, "and not judged again"
