"""The gallery shows every pose and every generator, on held-out frames."""

import pytest
import torch
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_models.scores.gallery import CELL, DPI, gallery_sample, write_gallery
from tests.conftest import command


class Ramp:
    """Draws a ramp up to one brightness."""

    def __init__(self, level):
        self.image = torch.linspace(0, level, 128).to(torch.uint8).expand(128, 128)

    def generate(self, parameters, seed):
        return self.image.expand(len(parameters), -1, -1)


@pytest.fixture(scope="module")
def store(tiny_root):
    return open_store(tiny_root)


def test_a_column_a_generator_and_a_row_a_pose(store, tmp_path):
    sample = gallery_sample(store)
    rows = sample.frames.index
    assert set(rows.tolist()) <= set(store.split_indices("test").tolist())
    path = tmp_path / "gallery.png"
    write_gallery(path, store, sample, {"a": Ramp(200), "b": Ramp(90)}, seed=0)
    page = Image.open(path).convert("L")
    cell = round(CELL * DPI)
    assert page.width > 3 * cell and page.height > len(rows) * cell
    # Read the cells back: the true frame stands in the first column of its row.
    pixels = torch.frombuffer(bytearray(page.tobytes()), dtype=torch.uint8)
    pixels = pixels.view(page.height, page.width).float()
    left, top = page.width - 3 * cell, page.height - len(rows) * cell
    for i, truth in enumerate(sample.frames.images.float()):
        cells = [pixels[top + i * cell :, left + j * cell :][:cell, :cell] for j in range(3)]
        assert (cells[0][:126, :126].mean() - truth.mean()).abs() < 8
        assert cells[1][:126, :126].mean() > cells[2][:126, :126].mean() + 30


def test_no_generators_are_refused(store, tmp_path):
    with pytest.raises(RacinesError, match="name one generator"):
        write_gallery(tmp_path / "x.png", store, gallery_sample(store), {}, 0)


def test_the_command_says_what_it_drew(workplace):
    command(workplace, "racines", "train", "generator", "mean-image", "--json")
    done = command(workplace, "racines", "study", "gallery")
    assert "mean-image" in done.stdout
    assert Image.open(workplace / "models/runs/gallery.png").width > 200
