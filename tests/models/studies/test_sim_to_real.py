"""Real frames from files, their controls, outlines turned into volumes, and the whole report."""

import json
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import torch
from matplotlib.figure import Figure
from PIL import Image, ImageDraw
from torch import Tensor
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.judges.grader.model import Grader, GraderConfig
from racines_models.judges.segmentation.model import (
    SegmentationConfig,
    SegmentationJudge,
    SegmentationNetwork,
)
from racines_models.networks.grading import GraderNetwork
from racines_models.protocol import Judge
from racines_models.studies.realism.patients import patient_lists
from racines_models.studies.sim_to_real.acceptance import Called, accepted, accepted_turns
from racines_models.studies.sim_to_real.charts import (
    Turned,
    ejection_figure,
    shares_figure,
    turns_figure,
)
from racines_models.studies.sim_to_real.controls import CONTROLS, scrambled
from racines_models.studies.sim_to_real.figures import draw
from racines_models.studies.sim_to_real.frames import (
    Rotation,
    read_frames,
    read_masks,
    read_real_echo,
)
from racines_models.studies.sim_to_real.report import images_asked, measure
from racines_models.studies.sim_to_real.sectors import (
    crop_screen,
    sectors,
)
from tests.models.judges.masked import draw as draw_frames
from tests.models.judges.masked import hearts
from tests.models.studies.test_realism import png

SHARED = Path(os.environ.get("RACINES_REAL", Path(__file__).parents[4] / "shared" / "real"))
MM = 1.5


class Bright(Judge):
    """Calls a frame A4C if its upper half is the brighter one; turned over, it is not."""

    labels = ("A4C", "SC", "PL", "PSAV", "PSMV", "Random")

    def probabilities_and_grade(self, images: Tensor) -> tuple[Tensor, Tensor]:
        up, down = images[:, :50].float().mean((1, 2)), images[:, 78:].float().mean((1, 2))
        p = torch.sigmoid((up - down) / 5)
        rest = torch.zeros(len(p), 5)
        rest[:, 4] = 1 - p
        return torch.cat([p.unsqueeze(1), rest], 1), torch.full((len(p),), 5.0)


class Outliner(SegmentationJudge):
    """Outlines as cardiologists did, a little smaller at end systole."""

    def __init__(self, truth: Tensor) -> None:
        config = SegmentationConfig(("LV", "LV myocardium", "LA"), channels=1)
        super().__init__(SegmentationNetwork(config), config)
        self.truth = truth

    def segment(self, images: Tensor) -> Tensor:
        masks = self.truth[torch.arange(len(images)) % len(self.truth)].clone()
        masks[1::2, :45] = 0
        return masks


@pytest.fixture(scope="module")
def echo(tmp_path_factory) -> Path:
    """A folder as the shared one: frames and masks of ten patients, a rotation, pictures."""
    folder = tmp_path_factory.mktemp("echo")
    names = [each for name in ("tuning", "reporting") for each in patient_lists()[name][:5]]
    truth = hearts(10)
    columns = {"patient": [each for each in names for _ in "ab"], "phase": ["ED", "ES"] * 10}
    images = [png(each) for each in draw_frames(truth, 5).numpy()]
    size = {"width": [640] * 20, "height": [640] * 20}
    pl.DataFrame(columns | {"image": images} | size).write_parquet(folder / "frames.parquet")
    masks = {"mask": [png(each) for each in truth.numpy()]}
    mm = {"mm_per_row": [MM] * 20, "mm_per_column": [MM] * 20}
    pl.DataFrame(columns | masks | mm).write_parquet(folder / "masks.parquet")
    turns = folder / "turned"
    (turns / "images").mkdir(parents=True)
    poses = []
    for i, angle in enumerate(np.radians([0, 0, 60, 60, 180, 180])):
        cos, sin = np.cos(angle), np.sin(angle)
        poses.append([[cos, 0, -sin, 80], [sin, 0, cos, 80], [0, 1, 0, 0]])
        Image.fromarray(draw_frames(truth[:1], i)[0].numpy()).save(turns / f"images/{i:04d}.png")
    content = {"frames": [{"transform_matrix": each} for each in poses]}
    (turns / "transforms_train.json").write_text(json.dumps(content))
    (folder / "pictures").mkdir()
    for name in ("08_a4ch-full", "26_plax", "45_subcostal"):
        screen().save(folder / f"pictures/{name}.png")
    return folder


