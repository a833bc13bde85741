"""The study of a memory's further settings and lessons, at its smallest size."""

import json
from dataclasses import replace

import pytest

from racines_data.config import read_params
from racines_data.patients.splits import seeds_of
from racines_envs.agents.memory.learner import MemoryConfig
from racines_envs.evaluation.patients import StartSet
from tests.envs.studies import memory_search as study


def test_the_first_way_is_what_holds_where_nothing_is_said_and_each_other_is_its_own():
    ways = [(way.agent, replace(MemoryConfig(), **way.settings)) for way in study.WAYS.values()]
    assert ways[0][1] == MemoryConfig() and len({str(way) for way in ways}) == len(ways)
    assert len(study.STARTS.patients) == study.JUDGED.patients


def test_a_way_taught_by_more_has_the_settings_it_is_published_with():
    profile = read_params(profile="reference")["patient_agents"]
    way, plus = study.WAYS["`servo-memory-plus`"], profile["servo-memory-plus"]
    assert {key: plus[key] for key in way.settings} == way.settings
    full = profile["servo-memory-full"]
    assert plus["patients"] == 2 * full["patients"]
    assert plus["round_patients"] == 2 * full["round_patients"]


def test_the_published_table_has_a_row_a_way():
    told = json.loads(study.RESULT.read_text(encoding="utf-8"))
    assert [row[0] for row in told["tables"]["search"]["rows"]] == list(study.WAYS)


def test_its_table_has_a_row_a_way():
    share = {"value": 0.5, "low": 0.4, "high": 0.6, "settings": {"level": 0.91}}
    told = {"steps": 150.0, "trainings": 3, "seconds": 60.0}
    told |= {key: share for key in study.SHARES}
    made = study.figures({way: {view: told for view in study.VIEWS} for way in study.WAYS})
    assert made["figures"]["level"] == 91 and made["figures"]["minutes"] == 8
    table = made["tables"]["search"]
    assert [len(row) for row in table["rows"]] == [len(table["columns"])] * len(study.WAYS)
    assert table["rows"][1] == ["`servo-memory-plus`", *["50 % (40 – 60)"] * 4, "150"]


@pytest.mark.thorough
def test_what_was_judged_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "KEPT", tmp_path)
    starts = StartSet((seeds_of("validation")[600],), 1, 0)
    way = study.WAYS["`servo-memory-full`"]
    told = study.point(way, "PL", starts)
    assert told["trainings"] == 3 and told["steps"] > 100
    monkeypatch.setattr(study, "act_on_patients", None)
    assert study.point(way, "PL", starts) == told, "and not judged again"
