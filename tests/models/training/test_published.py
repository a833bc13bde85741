"""Published further trainings: taken where they are of the same method, told where they are not."""

import json

import pytest

from racines_models.generators.mean_image import MeanImage
from racines_models.protocol import Run
from racines_models.registry import open_runs, weights_of
from racines_models.training.published import published_seeds

CONFIG = {"width": 4, "training": {"images": 8, "repeats": 1, "log_every": 2}}


def training(folder, seed, /, **changed):
    folder.mkdir(parents=True)
    told = {"name": "vae-gan", "seed": seed, "data": {"recipe_digest": "d"}, "config": CONFIG}
    (folder / "config.json").write_text(json.dumps(told | changed))
    return folder


@pytest.fixture
def first(tmp_path):
    return training(tmp_path / "runs" / "vae-gan", 0)


def seeds(tmp_path, first, board="b"):
    return [each.name for each in published_seeds(board, first, tmp_path / "weights")]


def test_they_follow_the_runs_own(tmp_path, first):
    place = tmp_path / "weights" / "b" / "vae-gan"
    for seed in (1, 2):
        loop = CONFIG["training"] | {"repeats": 3, "log_every": 5}
        training(place / f"seed-{seed}", seed, config=CONFIG | {"training": loop})
    assert seeds(tmp_path, first) == ["seed-1", "seed-2"]
    assert seeds(tmp_path, first, board="other") == seeds(tmp_path, first, board=None) == []
    training(first / "seed-1", 1)
    assert seeds(tmp_path, first) == ["seed-2"], "a run's own stands before a published one"


def test_a_setting_that_came_later_is_as_it_was_before(tmp_path):
    loop = CONFIG["training"] | {"compile": False}
    first = training(tmp_path / "runs" / "vae-gan", 0, config=CONFIG | {"training": loop})
    training(tmp_path / "weights" / "b" / "vae-gan" / "seed-1", 1)
    assert seeds(tmp_path, first) == ["seed-1"]


def test_no_seed_is_left_out(tmp_path, first):
    training(tmp_path / "weights" / "b" / "vae-gan" / "seed-2", 2)
    assert seeds(tmp_path, first) == []


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"seed": 7}, "another seed"),
        ({"data": {"recipe_digest": "e"}}, "another data"),
        ({"name": "cgan"}, "another name"),
        ({"config": CONFIG | {"width": 5}}, "another width"),
        ({"config": CONFIG | {"training": {"images": 9}}}, "another training.images"),
        (
            {"config": CONFIG | {"training": CONFIG["training"] | {"compile": True}}},
            "another training.compile",
        ),
    ],
)
def test_a_training_of_something_else_does_not_count_and_that_is_said(
    tmp_path, first, changed, expected, capsys
):
    training(tmp_path / "weights" / "b" / "vae-gan" / "seed-1", 1, **changed)
    assert seeds(tmp_path, first) == []
    assert f"not counted: {expected} than" in capsys.readouterr().err.replace("\n", " ")


def test_they_are_opened_after_the_first_with_hashes_of_their_own(store, tmp_path):
    first, further = tmp_path / "mean-image", tmp_path / "seed-1"
    for seed, folder in enumerate((first, further)):
        MeanImage().fit(store, Run(folder, seed=seed, progress=False))
    assert len(open_runs("mean-image", first, [further])) == 2
    hashes = weights_of("mean-image", first, [further])
    assert set(hashes) == {"model.safetensors", "seed-1/model.safetensors"}
