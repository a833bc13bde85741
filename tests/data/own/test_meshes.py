"""Surfaces that become a phantom: volumes, caps, formats, and what is refused."""

import copy
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from racines_data.errors import RacinesError
from racines_data.own import from_mesh
from racines_data.own.voxels import grid_about, inside
from racines_data.phantom import PhantomConfig
from racines_data.phantom.anatomy import load_anatomy
from racines_data.phantom.saved import find_saved, provenance, read_saved
from racines_envs.worlds.making import phantom_recipe

trimesh = pytest.importorskip("trimesh", reason="needs racines[anatomy]")
pytest.importorskip("meshio", reason="needs racines[anatomy]")
organs = pytest.importorskip("tests.data.own.organs")


@pytest.fixture(scope="module")
def cup(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a phantom of `CUP`."""
    base = tmp_path_factory.mktemp("cup")
    sheet = organs.write_sheet(base / "cup.yaml", organs.CUP)
    from_mesh(organs.write_cup(base / "meshes"), sheet, base / "cup")
    return base / "cup"


@pytest.mark.parametrize("shape", ["sphere", "box", "torus"])
def test_voxels_fill_what_the_surface_encloses(shape: str):
    mesh = {
        "sphere": lambda: trimesh.creation.icosphere(3, 20.0),
        "box": lambda: trimesh.creation.box((31.0, 22.0, 40.0)),
        "torus": lambda: trimesh.creation.torus(20.0, 7.0),
    }[shape]()
    mesh.apply_translation((3.3, -2.0, 5.0))
    points, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    grid = grid_about(points, 1.0, 3.0)
    filled = inside(points, faces, grid)
    assert filled.sum() == pytest.approx(mesh.volume, rel=0.01)
    turned = inside(points, faces[:, ::-1], grid)  # whichever way the faces look
    assert np.array_equal(filled, turned)
    both = inside(np.tile(points, (2, 1)), np.concatenate([faces, faces + len(points)]), grid)
    assert np.array_equal(filled, both)  # sheets that overlap do no harm


def test_rims_are_closed_and_counted(cup: Path):
    told = json.loads((cup / "phantom.json").read_text())
    wall, fluid = told["parts"]
    assert list(fluid["caps"]) == ["mouth"] and fluid["caps"]["mouth"] == fluid["open_edges"] > 20
    assert wall["caps"] == {} and wall["open_edges"] == 0
    mesh = trimesh.load(cup.parent / "meshes/inner.obj")
    assert not mesh.is_watertight
    sphere = 4.0 / 3.0 * np.pi * 15.0**3 / 1e3
    cut = np.pi * 6.0**2 * (15.0 - 2.0) / 1e3  # of the cap above z = 9
    assert fluid["ml"] == pytest.approx(sphere - cut, rel=0.04)
    assert told["shown"]["CUP"] > 9.0 and told["synthetic"] == {}
    card = (cup / "README.md").read_text()
    assert f"mouth ({fluid['caps']['mouth']} edges)" in card and "not a medical device" in card


def test_a_shell_is_as_thick_as_it_says(tmp_path: Path):
    values = copy.deepcopy(organs.CUP)
    values["parts"]["coat"] = {
        "shell": ["wall", "fluid"],
        "thickness": 3.0,
        "tissue": "capsule",
        "synthetic": "a test",
    }
    sheet = organs.write_sheet(tmp_path / "cup.yaml", values)
    told = from_mesh(organs.write_cup(tmp_path / "meshes"), sheet, tmp_path / "out")
    ball = 4.0 / 3.0 * np.pi * (28.0**3 - 25.0**3) / 1e3
    assert told["parts"][2]["ml"] == pytest.approx(ball, rel=0.06)
    assert told["synthetic"] == {"coat": "a test"}
    assert "coat: a test" in (tmp_path / "out/README.md").read_text()


@pytest.mark.parametrize("ending", [".ply", ".stl", ".vtk"])
def test_every_kind_of_file_makes_the_same_organ(cup: Path, tmp_path: Path, ending: str):
    values = json.loads(json.dumps(organs.CUP).replace(".obj", ending))
    sheet = organs.write_sheet(tmp_path / "cup.yaml", values)
    told = from_mesh(organs.write_cup(tmp_path / "meshes", ending), sheet, tmp_path / "out")
    own, other = read_saved(cup), read_saved(tmp_path / "out")
    differ = own.tensors["labels"] != other.tensors["labels"]
    assert float(differ.float().mean()) < 1e-4 and told["shown"] == own.told["shown"]


def test_units_of_the_files_are_those_that_are_said(cup: Path, tmp_path: Path):
    sheet = organs.write_sheet(tmp_path / "cup.yaml", organs.CUP | {"units": "m"})
    meshes = organs.write_cup(tmp_path / "meshes", scale=1e-3)
    told = from_mesh(meshes, sheet, tmp_path / "out")
    assert told["parts"][1]["ml"] == pytest.approx(read_saved(cup).told["parts"][1]["ml"], rel=0.01)


def test_it_is_an_anatomy_by_its_folder_or_its_name(cup: Path, tmp_path: Path, monkeypatch: Any):
    anatomy = load_anatomy(str(cup), 0)
    assert [view.name for view in anatomy.views] == ["CUP"] and anatomy.name == "cup"
    (tmp_path / "data/phantoms").mkdir(parents=True)
    (tmp_path / "data/phantoms/cup").symlink_to(cup)
    monkeypatch.chdir(tmp_path)
    assert find_saved("cup") == Path("data/phantoms/cup") and find_saved("heart") is None
    assert load_anatomy("cup", 0).axes == anatomy.axes
    with pytest.raises(RacinesError, match="one organ, anatomy_seed is 1: give 0"):
        load_anatomy("cup", 1)
    with pytest.raises(RacinesError, match="no folder of a phantom"):
        load_anatomy("absent/cup", 0)


def test_a_folder_that_was_changed_is_refused(cup: Path, tmp_path: Path):
    told = json.loads((cup / "phantom.json").read_text())
    (tmp_path / "phantom.json").write_text(json.dumps(told | {"licence": "mine"}))
    with pytest.raises(RacinesError, match="changed after it was made"):
        read_saved(tmp_path)
    (tmp_path / "phantom.json").write_text(json.dumps(told))
    with pytest.raises(RacinesError, match=r"phantom\.safetensors: is not the file"):
        read_saved(tmp_path)


def _changed(at: str, value: Any) -> dict[str, Any]:
    values = copy.deepcopy(organs.CUP)
    *path, last = at.split(".")
    node = values
    for name in path:
        node = node[name]
    node[last] = value
    return values


REFUSED = {
    "open where no cap was asked for": (
        "parts.fluid",
        {"mesh": "inner.obj", "tissue": "bile"},
        r"inner\.obj: open at \d+ rim edges on 1 "
        r"rims .* no cap is asked for: close it, or name its rims",
    ),
    "more caps than rims": ("parts.fluid.cap", ["mouth", "b"], "on 1 rims .* cap names 2"),
    "a rim that no cap names": (
        "parts.fluid.cap",
        ["a"],
        r"landmarks\.mouth\.rim: 'mouth' is no rim that",
    ),
    "a cap on a closed surface": ("parts.wall.cap", ["a"], r"outer\.obj: .*closed.* leave out cap"),
    "an unknown tissue": (
        "parts.wall.tissue",
        "cheese",
        r"cup\.yaml: parts\.wall\.tissue: unknown tissue "
        "'cheese': one of bile, blood",
    ),
    "a view whose landmark is missing": (
        "views.CUP.focus",
        "nowhere",
        r"views\.CUP\.focus: 'nowhere' is no "
        "landmark: middle, mouth, side",
    ),
    "metres by mistake": (
        "units",
        "m",
        r"spans 50000 mm with units: m, .*looks like mm: set units: mm",
    ),
    "an unknown key": ("colour", "red", "colour: unknown key; known: around, licence"),
    "a wrong type": ("parts.wall.cap", "mouth", r"parts\.wall\.cap: 'mouth' is str"),
    "a mesh that is not there": (
        "parts.wall.mesh",
        "other.obj",
        r"parts\.wall\.mesh: .*other\.obj: no such",
    ),
    "a file outside": ("parts.wall.mesh", "../outer.obj", "name a file in the folder"),
    "a kind of file": ("parts.wall.mesh", "notes.txt", "is no kind of mesh: give one of .obj"),
    "no triangles": (
        "parts.wall.mesh",
        "empty.obj",
        r"empty\.obj: (cannot be read|no finite triangles)",
    ),
    "no shape": ("parts.wall", {"tissue": "liver"}, "has no shape: give one of mesh, label"),
    "an ellipsoid that says not why": (
        "parts.extra",
        {"tissue": "bile", "ellipsoid": {"at": [0, 0, 0], "radii": [3, 3, 3]}},
        r"parts\.extra\.synthetic: .*say why",
    ),
    "a name that is taken": ("name", "abdomen", "is a built-in anatomy's: choose another"),
    "no plane": ("views.CUP.right", "middle", r"views\.CUP: beam and right lie on one line"),
    "out of its own plane": (
        "landmarks.side.at",
        [0.0, 90.0, 0.0],
        r"own plane does not show it|"
        "beam and right",
    ),
    "leaning too far": (
        "place",
        {"up": [1.0, 0.0, 0.0], "ahead": [0.0, 1.0, 0.0]},
        r"views\.CUP: its probe would lean by \d+° \(at most 57\)",
    ),
    "turned too far": (
        "place",
        {"ahead": [-1.0, 0.0, 0.0]},
        r"views\.CUP: its probe would be turned by 180° \(at most 143\) about its beam: name",
    ),
    "beside the block": (
        "place",
        {"x": 300.0},
        r"place: \d+ % of the organ lies outside the block",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused_by_name_and_nothing_is_written(case: str, tmp_path: Path):
    at, value, told = REFUSED[case]
    meshes = organs.write_cup(tmp_path / "meshes")
    (meshes / "notes.txt").write_text("no mesh\n")
    (meshes / "empty.obj").write_text("# nothing\n")
    values = _changed(at, value)
    if case == "open where no cap was asked for":
        values["landmarks"]["mouth"] = {"at": [0.0, 0.0, 9.0]}
    sheet = organs.write_sheet(tmp_path / "cup.yaml", values)
    if case == "out of its own plane":  # a landmark that the view shows and does not lie by
        values = _changed("landmarks.off", {"at": [0.0, 24.0, 0.0], "radius": 4})
        values["views"]["CUP"]["shows"] = {"off": 3, "middle": 1}
        organs.write_sheet(sheet, values)
    with pytest.raises(RacinesError, match=told):
        from_mesh(meshes, sheet, tmp_path / "out/cup")
    assert sorted(path.name for path in tmp_path.iterdir()) in (
        ["cup.yaml", "meshes"],
        ["cup.yaml", "meshes", "out"],
    )
    assert not list(tmp_path.glob("out/*")) and not list(tmp_path.glob("out/.cup.*[!k]"))


def test_another_folder_is_not_written_over(tmp_path: Path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.tex").write_text("years of work\n")
    sheet = organs.write_sheet(tmp_path / "cup.yaml", organs.CUP)
    with pytest.raises(RacinesError, match="is there and is no phantom"):
        from_mesh(organs.write_cup(tmp_path / "meshes"), sheet, tmp_path / "mine")
    assert (tmp_path / "mine/thesis.tex").read_text() == "years of work\n"


def test_a_library_that_is_missing_is_named_with_the_remedy(tmp_path: Path, monkeypatch: Any):
    monkeypatch.setitem(__import__("sys").modules, "trimesh", None)
    meshes = organs.write_cup(tmp_path / "meshes")
    with pytest.raises(
        RacinesError, match=r'outer\.obj: a mesh needs trimesh: pip install "racines\[an'
    ):
        from_mesh(meshes, organs.write_sheet(tmp_path / "cup.yaml", organs.CUP), tmp_path / "out")


@pytest.mark.parametrize("pattern", ["outer.obj", "outer_{phase}.obj"])
def test_fifos_and_links_out_of_the_folder_are_not_opened(tmp_path: Path, pattern: str):
    values = _changed("parts.wall.mesh", pattern)
    sheet = organs.write_sheet(tmp_path / "cup.yaml", values)
    meshes = organs.write_cup(tmp_path / "meshes")
    place = meshes / pattern.replace("{phase}", "00")
    (meshes / "outer.obj").rename(tmp_path / "aside.obj")
    place.symlink_to(tmp_path / "aside.obj")
    with pytest.raises(RacinesError, match=r"parts\.wall\.mesh: outer.*: a link out of the folder"):
        from_mesh(meshes, sheet, tmp_path / "out")
    place.unlink()
    os.mkfifo(place)
    with pytest.raises(RacinesError, match=r"parts\.wall\.mesh: outer.*: a FIFO, a socket"):
        from_mesh(meshes, sheet, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_folder_of_a_registered_anatomys_name_is_in_nobodys_way(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = phantom_recipe(PhantomConfig())
    for name in ("heart", "abdomen"):
        Path(name).mkdir()
        assert find_saved(name) is None and provenance(name) is None
    assert phantom_recipe(PhantomConfig()) == before
    with pytest.raises(RacinesError, match=r"anatomy \./heart: no folder of a phantom"):
        find_saved("./heart")
