"""The checks that look at what rows mean, on rows made for them."""

import dataclasses
import math

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.geometry import matrix_to_euler
from racines_data.phantom.config import PHANTOM_VERSION, BlockConfig, PhantomConfig
from racines_data.phantom.model import Phantom
from racines_data.schema import PARAMETERS
from racines_data.validate.identity import (
    check_exact,
    check_near,
    check_splits,
    find_duplicates,
    nearest_distance,
)
from racines_data.validate.meaning import (
    check_modes,
    check_paper,
    check_rejudged,
    check_views,
    has_paper,
    must_meet_paper,
    rejudge,
    statistics_of,
    verdicts_of,
    view_shares,
)
from racines_data.validate.survey import CheckedSweep, Survey, signatures
from racines_data.views import LABELS, PAPER_STATISTICS, ParameterStatistics


def sweep(name: str, split: str, signature: np.ndarray, **changes) -> CheckedSweep:
    count = len(signature)
    parameters = np.zeros((count, 12), np.float32)
    parameters[:, 6] = 0.0001 * np.arange(count)
    made = CheckedSweep(
        split=split,
        id=name,
        session="s",
        target_view="A4C",
        source="phantom",
        phantom=0,
        digest=name,
        parameters=parameters,
        timestamps=np.arange(count) / 25,
        views=np.zeros(count, np.int64),
        grades=np.full(count, 5, np.float32),
        predicted=np.full((count, 2), np.nan, np.float32),
        hashes=np.random.default_rng(len(name) + ord(name[-1])).integers(2**63, size=count),
        signatures=signature.astype(np.float16),
    )
    return dataclasses.replace(made, **changes)


def pictures(seed: int, noise: float, count: int = 30) -> np.ndarray:
    """(count, 256): one picture, drawn anew with noise each time."""
    picture = np.random.default_rng(seed).uniform(20, 60, 256)
    return picture + noise * np.random.default_rng([seed, 1]).normal(size=(count, 256))


def test_sweeps_over_other_places_are_no_copies():
    survey = Survey(
        "frames", [sweep("a", "train", pictures(1, 1)), sweep("b", "test", pictures(2, 1))]
    )
    found = find_duplicates(survey)
    assert found.near == 0 and found.exact == 0 and found.held_out == 30
    assert found.threshold == pytest.approx(math.sqrt(2), rel=0.05)
    assert found.median == pytest.approx(math.sqrt(40**2 / 6 + 2), rel=0.15)
    assert found.near_frame_split == pytest.approx(1, abs=0.1)
    check_exact(found), check_near(found)


def test_a_sweep_over_the_same_place_is_a_near_copy():
    both = pictures(1, 1, 60)
    survey = Survey("frames", [sweep("a", "train", both[:30]), sweep("b", "validation", both[30:])])
    found = find_duplicates(survey)
    assert found.near is not None and found.near > 0.5
    with pytest.raises(RacinesError, match="nearer to a training frame than two frames at rest"):
        check_near(found)


def test_equal_pixels_are_copies_unless_they_show_nothing():
    train, test = sweep("a", "train", pictures(1, 1)), sweep("b", "test", pictures(2, 1))
    hashes = test.hashes.copy()
    hashes[7] = train.hashes[3]
    survey = Survey("frames", [train, dataclasses.replace(test, hashes=hashes)])
    with pytest.raises(RacinesError, match="1 of 30 held-out frames are copies"):
        check_exact(find_duplicates(survey))
    dark = test.signatures.copy()
    dark[7] = 2.0
    survey.sweeps[1] = dataclasses.replace(test, hashes=hashes, signatures=dark)
    assert "1 frames without tissue left out" in check_exact(find_duplicates(survey))


def test_without_a_probe_at_rest_there_is_no_yardstick():
    moving = np.zeros((30, 12), np.float32)
    moving[:, 6] = 0.01 * np.arange(30)
    pair = [
        sweep(n, s, pictures(1, 1), parameters=moving) for n, s in (("a", "train"), ("b", "test"))
    ]
    found = find_duplicates(Survey("frames", pair))
    assert found.threshold is None and "no probe is at rest" in check_near(found)


