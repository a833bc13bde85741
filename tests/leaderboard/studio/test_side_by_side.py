"""Side by side: sliders of the data, presets that are where they say, and honest figures."""

import json
import re

import numpy as np
import pytest
import torch

from racines_data.errors import RacinesError
from racines_data.schema import PARAMETERS
from racines_data.store.frames import open_store
from racines_leaderboard.board.collect import collect
from racines_leaderboard.studio import parts, side_by_side
from racines_leaderboard.studio.parts import Place
from racines_leaderboard.studio.side_by_side import cards_page
from racines_models.generators.mean_image import MeanImage
from racines_models.protocol import Run
from racines_models.scores.metrics import psnr, ssim
from tests.leaderboard.conftest import generator_scores


@pytest.fixture(scope="module")
def place(tiny_root, tmp_path_factory):
    folder = tmp_path_factory.mktemp("generators")
    MeanImage().fit(open_store(tiny_root), Run(folder / "runs" / "mean-image", progress=False))
    MeanImage().fit(open_store(tiny_root), Run(folder / "weights" / "other", progress=False))
    return Place(data=tiny_root, runs=folder / "runs", weights=folder / "weights")


def test_sliders_reach_as_far_as_the_data(place):
    handles = side_by_side.sliders(place)
    store = open_store(place.data)
    assert sorted(handle.name for handle in handles) == sorted(PARAMETERS)
    for handle in handles:
        column = store.parameters[:, PARAMETERS.index(handle.name)] * handle.scale
        assert handle.low <= float(column.min()) and float(column.max()) <= handle.high
        assert handle.high - handle.low < 7 or handle.unit != "rad"


def test_without_data_they_reach_as_far_as_the_papers_table(tmp_path):
    handles = side_by_side.sliders(Place(data=tmp_path / "none"))
    height = next(handle for handle in handles if handle.name == "position_z")
    assert (height.low, height.high, height.unit) == (40.0, 134.0, "mm")


def test_generators_with_weights_are_offered_and_nothing_else(place, monkeypatch):
    strange = place.runs / "strange"
    strange.mkdir(exist_ok=True)
    (strange / "config.json").write_text(
        json.dumps({"schema": "racines.generator/1", "name": "os:system"})
    )
    (strange / "model.safetensors").write_bytes(b"")
    assert list(parts.trained_generators(place)) == ["other", "mean-image (run)"]
    monkeypatch.setattr(parts, "LARGEST", 10)
    assert not parts.trained_generators(place)


def test_those_that_lead_a_board_come_first(tmp_path):
    scores, results = tmp_path / "scores", tmp_path / "results"
    scores.mkdir()
    for name, value in (("good", 0.9), ("better", 0.95), ("poor", 0.4)):
        document = generator_scores(name, ssim=value)
        (scores / f"{name}.json").write_text(json.dumps(document))
    records = collect([scores], results, tmp_path, "tiny")
    place, offered = Place(results=results), ["apart", "good", "poor", "better"]
    assert side_by_side.leading(place, offered) == ["better", "good", "poor", "apart"]
    records[0].write_text("{")
    assert side_by_side.leading(place, offered) == offered, (
        "damaged results close their own tab alone"
    )


def test_a_preset_shows_its_view(place):
    values = side_by_side.preset(place, "nominal A4C")
    cards = side_by_side.draw_cards(place, values, 0, [])
    assert [card.title for card in cards] == ["phantom", "nearest frame"]
    assert cards[0].notes[0].startswith("truth: A4C")
    force = dict(zip((h.name for h in side_by_side.sliders(place)), values, strict=True))["force_z"]
    assert force < -0.5  # the probe presses on the block there


def test_a_test_frame_is_the_nearest_to_itself(place):
    values, which = side_by_side.frame(place, 0)
    cards = side_by_side.draw_cards(place, values, 3, [])
    assert "0.0 mm and 0.0° off" in cards[1].notes[0]
    again, other = side_by_side.frame(place, 0), side_by_side.frame(place, 1)
    assert again == (values, which) and other[1] != which
    store = open_store(place.data)
    row = int(store.order("test", place.seed)[0])
    np.testing.assert_array_equal(cards[1].image, store.images[row].numpy())


def test_figures_are_those_of_the_images_shown(place):
    values, _ = side_by_side.frame(place, 0)
    cards = side_by_side.draw_cards(place, values, 0, ["mean-image (run)"])
    truth, drawn = (torch.from_numpy(cards[i].image)[None] for i in (0, 2))
    expected = f"SSIM {float(ssim(drawn, truth)):.3f}, PSNR {float(psnr(drawn, truth)):.1f} dB"
    assert expected in cards[2].notes
    page = cards_page(cards)
    assert page.count("<img") == 3 and expected in page


def test_another_pose_gives_other_images_and_the_same_one_the_same(place):
    values, _ = side_by_side.frame(place, 0)
    moved = [values[0] + 5.0, *values[1:]]
    once, again = (side_by_side.draw_cards(place, values, 0, [])[0].image for _ in range(2))
    np.testing.assert_array_equal(once, again)
    assert (side_by_side.draw_cards(place, moved, 0, [])[0].image != once).any()
    assert (side_by_side.draw_cards(place, values, 1, [])[0].image != once).any()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e9, -1e9, "450", None, True, [1]])
def test_a_parameter_out_of_range_is_refused(place, value):
    values, _ = side_by_side.frame(place, 0)
    with pytest.raises(RacinesError, match="position_x"):
        side_by_side.draw_cards(place, [value, *values[1:]], 0, [])


def test_other_inputs_are_refused(place):
    values, _ = side_by_side.frame(place, 0)
    for seed, ticked, given in (
        (-1, [], values),
        (0.5, [], values),
        (0, ["../mean-image"], values),
        (0, "mean-image (run)", values),
        (0, [], values[:11]),
    ):
        with pytest.raises(RacinesError):
            side_by_side.draw_cards(place, given, seed, ticked)
    with pytest.raises(RacinesError, match="not offered"):
        side_by_side.preset(place, "nominal Random")


def test_titles_are_text():
    card = side_by_side.Card("<script>", np.zeros((128, 128), np.uint8), ("<img onerror=x>",))
    page = cards_page([card])
    assert not re.search(r"<script|<img onerror", page) and "&lt;script&gt;" in page
