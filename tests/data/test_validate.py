import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from typer.testing import CliRunner

from racines_data import RacinesError
from racines_data.cli import data
from racines_data.files import sha256_file
from racines_data.load import read_manifest
from racines_data.validate import Check, validate


@pytest.fixture
def copy(built: Path, tmp_path: Path) -> Path:
    shutil.copytree(built, tmp_path / "racines")
    return tmp_path / "racines"


def broken(root: Path) -> dict[str, str]:
    return {check.name: check.detail for check in validate(root).checks if not check.ok}


def reseal(root: Path, **changes) -> None:
    """Write a manifest that fits the files as they are: only deeper checks can object."""
    manifest = read_manifest(root) | changes
    for name, record in manifest["files"].items():
        record |= {"sha256": sha256_file(root / name), "bytes": (root / name).stat().st_size}
    (root / "manifest.json").write_text(json.dumps(manifest))


def test_a_good_dataset_has_no_faults_and_twelve_statistics(built: Path):
    result = validate(built)
    assert result.ok and len(result.checks) == 6 and len(result.statistics) == 12
    assert abs(result.statistics["position_x"].mean) < 0.3
    assert 0.8 < result.statistics["position_x"].std < 1.2


def test_altered_bytes(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["train"][0]
    content = bytearray(shard.read_bytes())
    content[3000] ^= 1
    shard.write_bytes(bytes(content))
    assert "sha256 differs" in broken(copy)["files"]


def test_altered_rows_under_a_new_seal(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["test"][0]
    table = pq.read_table(shard)
    index = table.schema.get_field_index("position_x")
    altered = pa.array([0.5] * len(table), pa.float32())
    table = table.set_column(index, table.schema.field(index), altered)
    pq.write_table(table, shard)
    reseal(copy)
    assert set(broken(copy)) == {"rows", "store"}
    assert "content digest" in broken(copy)["rows"]


def test_a_trajectory_in_two_splits(copy: Path):
    configs = read_manifest(copy)["configs"]
    train, test = (copy / configs["frames"][split][0] for split in ("train", "test"))
    shutil.copy(train, test)
    reseal(copy)
    assert "is in test and in train" in broken(copy)["splits"]


def test_another_schema(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["test"][0]
    pq.write_table(pq.read_table(shard).drop_columns("grade"), shard)
    reseal(copy)
    assert "columns differ from the schema" in broken(copy)["rows"]


def test_out_of_range(copy: Path):
    shard = copy / read_manifest(copy)["configs"]["frames"]["test"][0]
    table = pq.read_table(shard)
    index = table.schema.get_field_index("position_z")
    altered = pa.array([60.2] * len(table), pa.float32())
    pq.write_table(table.set_column(index, table.schema.field(index), altered), shard)
    reseal(copy)
    assert "position_z exceeds ±10" in broken(copy)["rows"]


def test_wrong_counts_and_recipe(copy: Path):
    manifest = read_manifest(copy)
    manifest["counts"]["splits"]["train"]["frames"] += 1
    reseal(copy, counts=manifest["counts"], recipe={**manifest["recipe"], "format": 99})
    assert set(broken(copy)) == {"rows", "recipe"}


def test_card_of_another_dataset(copy: Path):
    card = copy / "README.md"
    card.write_text(card.read_text().replace(read_manifest(copy)["digest"], "0" * 64))
    reseal(copy)
    assert "card" in broken(copy)


def alter_canonical(root: Path, levels: int) -> None:
    path = root / "canonical" / "SC.png"
    image = np.asarray(Image.open(path)).astype(int)
    image[5, 5] += levels if image[5, 5] < 128 else -levels
    Image.fromarray(image.astype(np.uint8)).save(path)
    reseal(root, digest="0" * 64)


def test_the_same_version_on_another_processor(built: Path, copy: Path):
    def verdict() -> Check:
        return validate(built, against=copy).checks[-1]

    assert verdict() == Check("same version", True, "equal, byte for byte")
    alter_canonical(copy, 1)
    assert verdict().ok and "by 1 gray level at most" in verdict().detail
    alter_canonical(copy, 2)
    assert not verdict().ok and "differ by" in verdict().detail
    reseal(copy, recipe_digest="1" * 64)
    assert not verdict().ok and "recipe_digest is" in verdict().detail


def test_command(built: Path, copy: Path):
    run = CliRunner().invoke
    done = run(data, ["validate", str(built)])
    assert done.exit_code == 0 and "BROKEN" not in done.output
    assert "position_x" in done.output and "0.4886" in done.output
    report = json.loads(run(data, ["validate", str(built), "--json"]).output)
    assert report["ok"] and report["statistics"]["force_z"]["paper"]["mean"] == -9.4422
    (copy / "canonical" / "SC.png").unlink()
    done = run(data, ["validate", str(copy)])
    assert done.exit_code == 1 and "canonical/SC.png is missing" in done.output
    assert isinstance(run(data, ["validate", str(copy / "none")]).exception, RacinesError)


def test_build_command_refuses_bad_requests(tmp_path: Path):
    params = tmp_path / "params.yaml"
    params.write_text("data: {frames: 10, workers: 1}\n")
    options = ["build", "--params", str(params), "--out", str(tmp_path / "out")]

    def refusal(*words: str) -> str:
        return str(CliRunner().invoke(data, [*options, *words]).exception)

    assert "unknown source 'nothing'" in refusal("--source", "nothing")
    assert "name its files" in refusal("--source", "tracked")
    assert "--frames: source tracked has" in refusal("--source", "tracked", "--frames", "5")
    params.write_text("data: {framse: 10}\n")
    assert "data.framse: unknown key" in refusal()
    assert CliRunner().invoke(data, ["build", "--no-such"]).exit_code == 2


def test_build_command(tmp_path: Path):
    params = tmp_path / "params.yaml"
    source = "tests.data.fake_source:FakeSource"
    params.write_text(f"data: {{source: '{source}', frames: 30, workers: 1, seed: 4}}\n")
    options = ["build", "--params", str(params), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(data, [*options, "--json"])
    assert done.exit_code == 0, done.exception
    figures = json.loads(done.stdout)
    assert figures["counts"]["frames"] == 30 and len(figures["digest"]) == 64
    again = CliRunner().invoke(data, options)
    assert figures["digest"] in again.output
