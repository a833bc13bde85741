"""The gate, through a build and through a plug-in: each mistake in turn is refused and named."""

import dataclasses
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from typer.testing import CliRunner

from racines_data.build.dataset import DataConfig, build, make_multi_phantom, make_source
from racines_data.errors import RacinesError
from racines_data.manifest import read_manifest
from racines_data.sources.base import Unit, labels_of_source
from racines_data.sources.folder import parameters_of
from racines_data.sources.gate import Bounds, bounds_of, check_scales, check_trajectory, scale_of
from racines_data.validate.run import validate
from racines_data.views import organs
from racines_leaderboard.cli.command import app
from tests.data.sources import gate_source
from tests.data.sources.gate_source import MISTAKES, Scans, ScansConfig, made, mirror, sound
from tests.plugins.packages import install

ONE = DataConfig(workers=1, shards=1)
UNIT = Unit("t0", "s1", "A4C", 40)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_build_refuses_each_mistake(tmp_path: Path, mistake: str):
    source = Scans(ScansConfig(mistake))
    message = f"source scans, trajectory t[012]: {MISTAKES[mistake][1]}"
    with pytest.raises(RacinesError, match=message) as caught:
        build(source, tmp_path / "out", ONE)
    assert "\n" not in f"{caught.value}" and not (tmp_path / "out").exists()


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A package of somebody else that registers the source."""
    shutil.copy(gate_source.__file__, tmp_path / "their_scans.py")
    install(tmp_path, "their_scans", {"racines.sources": {"scans": "their_scans:Scans"}})
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("their_scans", None)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_plug_in_is_held_to_the_same(plugin: Path, mistake: str):
    settings = {"workers": 1, "shards": 1, "scans": {"mistake": mistake}}
    (plugin / "params.yaml").write_text(yaml.safe_dump({"data": settings}))
    words = ["data", "build", "--source", "scans", "--out", "out", "--params", "params.yaml"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 1 and not (plugin / "out").exists()
    said = " ".join(f"{done.output} {done.exception}".split())
    assert re.search(f"source scans, trajectory t[012]: {MISTAKES[mistake][1]}", said), said


def test_sound_sweeps_pass_and_their_manifest_has_no_bounds(tmp_path: Path):
    build(Scans(), tmp_path / "out", ONE)
    assert "bounds" not in read_manifest(tmp_path / "out")
    assert validate(tmp_path / "out").ok


def test_an_opinion_can_be_allowed_and_is_told(tmp_path: Path):
    source = Scans(ScansConfig("action for reaction"))
    allowed = dataclasses.replace(ONE, allow=("force-sign",))
    with pytest.raises(RacinesError, match="If it is right as it is: --allow force-sign"):
        build(source, tmp_path / "out", ONE)
    manifest = build(source, tmp_path / "out", allowed)
    assert manifest["bounds"]["allow"] == ["force-sign"]
    assert validate(tmp_path / "out").ok
    with pytest.raises(RacinesError, match="data.allow 'forces': choose of"):
        build(source, tmp_path / "out", dataclasses.replace(ONE, allow=("forces",)))


def test_what_is_certain_cannot_be_allowed(tmp_path: Path):
    from racines_data.sources.gate import OPINIONS

    everything = dataclasses.replace(ONE, allow=OPINIONS)
    for mistake in ("degrees", "millimetres", "backwards", "0-1", "constant", "grams"):
        with pytest.raises(RacinesError, match=MISTAKES[mistake][1]):
            build(Scans(ScansConfig(mistake)), tmp_path / "out", everything)


def test_an_allowed_build_is_not_taken_up_by_a_strict_one(tmp_path: Path):
    class Halting(Scans):
        halt = True

        def produce(self, unit):
            if unit.id == "t2" and self.halt:
                raise KeyboardInterrupt
            return super().produce(unit)

    source = Halting(ScansConfig("action for reaction"))
    with pytest.raises(KeyboardInterrupt):
        build(source, tmp_path / "out", dataclasses.replace(ONE, allow=("force-sign",)))
    Halting.halt = False
    with pytest.raises(RacinesError, match="trajectory t0: sign of force"):
        build(source, tmp_path / "out", ONE)


@pytest.mark.parametrize(
    ("field", "factor", "column"),
    [("position", 0.01, slice(6, 9)), ("force", 20.0, slice(0, 3))],
)
def test_one_trajectory_in_another_unit(field: str, factor: float, column: slice):
    """Each passes by itself; what tells is the others."""
    scales = []
    for number in range(3):
        columns = sound(number)
        parameters = columns["parameters"].copy()
        parameters[:, :3] *= 0.3  # a light hand
        parameters[:, column] *= factor if number == 1 else 1.0
        if field == "force" and number == 1:
            parameters[:, column] *= 2.5
        columns |= {"parameters": parameters, "controls": np.full((40, 6), np.nan, np.float32)}
        unit = Unit(f"t{number}", "s1", "A4C", 40)
        check_trajectory(made(unit, columns), unit, bounds=Bounds(force=1e4))
        scales.append(
            scale_of(unit.id, parameters[:, :6], parameters[:, 6:9], columns["timestamps"])
        )
    with pytest.raises(RacinesError, match=f"source s, trajectory t1: {field}: mixed units"):
        check_scales(scales, "s")
    check_scales(scales, "s", allow=["units-mixed"])
    check_scales(scales[::2], "s")


def test_a_build_holds_trajectories_against_one_another(tmp_path: Path, monkeypatch):
    monkeypatch.setitem(
        MISTAKES, "tiny", (lambda c: gate_source.scaled(slice(6, 9), 0.01)(c) | still(c), "")
    )
    with pytest.raises(RacinesError, match="source scans, trajectory t1: position: mixed units"):
        build(Scans(ScansConfig("tiny", only=1)), tmp_path / "out", ONE)


def still(columns) -> dict[str, np.ndarray]:
    return {"controls": np.full_like(columns["controls"], np.nan)}


@pytest.mark.parametrize("mistake", ["transposed", "mirrored in the probe", "left-handed"])
def test_without_controls_the_sense_of_rotations_cannot_be_told(mistake: str):
    """The page says so: whoever changes this has to change docs/import.md."""
    columns = MISTAKES[mistake][0](sound(0) | still(sound(0)))
    check_trajectory(made(UNIT, columns), UNIT)


def test_controls_that_follow_nothing_are_no_evidence():
    rng = np.random.default_rng(0)
    for number in range(20):
        columns = sound(number)
        columns["controls"] = rng.normal(0, 0.1, columns["controls"].shape).astype(np.float32)
        check_trajectory(made(UNIT, columns), UNIT)


def test_a_path_from_the_origin_has_no_mixed_units():
    columns = sound(0) | still(sound(0))
    parameters = columns["parameters"].copy()
    parameters[:, 6:9] = np.linspace(0, 0.3, 40)[:, None]
    check_trajectory(made(UNIT, columns | {"parameters": parameters}), UNIT)


def test_images_without_a_sector_are_no_evidence():
    columns = sound(0)
    rng = np.random.default_rng(0)
    full = rng.integers(0, 256, (40, 128, 128), np.uint8)
    shadowed = full.copy()  # a linear array above a bone
    shadowed[:, 60:, 20:] = 0
    wide = full.copy()
    wide[:, 90:] = 0
    for images in (full, shadowed, wide):
        check_trajectory(made(UNIT, columns | {"images": images}), UNIT)


def test_matrices_are_checked_before_they_become_angles():
    turned = np.tile(np.eye(4), (5, 1, 1))
    assert parameters_of(turned).shape == (5, 12)
    flipped, twice, quarter = turned.copy(), turned.copy(), turned.copy()
    flipped[3, :3, :3] = mirror(0).numpy()
    twice[2, :3, :3] *= 2.0
    quarter[1, 3, :3], quarter[1, :3, 3] = [0.4, 0.0, 0.1], 0.0
    for matrices, said in (
        (flipped, "reflected rotation: rotation: frame 3: its determinant is -1: left-handed"),
        (twice, "non-orthonormal rotation: rotation: frame 2: .*a rotation times 2; divide"),
        (quarter, "not a rigid pose: rotation: frame 1: .*likely transposed"),
    ):
        with pytest.raises(RacinesError, match=said):
            parameters_of(matrices)


def test_a_source_says_what_is_plausible_of_it(tmp_path: Path):
    class Far(Scans):
        bounds = Bounds(reach=1e3)

        def produce(self, unit):
            columns = gate_source.scaled(slice(6, 9), 1000.0)(sound(int(unit.id[1:])))
            return made(unit, columns | still(columns))

    manifest = build(Far(), tmp_path / "out", ONE)
    assert manifest["bounds"]["reach"] == 1e3 and validate(tmp_path / "out").ok

    class Odd(Scans):
        bounds = {"reach": 3}

    with pytest.raises(RacinesError, match="source scans: its `bounds` are dict; give"):
        bounds_of(Odd())


def _phantoms():
    for organ in organs():
        source = make_source(DataConfig(frames=200), {"phantom": {"anatomy": organ}})
        yield source, source.plan()
    source = make_source(DataConfig(frames=200))
    many = make_multi_phantom(source, DataConfig(), {"hearts": 1, "frames_per_sweep": 12})
    assert many is not None
    yield many, many.plan()


def test_phantoms_of_every_organ_pass():
    torch.set_num_threads(1)
    for source, units in _phantoms():
        for unit in units:
            check_trajectory(source.produce(unit), unit, labels_of_source(source))
