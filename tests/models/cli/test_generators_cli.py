"""`racines train generator`, as a user types it, on phantom frames."""

import json

import pytest
import torch
import yaml
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.store.frames import open_store
from racines_leaderboard.cli.command import app
from racines_models.registry import load_generator
from tests.conftest import command

PARAMS = {
    "seed": 4,
    "generators": {
        "mean-image": {},
        "nearest-pose": {"frames": 50},
        "vae-gan": {
            "width": 2,
            "encoder_width": 2,
            "discriminator_width": 2,
            "training": {"images": 32, "batch_size": 8},
        },
    },
}


@pytest.fixture
def here(workplace, monkeypatch):
    (workplace / "params.yaml").write_text(yaml.safe_dump(PARAMS))
    monkeypatch.chdir(workplace)
    return workplace


def invoke(*words: str) -> dict:
    result = CliRunner().invoke(app, ["train", "generator", *words, "--json"])
    if result.exception:
        raise result.exception
    return json.loads(result.stdout)


@pytest.mark.parametrize("name", ["mean-image", "nearest-pose", "vae-gan"])
def test_each_generator_trains_from_params_and_draws(here, name):
    metrics = invoke(name)
    folder = here / "models/runs" / name
    assert metrics["out"] == f"models/runs/{name}" and metrics["validation"]["n"] > 0
    for file in ("model.safetensors", "config.json", "metrics.json", "samples.png"):
        assert (folder / file).is_file()
    store = open_store(here / "data/racines")
    generator = load_generator(name, folder)
    images = generator.generate(store.parameters[:3], 0)
    assert images.shape == (3, 128, 128) and images.dtype == torch.uint8
    assert generator.card.seed == 4 and generator.card.data["digest"] == store.manifest["digest"]


def test_settings_come_from_the_section_of_the_name(here):
    assert invoke("nearest-pose")["images"] == 50
    assert invoke("vae-gan", "--out", "elsewhere")["images"] == 32
    config = json.loads((here / "elsewhere/config.json").read_text())
    assert config["config"]["width"] == 2 and config["seed"] == 4
    assert invoke("mean-image", "--seed", "7")["generator"] == "mean-image"
    assert json.loads((here / "models/runs/mean-image/config.json").read_text())["seed"] == 7


def test_refusals_name_the_remedy(here):
    def refused(*words: str) -> str:
        with pytest.raises(RacinesError) as caught:
            invoke(*words)
        return str(caught.value)

    assert "mean-image, nearest-pose, " in refused("vae-gam")
    assert "use --fresh" in refused("vae-gan", "--resume")
    assert "racines data build" in refused("mean-image", "--data", "nowhere")
    (here / "params.yaml").write_text("generators: {vae-gan: {colour: 3}}")
    assert "generators.vae-gan.colour: unknown key" in refused("vae-gan")
    (here / "params.yaml").write_text("generators: {vae-gan: {training: {images: many}}}")
    assert "generators.vae-gan.training.images" in refused("vae-gan")


def test_class_in_the_current_folder_and_exit_code(here):
    source = (
        "from racines_models.generators.mean_image import MeanImage\n"
        "class Mine(MeanImage):\n    name = 'mine'\n"
    )
    (here / "mine.py").write_text(source)
    done = command(here, "racines", "train", "generator", "mine:Mine")
    assert "models/runs/mine: images" in done.stdout and "PSNR" in done.stdout
    assert (here / "models/runs/mine/model.safetensors").is_file()
    done = command(here, "racines", "train", "generator", "mine:Yours", code=1)
    assert "mine has no 'Yours'" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.usefixtures("warm_workers")
def test_several_are_a_set_two_at_a_time_and_one_goes_on_after_a_refusal(here):
    (here / "runs").mkdir()
    (here / "runs/vae-gan").touch()  # where a folder has to be
    words = ("*", "--out", "runs", "--workers", "2", "--device", "cpu")
    done = CliRunner().invoke(app, ["train", "generator", *words])
    assert isinstance(done.exception, RacinesError), "told in one line, without a traceback"
    assert "1 of 3 trainings were refused: runs/vae-gan: " in str(done.exception)
    assert "runs/mean-image: seed 4 done (" in done.stderr
    before = (here / "runs/nearest-pose/model.safetensors").stat()
    (here / "runs/vae-gan").unlink()
    told = invoke("*", "--out", "runs", "--device", "cpu")["trained"]
    assert [*told] == ["runs/mean-image", "runs/nearest-pose", "runs/vae-gan"]
    assert told["runs/nearest-pose"]["images"] == 50
    assert (here / "runs/nearest-pose/model.safetensors").stat() == before, "it was done"
    assert load_generator("vae-gan", here / "runs/vae-gan").card.seed == 4


def test_a_pattern_of_nothing_and_several_in_shared_processes_are_refused(here):
    with pytest.raises(
        RacinesError, match=r"flow\*: matches nothing of generators: it has mean-im"
    ):
        invoke("mean-image", "flow*")
    with pytest.raises(RacinesError, match="--processes: one generator, here"):
        invoke("*", "--processes", "2")


@pytest.mark.slow
@pytest.mark.thorough
def test_two_processes_share_the_work(here):
    words = ("train", "generator", "vae-gan", "--processes", "2", "--device", "cpu", "--json")
    done = command(here, "racines", *words)
    metrics = json.loads(done.stdout)
    assert (metrics["processes"], metrics["images"]) == (2, 32)
    assert (here / "models/runs/vae-gan/model.safetensors").is_file()


@pytest.mark.usefixtures("warm_workers")
def test_what_cannot_be_shared_is_refused(here):
    with pytest.raises(RacinesError, match="8 images cannot be shared by 3 processes"):
        invoke("vae-gan", "--processes", "3", "--device", "cpu")
