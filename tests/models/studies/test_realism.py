import io
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import torch
from PIL import Image
from scipy.stats import wasserstein_distance

from racines_data.errors import RacinesError
from racines_models.studies.realism.report import (
    RULES,
    RealFrames,
    Realism,
    RealismConfig,
    Sector,
    choose_rows,
    common_sector,
    compare_with_real,
    local_deviation,
    of_store,
    one_each,
    read_real,
    wasserstein,
)
from tests.models.labelled import LabelledStore
from tests.models.scores.test_scores import Coarse

REAL = (
    Path(os.environ.get("RACINES_REAL", Path(__file__).parents[4] / "shared" / "real"))
    / "camus_a4c_reference.parquet"
)


def sector_mask() -> torch.Tensor:
    y, x = torch.meshgrid(torch.arange(128.0), torch.arange(128.0) - 63.5, indexing="ij")
    return (torch.atan2(x, y).abs() < 0.65) & (x.hypot(y) < 100) & (x.hypot(y) > 2)


def speckle(count: int, level: float, seed: int) -> torch.Tensor:
    """(N, 128, 128) uint8 Rayleigh speckle in a sector."""
    generator = torch.Generator().manual_seed(seed)
    real, imaginary = torch.randn(2, count, 128, 128, generator=generator)
    gray = (level * real.hypot(imaginary)).clamp(1, 255)
    return (gray * sector_mask()).to(torch.uint8)


def png(image: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "PNG")
    return buffer.getvalue()


@pytest.fixture
def real_file(tmp_path):
    images = speckle(60, 50, seed=1).numpy()
    patients = [f"patient{i // 2:04d}" for i in range(60)]
    path = tmp_path / "real.parquet"
    pl.DataFrame({"patient": patients, "image": [png(i) for i in images]}).write_parquet(path)
    return path


@pytest.fixture
def phantom_like():
    store = LabelledStore(trajectories=10, length=12)
    store.views[:] = 0
    store.grades = torch.linspace(0, 10, 120)
    store.images = speckle(120, 80, seed=2)
    return store


CONFIG = RealismConfig(frames=15, splits=5)


def compared(real: RealFrames, store: LabelledStore) -> Realism:
    """Hold a dataset beside real frames."""
    return compare_with_real(real, of_store(store, CONFIG), CONFIG, Coarse())


def test_the_phantom_stands_beside_two_halves_of_the_real_set(real_file, phantom_like):
    result = compared(read_real(real_file), phantom_like)
    content = result.content
    assert content["n"] == 15 and content["phantom_frames"] == 15
    assert content["real"]["patients"] == 30 and set(content["figures"]) == set(RULES)
    for name, figure in content["figures"].items():
        # Brighter than real speckle, while the halves of the real set are of one law.
        assert figure["phantom"]["value"] > figure["real"]["value"], name
        assert figure["real"]["low"] <= figure["real"]["value"] <= figure["real"]["high"]
    assert content["figures"]["gray"]["phantom"]["value"] > 20
    assert content["figures"]["gray"]["real"]["value"] < 2
    assert content["gray"]["phantom"]["mean"] > content["gray"]["real"]["mean"]
    again = compared(read_real(real_file), phantom_like).content
    assert again["figures"] == content["figures"]


def test_frames_of_the_same_law_are_as_near_as_the_halves(real_file, phantom_like):
    phantom_like.images = speckle(120, 50, seed=3)
    content = compared(read_real(real_file), phantom_like).content
    for name in ("gray", "gray_by_depth", "local_contrast", "gray_by_cell"):
        figure = content["figures"][name]
        assert figure["phantom"]["value"] < 2 * figure["real"]["high"], name


def test_only_frames_of_the_view_and_grade_are_taken(phantom_like):
    phantom_like.views[:60] = 5
    phantom_like.images[:] = torch.arange(120, dtype=torch.uint8).view(-1, 1, 1)
    rows = choose_rows(phantom_like, RealismConfig(frames=10, grade=8.0))
    taken = phantom_like.take(rows).images
    assert len(taken) == 10 and int(taken.min()) >= 96
    with pytest.raises(RacinesError, match="SC with grade >= 5"):
        choose_rows(phantom_like, RealismConfig(view="SC"))
    with pytest.raises(RacinesError, match="the dataset's views are"):
        choose_rows(phantom_like, RealismConfig(view="XX"))


