"""The scene field: its contract, its field, its probe, and what it can find out by itself."""

import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.generators.scene_field import SceneField, SceneFieldConfig
from racines_models.networks.scene_field import lay_out
from racines_models.networks.scene_field_probe import ProbeGeometry
from racines_models.testing import GeneratorContract
from racines_models.training.objective import Training

SMALL = ProbeGeometry(beams=32, samples=48)
LOOP = Training(images=64, batch_size=16, precision="fp32", ema=0.0)
TINY = SceneFieldConfig(probe=SMALL, voxel=0.004, coarse_voxel=0.008, coverage=0.9, training=LOOP)


class TestSceneField(GeneratorContract):
    generator_class = SceneField
    config = TINY
