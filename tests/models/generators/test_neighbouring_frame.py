"""The bound of recorded turns draws what the scores call the neighbour, and nothing else."""

from pathlib import Path

import pytest
import torch

from racines_data.build.dataset import DataConfig, build
from racines_data.errors import RacinesError
from racines_data.sources.rotation.source import RotationSource
from racines_data.store.frames import open_store
from racines_models.generators.neighbouring_frame import Generator
from racines_models.protocol import Run
from racines_models.scores.turns import next_turns
from tests.data.sources.rotation_folder import write_rotation


@pytest.mark.parametrize("phases", [1, 3])
def test_it_draws_the_frame_of_the_next_turn(tmp_path: Path, phases: int):
    folder = write_rotation(tmp_path / "heart", turns=36, phases=phases)
    source = RotationSource.from_config({"split": "gap"}, [folder])
    build(source, tmp_path / "turns", DataConfig(workers=1, shards=1))
    store = open_store(tmp_path / "turns")
    generator = Generator()
    generator.fit(store, Run(tmp_path / "run", device="cpu", progress=False))
    rows = store.split_indices("test")
    wanted = store.take(next_turns(store, rows)).images
    again = Generator.load(tmp_path / "run")
    for each in (generator, again):
        assert torch.equal(each.generate(store.conditions(rows), 0), wanted)
    assert not torch.equal(wanted, store.take(rows).images)


def test_frames_that_are_no_turns_are_refused(store, tmp_path: Path):
    with pytest.raises(RacinesError, match="no turns"):
        Generator().fit(store, Run(tmp_path, device="cpu", progress=False))