def screen() -> Image.Image:
    """A scanner's screen: a sector, a bar, green and white writing."""
    picture = Image.new("RGB", (400, 300))
    pen = ImageDraw.Draw(picture)
    pen.pieslice((50, -190, 350, 230), 50, 130, fill=(90, 90, 90))
    pen.ellipse((180, 100, 220, 160), fill=(0, 0, 0))
    pen.rectangle((385, 20, 395, 120), fill=(255, 255, 255))
    pen.line((10, 280, 200, 290), fill=(0, 255, 0), width=9)
    pen.text((5, 5), "51 Hz", fill=(255, 255, 255))
    return picture


def test_a_folder_is_read_with_all_it_has(echo):
    real = read_real_echo(echo)
    assert real.frames.images.shape == (20, 128, 128) and real.drawn is not None
    assert real.drawn.row.tolist() == list(range(20)) and not real.drawn.stretched
    assert real.rotation is not None and real.pictures is not None
    assert np.allclose(np.abs(real.rotation.angle), [0, 0, 60, 60, 180, 180])
    assert real.rotation.turn.tolist() == [0, 0, 1, 1, 2, 2]
    assert real.pictures.views == ("A4C", "PL", "SC")
    alone = read_real_echo(echo / "frames.parquet")
    assert alone.drawn is None and alone.rotation is None
    assert read_real_echo(echo / "frames.parquet", echo / "masks.parquet").drawn is not None


def test_a_screen_is_cut_away_and_the_sector_fills_the_frame():
    frame = crop_screen(screen())
    lit = frame > 40
    assert lit[:3].any() and lit[-3:].any()
    assert frame.max() < 120  # neither bar nor writing
    assert 0.4 < float(sectors(torch.from_numpy(frame.copy())[None]).float().mean()) < 0.9


def test_scrambling_keeps_outline_and_gray_levels_and_no_place(echo):
    images = read_frames(echo / "frames.parquet").images[:4]
    mixed = scrambled(images)
    assert torch.equal(mixed.flatten(1).sort(1).values, images.flatten(1).sort(1).values)
    assert not torch.equal(mixed, images) and torch.equal(scrambled(images), mixed)
    outside = ~sectors(images)
    assert bool((mixed[outside] == 0).all())
    assert list(CONTROLS) == ["as they are", "upside down", "scrambled", "mirrored"]


def test_the_report_holds_lists_apart_and_the_controls_beside(echo):
    real = read_real_echo(echo)
    assert real.drawn is not None
    judge, outliner, asked = Bright(), Outliner(real.drawn.masks), []
    measured = measure(real, judge, outliner, asked.append)
    content = json.loads(json.dumps(measured.content))
    assert sum(asked) == images_asked(real, True, True) == 20 * 4 + 6 + 3 + 20
    assert content["schema"] == "racines.sim-to-real/1"
    assert content["real"]["lists"] == {
        name: {"frames": 10, "patients": 5} for name in ("tuning", "reporting")
    }
    for controls in content["acceptance"].values():
        shares = {name: told["called_a4c"]["value"] for name, told in controls.items()}
        assert shares["as they are"] + shares["upside down"] == 1.0
        assert shares["mirrored"] == shares["as they are"]
        sure = [told["surely_a4c"]["value"] for told in controls.values()]
        assert all(a <= b for a, b in zip(sure, shares.values(), strict=True))
        assert controls["as they are"]["called_a4c"]["settings"]["units"] == 5
    assert content["other_views"]["others_called_a4c"]["n"] == 2
    assert content["rotation"]["turns"] == 3 and content["rotation"]["patients"] == 1
    assert content["rotation"]["sectors"]["between"]["frames"] == 2
    assert sum(each["frames"] for each in content["rotation"]["bins"]) == 6  # 180° is in one too
    volumes = content["volumes"]["reporting"]
    assert volumes["ejection_fraction"]["bias"]["value"] > 0
    assert volumes["end_diastolic_volume"]["bias"]["value"] == 0
    assert len(volumes["ejection_fraction"]["pairs"]) == 5
    assert content["overlap"]["tuning"]["dice_lv"]["value"] < 1.0
    drawn = draw(real, measured, outliner)
    assert set(drawn) == {"", "-acceptance", "-turns", "-ejection"}
    assert all(each[:4] == b"\x89PNG" for each in drawn.values())


