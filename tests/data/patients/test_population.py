import json
from collections import Counter
from dataclasses import asdict
from statistics import mean, stdev

import pytest

from racines_data.errors import RacinesError
from racines_data.patients import PATHOLOGIES, SPLITS, check_split, draw_patient, seeds_of, split_of


def test_every_seed_has_one_split() -> None:
    assert [split_of(seed) for seed in (1, 9_999, 10_000, 10_999, 20_000, 20_139)] == [
        "train", "train", "validation", "validation", "test", "test"
    ]  # fmt: skip
    assert split_of(1_000_000) == split_of(2**40) == "secret"
    assert {name: len(seeds) for name, seeds in SPLITS.items()} == {
        "train": 9_999, "validation": 1_000, "test": 140
    }  # fmt: skip
    assert seeds_of("test") == range(20_000, 20_140)


@pytest.mark.parametrize("seed", [0, -1, 11_000, 20_140, 999_999])
def test_a_seed_of_no_split_is_refused(seed: int) -> None:
    with pytest.raises(RacinesError, match=r"no patient's: train 1-9999"):
        split_of(seed)
    with pytest.raises(RacinesError, match="no patient's"):
        draw_patient(seed)


def test_unknown_splits_and_seeds_of_another_are_refused() -> None:
    with pytest.raises(RacinesError, match="unknown split 'tset': choose one of train"):
        seeds_of("tset")
    with pytest.raises(RacinesError, match="has no list"):
        seeds_of("secret")
    with pytest.raises(RacinesError, match="seed 20000 is a patient of test, not of train"):
        check_split([1, 20_000], "train")
    check_split([1_000_000], "secret")


def test_a_patient_is_its_seed_and_json() -> None:
    one = draw_patient(77)
    draw_patient.cache_clear()
    assert draw_patient(77) == one != draw_patient(78)
    assert json.loads(json.dumps(asdict(one)))["seed"] == 77


def test_the_population_is_as_published() -> None:
    """Lang et al., JASE 2015: the healthy lie within 2 SD of the mean of their sex."""
    patients = [draw_patient(seed) for seed in range(1, 1501)]
    kinds = Counter(patient.pathology for patient in patients)
    assert 0.17 < 1.0 - kinds["healthy"] / len(patients) < 0.23
    assert min(kinds[kind] for kind in PATHOLOGIES) > 30
    healthy = [patient for patient in patients if patient.pathology == "healthy"]
    for female, low, high in ((True, 37.8, 52.2), (False, 42.0, 58.4)):
        wide = [p.form.ventricle for p in healthy if p.body.female is female]
        assert low - 0.01 <= min(wide) and max(wide) <= high + 0.01
        assert 2.5 < stdev(wide) < 4.5
    large = [p.form for p in healthy if p.form.ventricle > 50.0]
    small = [p.form for p in healthy if p.form.ventricle < 45.0]
    assert mean(f.length for f in large) > mean(f.length for f in small) + 4.0, "drawn together"
    dilated = [p for p in patients if p.pathology == "dilated"]
    assert mean(p.form.ventricle for p in dilated) > 57.0
    assert max(p.motion.emptying for p in dilated) < 0.5
