"""A real heart's surfaces by the YAML of the page: rims, seams, volumes, views over its beat."""

import json
import os
from pathlib import Path

import pytest
import torch

from racines_data.geometry import Pose
from racines_data.own import OwnPool, from_mesh
from racines_data.patients.labels import LABELS
from racines_data.views import VIEWS
from tests.conftest import ROOT
from tests.documents import blocks

pytest.importorskip("trimesh", reason="needs racines[anatomy]")
BIVME = Path(os.environ.get("RACINES_REAL", ROOT / ".." / "shared" / "real")) / "bivme"
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(
        not BIVME.is_dir(),
        reason=f"REAL HEART ABSENT from {BIVME}: set RACINES_REAL to the folder above it",
    ),
]


@pytest.fixture(scope="module")
def heart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the phantom of `docs/own-anatomy.md`."""
    base = tmp_path_factory.mktemp("bivme")
    page = blocks(ROOT / "docs/own-anatomy.md")
    (text,) = (block.text for block in page if block.file == "heart.yaml")
    (base / "heart.yaml").write_text(text)
    from_mesh(BIVME, base / "heart.yaml", base / "heart")
    return base / "heart"


def test_rims_are_capped_and_counted_and_atria_declared(heart: Path):
    told = json.loads((heart / "phantom.json").read_text())
    parts = {part["name"]: part for part in told["parts"]}
    edges = {name: parts[name]["open_edges"] for name in ("LV", "RV", "LV myocardium")}
    assert edges == {"LV": 72, "RV": 232, "LV myocardium": 144}
    assert parts["LV"]["caps"] == {"mitral valve": 48, "aortic valve": 24}
    assert parts["RV"]["caps"] == {"tricuspid valve": 40, "pulmonary valve": 32}
    assert parts["RV"]["seams"] == 232 - 72 and sum(parts["LV myocardium"]["caps"].values()) == 144
    assert set(told["synthetic"]) == {"LA", "LA wall", "RA", "RA wall"}
    assert "LA: the atria were not outlined" in (heart / "README.md").read_text()
    assert told["heart"]["phases"] == 25 and told["heart"]["end_systole"] == 9
    # As `racines study real-heart` measures them by another road: 179 and 72 mL.
    left = told["heart"]["volumes"]["LV"]
    assert max(left) == pytest.approx(179.0, abs=0.5) and min(left) == pytest.approx(72.0, abs=0.5)
    assert told["heart"]["warp"]["vertex_mean_mm"] < 0.5 and min(told["shown"].values()) > 8.0


def test_it_beats_in_the_chests_of_patients_and_shows_two_views(heart: Path):
    pool = OwnPool(str(heart), [10_000], beating=True)
    assert pool.shown == ("A4C", "PSMV")
    assert pool.measures(0).ejection_fraction == pytest.approx(0.59, abs=0.03)
    rows, targets = torch.zeros(1, dtype=torch.int64), pool.targets(torch.zeros(1).long())
    for number, view in enumerate(VIEWS):
        pose = Pose(targets.position[:, number], targets.rotation[:, number])
        seen = pool.judge_beat(pose, rows, (0.0, 0.2, 0.5)).membership[..., number]
        assert bool((seen > 0.9).all() if view in pool.shown else (seen < 0.01).all()), view
    pose = Pose(targets.position[:, 0], targets.rotation[:, 0])
    full, empty = (pool.mask(pose, rows, torch.tensor([[p, 0.0]])) for p in (0.0, 0.35))
    areas = [float((mask == LABELS.index("LV")).sum()) for mask in (full, empty)]
    assert areas[0] > 600 and areas[1] < 0.75 * areas[0]
    found = set(full.unique().tolist())
    assert {LABELS.index(name) for name in ("LV", "LV myocardium", "RV", "LA", "RA")} <= found