def test_what_is_called_a4c_with_probability_09_is_counted_apart():
    called = Called(np.array([0, 0, 0, 1]), np.array([0.95, 0.9, 0.5, 0.2], np.float32))
    told = accepted({"as they are": called}, np.array(list("aabb")), np.arange(4), Bright.labels)
    shares = [told["as they are"][name]["value"] for name in ("called_a4c", "surely_a4c")]
    assert shares == [0.75, 0.5]
    angles = np.array([0.0, 0.0, 90.0, 90.0])
    images = torch.zeros(4, 128, 128, dtype=torch.uint8)
    turned = accepted_turns(called, Rotation(images, angles, np.array([0, 0, 1, 1])), Bright.labels)
    between = turned["sectors"]["between"]
    assert (between["called_a4c"], between["surely_a4c"]) == (0.5, 0.0)


def test_either_judge_does_alone_and_none_is_refused(echo):
    real = read_real_echo(echo)
    assert "overlap" not in measure(real, Bright()).content
    with pytest.raises(RacinesError, match="no judge: give --grader FOLDER"):
        measure(real)
    assert real.drawn is not None
    with pytest.raises(RacinesError, match="give --masks FILE"):
        measure(real._replace(drawn=None), None, Outliner(real.drawn.masks))
    stranger = Bright()
    stranger.labels = ("KLX", "Random")
    with pytest.raises(RacinesError, match="the grader knows KLX, Random, not A4C"):
        measure(real, stranger)


def test_bad_files_are_named_with_field_and_remedy(echo, tmp_path):
    with pytest.raises(RacinesError, match="none: no such file or folder; see docs"):
        read_real_echo(Path("none"))
    with pytest.raises(RacinesError, match="no Parquet file with columns patient and image"):
        read_real_echo(tmp_path)
    frames, masks = (pl.read_parquet(echo / f"{name}.parquet") for name in ("frames", "masks"))
    path = tmp_path / "bad.parquet"
    cases = [
        (frames.drop("image"), "lacks column image; frames have patient, image"),
        (frames.with_columns(view=pl.lit("A2C")), "column view never says A4C"),
        (frames.with_columns(image=pl.lit(b"x")), "column image holds no PNG"),
        (frames.with_columns(image=pl.lit(png(np.zeros((64, 32), np.uint8)))), "is 32 x 64; make"),
    ]
    for table, told in cases:
        table.write_parquet(path)
        with pytest.raises(RacinesError, match=told):
            read_frames(path)
    known = read_frames(echo / "frames.parquet")
    for table, told in [
        (masks.drop("mm_per_row"), "lacks column mm_per_row"),
        (masks.with_columns(patient=pl.lit("x")), "no patient and phase of it is among the frames"),
        (masks.with_columns(mm_per_row=pl.lit(0.0)), "is not positive; give millimetres"),
        (masks.with_columns(mask=pl.lit(png(np.full((128, 128), 9, np.uint8)))), "holds 0-3"),
    ]:
        table.write_parquet(path)
        with pytest.raises(RacinesError, match=told):
            read_masks(path, known)
    path.write_bytes(b"no parquet")
    with pytest.raises(RacinesError, match="bad.parquet: no Parquet file"):
        read_frames(path)


