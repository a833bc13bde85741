"""One small heart of four phases for all tests of hearts of one's own."""

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def small_heart(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a phantom of `organs.HEART`."""
    pytest.importorskip("trimesh", reason="needs racines[anatomy]")
    from racines_data.own import from_mesh
    from tests.data.own import organs

    base = tmp_path_factory.mktemp("small")
    sheet = organs.write_sheet(base / "heart.yaml", organs.HEART)
    from_mesh(organs.write_heart(base / "meshes"), sheet, base / "small-heart")
    return base / "small-heart"
