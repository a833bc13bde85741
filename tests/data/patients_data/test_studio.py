"""Patients in the studio's tab of data: all configs are listed, a frame has its mask over it."""

import base64
import io
import re
from pathlib import Path

import numpy as np
from PIL import Image

from racines_leaderboard.studio import browsing


def test_every_config_with_a_store_is_listed(root: Path):
    assert browsing.configs(root) == ["frames", "patients", "beating"]


def test_a_frame_of_a_patient_has_its_mask_and_its_phases(root: Path):
    store = browsing.opened(root, "beating")
    name = browsing.trajectories(store, "test", "A4C")[0]
    sweep = browsing.trajectory(store, name)
    assert "patient 20000, test split" in browsing.facts_html(sweep)
    page = browsing.image_html(sweep, 2)
    assert "simulated" in page and re.search(r"beat 0\.\d\d, breath 0\.\d\d", page)
    plain, over = (
        np.asarray(Image.open(io.BytesIO(base64.b64decode(text))))
        for text in re.findall(r"base64,([A-Za-z0-9+/=]+)", page)
    )
    assert np.array_equal(plain, store.images[sweep.first + 2])
    assert over.shape == (128, 128, 3) and store.masks is not None
    background = store.masks[sweep.first + 2].numpy() == 0
    assert (over[background] == plain[background][:, None]).all()
    assert len(np.unique(over[~background], axis=0)) > 20
    assert browsing.figures_html(sweep, 2)