def test_nearest_distance_is_that_of_all_pairs():
    generator = torch.Generator().manual_seed(0)
    queries = 100 * torch.rand(1100, 256, generator=generator)
    keys = 100 * torch.rand(700, 256, generator=generator)
    expected = torch.cdist(queries.double(), keys.double()).amin(1) / 16
    assert torch.allclose(nearest_distance(queries, keys).double(), expected, atol=1e-3)


def test_signatures_are_block_means():
    images = np.random.default_rng(0).integers(0, 256, (3, 128, 128)).astype(np.uint8)
    found = signatures(images)
    assert found.shape == (3, 256)
    assert found[2, 17] == pytest.approx(images[2, 8:16, 8:16].mean(), abs=0.1)


def test_a_heart_in_two_splits():
    hearts = [sweep(n, s, pictures(1, 1), phantom=3) for n, s in (("a", "train"), ("b", "test"))]
    with pytest.raises(RacinesError, match="heart 3 is in test and in train"):
        check_splits(Survey("multi_phantom", hearts), None, {})  # type: ignore[arg-type]


def test_shares_of_views():
    views = np.array([0, 0, 0, 5])
    survey = Survey("frames", [sweep("a", "train", pictures(1, 1, 4), views=views)])
    shares = view_shares(survey, LABELS)
    assert shares["on_target"] == {"A4C": 0.75} and shares["frames"]["Random"] == 0.25
    assert "A4C 75%" in check_views(shares)
    survey.sweeps[0] = dataclasses.replace(survey.sweeps[0], views=np.array([1, 2, 3, 5]))
    with pytest.raises(RacinesError, match="no sweep to A4C ever shows it"):
        check_views(view_shares(survey, LABELS))


def like_the_paper(count: int = 4000) -> np.ndarray:
    """(count, 12) parameters with the paper's moments, inside its ranges."""
    rng = np.random.default_rng(0)
    columns = []
    for row in PAPER_STATISTICS.values():
        values = row.mean + row.std * rng.normal(size=count)
        columns.append(values.clip(row.minimum, row.maximum))
    angle = math.pi - np.abs(0.15 * rng.normal(size=count))
    columns[PARAMETERS.index("rotation_x")] = angle * np.where(rng.random(count) < 0.5, 1, -1)
    return np.stack(columns, -1).astype(np.float32)


def test_data_like_the_papers_hold():
    parameters = like_the_paper()
    assert "12 of 12 parameters hold" in check_paper(verdicts_of(statistics_of(parameters)))
    assert "between" in check_modes(parameters)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            lambda row: dataclasses.replace(row, mean=row.mean + 0.3 * row.std),
            "mean off by 0.30 std",
        ),
        (
            lambda row: dataclasses.replace(row, mean=row.mean - 0.3 * row.std),
            "mean off by 0.30 std",
        ),
        (lambda row: dataclasses.replace(row, std=1.4 * row.std), "std x 1.40"),
        (lambda row: dataclasses.replace(row, std=0.7 * row.std), "std x 0.70"),
        (lambda row: dataclasses.replace(row, std=math.nan), "std x nan"),
        (
            lambda row: dataclasses.replace(
                row, maximum=row.maximum + 0.12 * (row.maximum - row.minimum)
            ),
            "12 % beyond the range",
        ),
        (
            lambda row: dataclasses.replace(
                row, minimum=row.minimum - 0.12 * (row.maximum - row.minimum)
            ),
            "12 % beyond the range",
        ),
    ],
)
def test_each_limit_of_the_papers_table(change, reason):
    statistics: dict[str, ParameterStatistics] = dict(PAPER_STATISTICS)
    statistics["torque_y"] = change(statistics["torque_y"])
    with pytest.raises(RacinesError) as caught:
        check_paper(verdicts_of(statistics))
    assert f"11 of 12 parameters hold; torque_y: {reason}" in str(caught.value)
    del statistics["torque_y"]
    with pytest.raises(RacinesError, match="torque_y was not measured"):
        check_paper(verdicts_of(statistics))


