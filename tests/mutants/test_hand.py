"""The list of mutations keeps up with the sources; `make mutants` runs the tests on them."""

import ast
from pathlib import Path

import pytest

from tests.mutants.catalogue import ROOT, Group, at_random, by_hand, groups
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


def test_modules_are_named_as_they_are_imported():
    names = [module_name(file) for group in EVERY for file in group.tests]
    assert "racines_data.digest" in names and "racines_envs.agents.ppo" in names
    assert not any(Path(name).suffix == ".py" or name.startswith("models.") for name in names)
