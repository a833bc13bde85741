"""The contract of a generator, as a test class: inherit it to check your own.

What holds for the rows of every generator, judge and source is `check_rows`.

    class TestMine(GeneratorContract):
        generator_class = MyGenerator
        config = MyConfig(training=Training(images=64, batch_size=8))

pytest collects the inherited tests; they need a `store` fixture that returns a small `FrameStore`.
"""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import torch
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.imaging import IMAGE_SIZE, ImageSource
from racines_data.schema import PARAMETERS
from racines_data.store.frames import FrameStore
from racines_models.contract import (
    check_own_rows,
    check_pose,
    check_same,
    check_seed,
    check_type,
    other_poses,
)
from racines_models.contract import check_rows as check_rows
from racines_models.protocol import Card, Generator, Run

_fits: dict[tuple[type, int], tuple[FrameStore, Generator, TemporaryDirectory[str]]] = {}
# By test class and store, which is held so that its id stays its own.


class GeneratorContract:
    """What every registered generator does, whatever its method."""

    generator_class: ClassVar[type[Generator]]
    config: ClassVar[Any] = None
    """A configuration that fits within seconds; None takes the defaults."""
    exportable: ClassVar[bool] = False
    """It has an `onnx_module`, to be checked; needs the packages of the extra `onnx`."""

    def fitted(self, store: FrameStore, folder: Path) -> Generator:
        """Return a fitted generator, with the files of its fit in a folder.

        One fit serves all tests of a class, so none may change the generator; the files are a copy.
        """
        key = type(self), id(store)
        if key not in _fits:
            home = TemporaryDirectory()
            _fits[key] = store, self.fit(store, Path(home.name)), home
        _, generator, home = _fits[key]
        shutil.copytree(home.name, folder, dirs_exist_ok=True)
        return self.met(generator, store)

    def met(self, generator: Any, store: FrameStore) -> Any:
        """Return a generator that can draw; override it for one that has to adapt to a scout."""
        return generator

    def fit(self, store: FrameStore, folder: Path) -> Generator:
        """Return a generator newly fitted in a folder."""
        generator = self.generator_class(self.config)
        generator.fit(store, Run(folder, seed=3, device="cpu", progress=False))
        return generator

    def parameters(self, store: FrameStore, count: int = 11) -> Tensor:
        """Return (count, 12) parameters of held-out frames; (count, 13) where phases are known."""
        return store.take(store.split_indices("test")[:count]).parameters

    def test_images_are_gray_levels(self, store: FrameStore, tmp_path: Path) -> None:
        """`generate` returns (B, 128, 128) uint8, none for no poses; the class is a generator."""
        generator = self.fitted(store, tmp_path)
        assert isinstance(generator, Generator) and isinstance(generator, ImageSource)
        poses = self.parameters(store)
        check_type(generator.generate, poses, torch.arange(len(poses)))

    def test_same_seed_same_bytes(self, store: FrameStore, tmp_path: Path) -> None:
        """The seed decides, and it matters exactly where the card says so."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        first = generator.generate(poses, 5)
        check_same(first, generator.generate(poses, 5), "G3")
        check_seed(first, generator.generate(poses, 6), generator.card.stochastic)

    def test_pose_counts_where_the_card_says_so(self, store: FrameStore, tmp_path: Path) -> None:
        """Other poses change the images exactly where the card says so."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        first, other = (generator.generate(x, 5) for x in (poses, other_poses(poses)))
        check_pose(first, other, generator.card.conditional)

    def test_two_fits_agree(self, store: FrameStore, tmp_path: Path) -> None:
        """The same data and seed give the same model file on one machine."""
        self.fitted(store, tmp_path / "a")
        self.fit(store, tmp_path / "b")
        a, b = (tmp_path / name / "model.safetensors" for name in ("a", "b"))
        assert a.read_bytes() == b.read_bytes()

    def test_sample_ignores_its_batch(self, store: FrameStore, tmp_path: Path) -> None:
        """An image depends on its own parameters and seed, to the last bit."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        seeds = torch.arange(len(poses)) * 7 + 1
        check_own_rows(generator.generate, poses, seeds)

    def test_saved_and_loaded_draws_the_same(self, store: FrameStore, tmp_path: Path) -> None:
        """`load` of what `fit` or `save` left gives the same bytes and the same card."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store)
        generator.save(tmp_path / "copy")
        for folder in (tmp_path, tmp_path / "copy"):
            loaded = self.met(self.generator_class.load(folder), store)
            assert torch.equal(loaded.generate(poses, 5), generator.generate(poses, 5))
            assert loaded.card == generator.card

    def test_exported_file_draws_the_same(self, store: FrameStore, tmp_path: Path) -> None:
        """Where exportable: within 1 gray level, and in at most 1 pixel of 1,000, with no force."""
        if not self.exportable:
            return
        from racines_models.exchange.onnx.generator import OnnxGenerator, export_generator

        generator, poses = self.fitted(store, tmp_path), self.parameters(store).clone()
        poses[:2, :6] = float("nan")
        export_generator(generator, tmp_path / "model.onnx")
        drawn = OnnxGenerator(tmp_path / "model.onnx").generate(poses, 5)
        apart = (drawn.int() - generator.generate(poses, 5).int()).abs()
        assert int(apart.max()) <= 1 and int((apart > 0).sum()) * 1000 <= apart.numel()

    def test_broken_pose_is_refused(self, store: FrameStore, tmp_path: Path) -> None:
        """NaN in a pose, and parameters of a wrong shape, are errors that name the column."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store).clone()
        assert "(B, 12)" in _refusal(generator.generate, poses[:, :6], 0)
        poses[2, PARAMETERS.index("position_y")] = float("nan")
        assert "position_y of row 2" in _refusal(generator.generate, poses, 0)

    def test_absent_force_is_no_error(self, store: FrameStore, tmp_path: Path) -> None:
        """Tracked data has no force sensor: NaN there still gives an image."""
        generator, poses = self.fitted(store, tmp_path), self.parameters(store).clone()
        poses[:, :6] = float("nan")
        assert generator.generate(poses, 0).shape == (len(poses), IMAGE_SIZE, IMAGE_SIZE)

    def test_card_is_complete(self, store: FrameStore, tmp_path: Path) -> None:
        """Every text is filled in, and data, seed and size are those of the fit."""
        card = self.fitted(store, tmp_path).card
        for field in dataclasses.fields(Card):
            assert field.type is not str or getattr(card, field.name), field.name
        assert card.name == self.generator_class.name and card.limits
        assert card.data["digest"] == store.manifest["digest"]
        assert card.seed == 3 and card.weights > 0

    def test_missing_or_foreign_folder_is_refused(self, store: FrameStore, tmp_path: Path) -> None:
        """`load` names the folder that holds no model of this generator."""
        for folder in (tmp_path / "absent", tmp_path):
            assert str(folder) in _refusal(self.generator_class.load, folder)


def _refusal(call: Callable[..., Any], *given: Any) -> str:
    try:
        call(*given)
    except RacinesError as error:
        return str(error)
    raise AssertionError(f"{given} was accepted")