def test_the_command_tells_tables_and_json(echo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["study", "sim-to-real", "--real", str(echo), "--out", "it"]
    with pytest.raises(RacinesError, match="no judge: give --grader"):
        CliRunner().invoke(app, words, catch_exceptions=False)
    config = SegmentationConfig(("LV", "LV myocardium", "LA"), 64, 2)
    SegmentationJudge(SegmentationNetwork(config), config).save(Path("models/runs/segmentation"))
    content = json.loads(CliRunner().invoke(app, [*words, "--json"]).stdout)
    assert content["segmentation"]["id"] == "racines-segmentation-unet"
    assert Path("it.png").is_file() and Path("it-ejection.png").is_file()
    assert json.loads(Path("it.json").read_text(encoding="utf-8")) == content
    shown = CliRunner().invoke(app, [*words, "--segmentation", "models/runs/segmentation"]).stdout
    assert "dice_lv_myocardium" in shown and "reporting" in shown and "it-ejection.png" in shown


def test_the_command_writes_the_charts_beside_the_report(echo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = GraderConfig(input_size=32, width=0.125, bf16=False)
    Grader(GraderNetwork(32, 0.125), config).save(Path("grader"))
    words = ["study", "sim-to-real", "--real", str(echo), "--grader", "grader", "--out", "it"]
    shown = CliRunner().invoke(app, words).stdout
    assert "p ≥ 0.9" in shown
    for name in ("it-acceptance.png", "it-turns.png"):
        assert name in shown and Image.open(name).width > 600


def test_charts_hold_pixels_of_a_rotation_alone(echo):
    real = read_real_echo(echo)
    assert real.rotation is not None and real.drawn is not None
    measured = measure(real, Bright(), Outliner(real.drawn.masks))
    acceptance, called = measured.content["acceptance"], measured.answers.turns
    assert called is not None
    turned = Turned(called, measured.content["rotation"])
    figures = [
        shares_figure(acceptance),
        ejection_figure(measured.content["volumes"]),
        shares_figure(acceptance, real.rotation),
        turns_figure(real.rotation, {"one": turned, "another": turned}),
    ]
    assert [len(pixels(figure)) for figure in figures] == [0, 0, 4, 3]
    for image in pixels(figures[3]):
        assert any((each.numpy() == image).all() for each in real.rotation.images)
    assert "-turns" not in draw(real._replace(rotation=None), measured)


def pixels(figure: Figure) -> list[np.ndarray]:
    """Return the images in a figure."""
    return [np.asarray(each.get_array()) for axes in figure.axes for each in axes.images]


def test_shares_of_turns_are_not_joined_over_those_that_nobody_recorded(echo):
    real = read_real_echo(echo)
    measured = measure(real, Bright())
    assert real.rotation is not None and measured.answers.turns is not None
    turned = Turned(measured.answers.turns, measured.content["rotation"])
    line = turns_figure(real.rotation, {"one": turned}).axes[0].lines[0]
    seen = np.isfinite(np.asarray(line.get_ydata(), float))
    assert seen.sum() == 3 and not (seen[1:] & seen[:-1]).any()


def test_a_chart_marks_each_list_and_whom_it_leaves_out():
    pairs = {"a": [50.0, 60.0], "b": [-30.0, 55.0], "c": [None, 50.0], "d": [40.0, 45.0]}
    fraction = {"patients": 2, "not_seen": 1, "impossible": 1, "pairs": pairs}
    names = ("tuning", "reporting", "unlisted")
    volumes = {name: {"ejection_fraction": fraction} for name in names}
    axes = ejection_figure(volumes).axes
    assert len(axes) == 1 + len(names)
    drawn = [(line.get_marker(), len(np.asarray(line.get_xdata()))) for line in axes[0].lines[1:]]
    assert drawn == [("o", 2), ("|", 1), ("s", 2), ("|", 1), ("^", 2), ("|", 1)]
    assert axes[0].get_legend_handles_labels()[1][0] == "tuning: 2 patients; ticks: 1 below 0"


def test_the_shared_frames_and_masks_lie_over_each_other():
    if not (SHARED / "camus_a4c_masks.parquet").is_file():
        pytest.skip(f"NO REAL FRAMES: {SHARED} is absent; rasterised hearts are read alone")
    frames = read_frames(SHARED / "camus_a4c_reference.parquet")
    drawn = read_masks(SHARED / "camus_a4c_masks.parquet", frames)
    assert drawn.stretched and len(drawn.masks) == 498
    inside = sectors(frames.images[drawn.row[:60]])
    for number in (1, 2, 3):
        part = drawn.masks[:60] == number
        assert float((part & ~inside).sum() / part.sum()) < 0.01
    gray = frames.images[drawn.row].float()
    cavity, wall = (gray[drawn.masks == number].mean() for number in (1, 2))
    assert float(wall - cavity) > 30