def test_frames_of_many_hearts_are_taken_evenly_over_the_hearts(phantom_like):
    store = phantom_like
    store.config = "multi_phantom"
    store.manifest["multi_phantom"] = {"digest": "of many"}
    store.phantoms = [3, 3, 3, 3, 3, 3, 1, 7, 9, 9]  # of the trajectories, 12 frames each
    store.images[:] = torch.arange(120, dtype=torch.uint8).view(-1, 1, 1)

    def of_heart(count: int) -> list[int]:
        rows = choose_rows(store, RealismConfig(frames=count, grade=0.0))
        assert len(rows.unique()) == count
        assert store.take(rows).images[:, 0, 0].tolist() == rows.tolist()
        seeds = torch.tensor(store.phantoms)[store.trajectory_index[rows]]
        return [int((seeds == seed).sum()) for seed in (1, 3, 7, 9)]

    assert of_heart(8) == [2, 2, 2, 2]
    assert sorted(of_heart(2)) == [0, 0, 1, 1]
    assert of_heart(80) == [12, 32, 12, 24], "a heart of few frames gives all that it has"


def test_the_report_on_many_hearts_names_its_config_and_digest(real_file, phantom_like):
    plain = compared(read_real(real_file), phantom_like).content
    assert plain["config"] == "frames" and plain["phantom_hearts"] == 1
    phantom_like.config = "multi_phantom"
    phantom_like.manifest["multi_phantom"] = {"digest": "of many"}
    phantom_like.phantoms = list(range(1, 11))
    many = compared(read_real(real_file), phantom_like).content
    assert many["config"] == "multi_phantom" and many["phantom_hearts"] == 5
    assert many["dataset"]["digest"] == "of many" != plain["dataset"]["digest"]


def test_the_mask_is_where_both_sets_show_something():
    real, phantom = speckle(20, 50, 1), speckle(20, 50, 2)
    real[:, :60] = 0
    real[:3] = 0  # 85 % of the real frames remain
    phantom[:, 90:] = 0
    mask = common_sector(real, phantom, 0.8)
    rows = mask.any(1).nonzero()[:, 0]
    assert (int(rows.min()), int(rows.max())) == (60, 89)
    with pytest.raises(RacinesError, match="do not overlap"):
        common_sector(real, phantom, 0.9)


def test_each_patient_gives_one_frame_the_phases_by_turns():
    patient = np.array([3, 0, 0, 1, 1, 2, 3, 3])
    images = torch.arange(8, dtype=torch.uint8).view(8, 1, 1).expand(8, 128, 128)
    kept = one_each(RealFrames(images, patient, ""), 10)
    assert kept.patient.tolist() == [0, 1, 2, 3]
    assert kept.images[:, 0, 0].tolist() == [1, 4, 5, 0]
    assert one_each(RealFrames(images, patient, ""), 2).patient.tolist() == [0, 2]


def test_rings_and_cells_follow_depth_and_angle():
    mask = sector_mask()
    sector = Sector.of(mask)
    rows, columns = mask.nonzero().unbind(1)
    centre = columns == 64
    assert (sector.ring[centre].diff() >= 0).all()
    assert sector.ring.min() == 0 and sector.ring.max() == 15
    assert sorted(sector.cell.unique().tolist()) == list(range(9))
    assert sector.cell[columns < 30].remainder(3).max() == 0  # the left third
    assert (sector.cell[rows > 95] // 3).min() == 2  # the deepest


def test_wasserstein_equals_scipy():
    generator = torch.Generator().manual_seed(0)
    a, b = torch.randint(0, 50, (2, 256), generator=generator)
    level = np.arange(256)
    expected = wasserstein_distance(level, level, a.numpy(), b.numpy())
    assert wasserstein(a, b) == pytest.approx(expected)


def test_local_deviation_by_hand():
    image = torch.zeros(1, 16, 16, dtype=torch.uint8)
    image[0, 8, 8] = 100
    deviation = local_deviation(image)
    assert float(deviation[0, 8, 8]) == pytest.approx(100 * (1 / 25 - 1 / 625) ** 0.5)
    assert float(deviation[0, 2, 2]) == 0


def test_broken_real_files_are_refused(tmp_path, real_file):
    with pytest.raises(RacinesError, match="no such file"):
        read_real(tmp_path / "absent.parquet")
    pl.read_parquet(real_file).drop("patient").write_parquet(tmp_path / "columns.parquet")
    with pytest.raises(RacinesError, match="patient"):
        read_real(tmp_path / "columns.parquet")
    small = pl.DataFrame({"patient": ["a"], "image": [png(np.zeros((64, 64), np.uint8))]})
    small.write_parquet(tmp_path / "small.parquet")
    with pytest.raises(RacinesError, match="128 x 128"):
        read_real(tmp_path / "small.parquet")


@pytest.mark.skipif(not REAL.is_file(), reason=f"REAL FRAMES ABSENT: {REAL}; set RACINES_REAL")
def test_real_frames_are_nearer_to_each_other_than_speckle_is(phantom_like):
    real = read_real(REAL)
    assert len(real.images) == 500 and len(set(real.patient)) == 250
    figures = compared(real, phantom_like).content["figures"]
    figure = figures["local_contrast"]  # raw Rayleigh speckle is rougher than a scanner's picture
    assert figure["phantom"]["value"] > 2 * figure["real"]["high"]
