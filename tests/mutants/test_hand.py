"""The list of mutations keeps up with the sources; `make mutants` runs the tests on them."""

import ast
from dataclasses import replace
from pathlib import Path

import pytest

from tests.mutants.__main__ import Results, digest, verdict
from tests.mutants.catalogue import ROOT, Group, Mutant, at_random, by_hand, groups
from tests.mutants.process import module_name

EVERY = groups()


def test_each_number_has_ten_mutations_or_more_and_each_mutation_a_name():
    names = [entry["name"] for group in EVERY for entry in group.mutations]
    assert len(set(names)) == len(names)
    assert {group.name: len(group.mutations) for group in EVERY if len(group.mutations) < 10} == {}


@pytest.mark.parametrize("group", EVERY, ids=lambda group: group.name)
def test_each_mutation_still_applies(group: Group):
    for mutant in by_hand(group):
        ast.parse(mutant.source)
        assert mutant.source != (ROOT / mutant.file).read_text(), mutant.name
    for tests in group.tests.values():
        for test in tests:
            file, *function = test.split("::")
            text = (ROOT / file).read_text()
            assert all(f"def {name.split('[')[0]}(" in text for name in function), test


def test_a_text_that_is_not_there_is_refused():
    entry = {"name": "gone", "file": "Makefile", "old": "nowhere to be found", "new": ""}
    with pytest.raises(ValueError, match="gone: its text stands 0 times in Makefile"):
        list(by_hand(Group("any", {"Makefile": ()}, [entry])))


def test_random_mutants_are_programs_that_differ_and_the_seed_draws_them():
    pytest.importorskip("cosmic_ray")
    group = next(group for group in EVERY if group.name == "rewards")
    drawn = at_random(group, 8, seed=1)
    assert drawn == at_random(group, 8, seed=1) != at_random(group, 8, seed=2)
    assert len({mutant.source for mutant in drawn}) == 8
    for mutant in drawn:
        original = (ROOT / mutant.file).read_text()
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(original))


def test_a_kill_holds_and_a_survivor_is_tried_again_when_its_tests_change(tmp_path):
    path = str(Path(__file__).relative_to(ROOT))
    mutant = Mutant("a", "any", "hand", "Makefile", "text", (path,), "wrong")
    results = Results(tmp_path / "results.json")
    assert results.of(mutant) is None and verdict([mutant], results) == "not run: a"
    results.put(mutant.key, verdict="survived", tests=digest(mutant.tests))
    assert Results(tmp_path / "results.json").of(mutant) == results.of(mutant) is not None
    assert verdict([mutant], results) == "live without a reason: a"
    assert not verdict([replace(mutant, reason="equivalent")], results)
    many = [replace(mutant, reason="not worth it")] * 25
    assert verdict(many, results) == "25 of 25 live, at most 4% may"
    results.put(mutant.key, verdict="survived", tests="those of before")
    assert results.of(mutant) is None
    results.put(mutant.key, verdict="killed", tests="those of before")
    assert results.of(mutant) and results.of(replace(mutant, source="other")) is None


def test_modules_are_named_as_they_are_imported():
    names = [module_name(file) for group in EVERY for file in group.tests]
    assert "racines_data.digest" in names and "racines_envs.agents.ppo" in names
    assert not any(Path(name).suffix == ".py" or name.startswith("models.") for name in names)