def test_rotation_x_needs_both_modes_and_nothing_between():
    parameters = like_the_paper()
    column = PARAMETERS.index("rotation_x")
    one = parameters.copy()
    one[:, column] = np.abs(one[:, column])
    with pytest.raises(RacinesError, match="0.0 % of -π; each mode needs 20 %"):
        check_modes(one)
    up = parameters.copy()
    up[:100, column] = 0.3
    with pytest.raises(RacinesError, match="2.5 % look upwards"):
        check_modes(up)


def test_whom_the_papers_table_binds():
    def manifest(source: str, frames: int, anatomy: str = "heart") -> dict:
        settings = {"acquisition": {"phantom": {"anatomy": anatomy}}}
        return {"source": source, "counts": {"frames": frames}, "recipe": {"settings": settings}}

    assert must_meet_paper(manifest("phantom", 144_668))
    assert not must_meet_paper(manifest("phantom", 6_000)) and has_paper(manifest("phantom", 9))
    assert not has_paper(manifest("phantom", 144_668, "abdomen"))
    assert has_paper(manifest("release", 144_668))
    assert not must_meet_paper(manifest("release", 144_668))
    assert not has_paper(manifest("tracked", 144_668))


SMALL = PhantomConfig(block=BlockConfig(voxel=0.004))


@pytest.fixture(scope="module")
def judged() -> tuple[Survey, dict]:
    """Poses around the views, labelled by the oracle."""
    phantom = Phantom(SMALL)
    generator = torch.Generator().manual_seed(0)
    sweeps = []
    for view in phantom.views:
        pose = phantom.target(view)
        parameters = np.zeros((40, 12), np.float32)
        shift = torch.randn(40, 3, generator=generator) * torch.tensor([0.01, 0.01, 0.001])
        parameters[:, 6:9] = pose.position + shift
        parameters[:, 9:] = matrix_to_euler(pose.rotation)
        truth = phantom.truth(torch.from_numpy(parameters))
        labels = {"views": truth.view.numpy(), "grades": truth.grade.numpy()}
        sweeps.append(sweep(view, "train", pictures(1, 1, 40), parameters=parameters, **labels))
    acquisition = {"phantom": dataclasses.asdict(SMALL)}
    recipe = {"settings": {"phantom": PHANTOM_VERSION, "acquisition": acquisition}}
    return Survey("frames", sweeps), {"recipe": recipe}


def test_labels_of_the_oracle_are_found_again(judged):
    survey, manifest = judged
    found = rejudge(survey, manifest)
    assert found.n == 200 and found.view_agreement == 1 and found.grade_error < 0.01
    assert "100.0% of 200 views" in check_rejudged(found)


def test_labels_that_the_oracle_does_not_give(judged):
    survey, manifest = judged
    one = survey.sweeps[0]
    moved = dataclasses.replace(one, views=np.where(one.views == 0, 1, 0))
    with pytest.raises(RacinesError, match="97% are expected"):
        check_rejudged(rejudge(Survey("frames", [moved, *survey.sweeps[1:]]), manifest))
    off = [
        dataclasses.replace(each, grades=np.where(each.grades > 0, each.grades - 0.5, 0))
        for each in survey.sweeps
    ]
    with pytest.raises(RacinesError, match="0.3 at most is expected"):
        check_rejudged(rejudge(Survey("frames", off), manifest))


def test_labels_of_another_oracle_are_left_alone(judged):
    survey, manifest = judged
    settings = manifest["recipe"]["settings"]
    other = {"recipe": {"settings": {**settings, "phantom": "0.0.0"}}}
    assert "labels of phantom 0.0.0" in check_rejudged(rejudge(survey, other))
    assert "the source has no oracle" in check_rejudged(rejudge(survey, {"recipe": {}}))
