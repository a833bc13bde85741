"""From surfaces or a label map and a tissues.yaml to a phantom's folder, whole or not at all."""

import math
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor

from racines_data.errors import RacinesError
from racines_data.files import locked_place, sha256_file, swap_folder, write_atomic, write_json
from racines_data.geometry import Pose
from racines_data.own import warp as motion
from racines_data.own.card import card_of
from racines_data.own.marks import check_span, heart_turn, marks_of, place_of, places
from racines_data.own.meshes import Surface, read_surfaces, told_of
from racines_data.own.nifti import read_labels
from racines_data.own.sheet import Sheet, read_sheet
from racines_data.own.voxels import Grid, grid_about, paint, volume
from racines_data.patients.labels import LABELS
from racines_data.patients.volume import BOX, LOW, VOXEL
from racines_data.phantom.config import PhantomConfig
from racines_data.phantom.model import workspace_of
from racines_data.phantom.saved import CARD, SCHEMA, TENSORS, TOLD, digest_of
from racines_data.views import ANATOMIES, VIEWS
from racines_data.world import Workspace

MARGIN = 3.0
"""About the meshes in the grid, mm."""
STANDING = np.column_stack([np.eye(3), np.zeros(3)])
"""The map to an organ's frame where that is the file's."""


class _Painted(NamedTuple):
    """An organ on its grid."""

    labels: np.ndarray  # (X, Y, Z) uint8
    grid: Grid
    affine: np.ndarray  # (3, 4) from an index to mm of the organ's frame
    turn: np.ndarray  # (3, 4) from the file's frame to the organ's
    surfaces: dict[str, Surface]


def from_mesh(folder: Path, tissues: Path, out: Path) -> dict[str, Any]:
    """Make a phantom of a folder of surfaces; return what its `phantom.json` tells.

    Raises:
        RacinesError: what the readers, the YAML, the place or a view refuse; nothing is written.
    """
    if not folder.is_dir():
        raise RacinesError(
            f"{folder}: no such folder: name one with the meshes that {tissues} names"
        )
    sheet = _checked(tissues, out)
    if labelled := [name for name, part in sheet.parts.items() if part.label]:
        raise sheet.refuse(f"parts.{labelled[0]}.label", "a folder of meshes has no labels")
    surfaces = read_surfaces(folder, sheet)
    if not surfaces:
        raise sheet.refuse("parts", "no mesh among them")
    points = np.concatenate([each.vertices[0] for each in surfaces.values()])
    check_span(points, sheet, str(folder))
    turn, grid = STANDING, grid_about(points, sheet.head.voxel, MARGIN)
    if sheet.heart is not None:
        turn = heart_turn(sheet, places(sheet, surfaces, {}))
        grid = Grid(np.array(LOW) + np.array(VOXEL) / 2.0, np.array(VOXEL), (BOX, BOX, BOX))
        _check_box(sheet, points @ turn[:, :3].T + turn[:, 3])
    elif any(len(each.files) > 1 for each in surfaces.values()):
        raise sheet.refuse(
            "parts",
            "files of several phases, and no section heart: what moves is a heart among the "
            "patients; else name the file of one phase",
        )
    labels = paint(sheet, grid, surfaces, turn, None)
    return _write(sheet, _Painted(labels, grid, grid.affine, turn, surfaces), out, "from-mesh")


def from_labels(path: Path, tissues: Path, out: Path) -> dict[str, Any]:
    """Make a phantom of a label map; return what its `phantom.json` tells.

    Raises:
        RacinesError: as of `from_mesh`.
    """
    sheet = _checked(tissues, out)
    if sheet.heart is not None:
        raise sheet.refuse(
            "heart", "a label map has no phases: hearts that beat are made of meshes"
        )
    if meshed := [name for name, part in sheet.parts.items() if part.mesh]:
        raise sheet.refuse(f"parts.{meshed[0]}.mesh", "a label map has no meshes: name a label")
    found = read_labels(path, sheet)
    # Shapes of no file are painted along the map's own axes, as long as these are at right angles.
    edges = np.linalg.norm(found.affine[:, :3], axis=0)
    turn = np.column_stack([found.affine[:, :3] / edges, found.affine[:, 3]])
    grid = Grid(np.zeros(3), edges, found.labels.shape)
    there = np.argwhere(found.labels)
    if not len(there):
        raise RacinesError(f"{path}: no voxel has a label")
    check_span(there * edges, sheet, str(path))
    inverse = turn[:, :3].T
    labels = found.labels
    if any(part.shell or part.ellipsoid for part in sheet.parts.values()):
        if np.abs(turn[:, :3].T @ turn[:, :3] - np.eye(3)).max() > 1e-3:
            raise RacinesError(f"{path}: its axes are not at right angles, which shells and "
                               "ellipsoids need: resample it")  # fmt: skip
        back = np.column_stack([inverse, -inverse @ turn[:, 3]])
        labels = paint(sheet, grid, {}, back, labels)
    return _write(sheet, _Painted(labels, grid, found.affine, STANDING, {}), out, "from-labels")


def _checked(tissues: Path, out: Path) -> Sheet:
    """Read the YAML, and refuse a name that is taken or a folder that is something else."""
    sheet = read_sheet(tissues)
    if sheet.head.name in ANATOMIES.names():
        raise sheet.refuse("name", f"{sheet.head.name!r} is a built-in anatomy's: choose another")
    if out.exists() and not (out / TOLD).is_file():
        raise RacinesError(f"{out}: is there and is no phantom: name another folder with --out")
    return sheet


def _check_box(sheet: Sheet, points: np.ndarray) -> None:
    low, high = np.array(LOW), np.array(LOW) + BOX * np.array(VOXEL)
    if (points < low + 2.0).any() or (points > high - 2.0).any():
        told = " to ".join(
            str(np.round(each).astype(int).tolist()) for each in (points.min(0), points.max(0))
        )
        box = " to ".join(str(np.round(each).astype(int).tolist()) for each in (low, high))
        raise sheet.refuse(
            "heart",
            f"reaches from {told} mm in a heart's frame, and hearts are held from {box}: check "
            "units and landmarks",
        )


def _write(sheet: Sheet, painted: _Painted, out: Path, made_by: str) -> dict[str, Any]:
    """Measure, check the views, and put the folder in its place."""
    told, tensors = _told(sheet, painted, made_by)
    out.parent.mkdir(parents=True, exist_ok=True)
    with locked_place(out):
        aside = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
        try:
            aside.chmod(0o755)
            write_atomic(aside / TENSORS, save(tensors))
            told["tensors"] = {"file": TENSORS, "sha256": sha256_file(aside / TENSORS)}
            told["digest"] = digest_of(told)
            write_json(aside / TOLD, told)
            told["shown"] = _check_views(sheet, aside, told)
            told["digest"] = digest_of(told)
            write_json(aside / TOLD, told)
            write_atomic(aside / CARD, card_of(told))
            swap_folder(aside, out)
        except BaseException:
            shutil.rmtree(aside, ignore_errors=True)
            raise
    return told


def _told(
    sheet: Sheet, painted: _Painted, made_by: str
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Return what the phantom's files hold."""
    labels, grid, affine, turn, surfaces = painted
    names = list(sheet.parts)
    middles, parts = {}, []
    tissues = [sheet.head.around, *dict.fromkeys(part.tissue for part in sheet.parts.values())]
    for number, (name, part) in enumerate(sheet.parts.items(), 1):
        filled = volume(labels, number, grid)
        if filled == 0.0:
            raise sheet.refuse(
                f"parts.{name}", "fills no voxel: look at its place, and what covers it"
            )
        index = np.argwhere(labels == number).mean(0)
        place = affine[:, :3] @ index + affine[:, 3]
        middles[name] = turn[:, :3].T @ (place - turn[:, 3])
        one = {"name": name, "tissue": tissues.index(part.tissue, 1), "ml": round(filled, 3)}
        one |= {"synthetic": part.synthetic}
        one |= {"structure": LABELS.index(part.structure or name)} if sheet.heart else {}
        parts.append(one | (dict(told_of(surfaces[name])) if name in surfaces else {}))
    marks = marks_of(sheet, places(sheet, surfaces, middles), turn)
    index = np.argwhere(labels)
    place = place_of(sheet, index @ affine[:, :3].T + affine[:, 3], marks)
    inverse = np.linalg.inv(np.vstack([affine, (0.0, 0.0, 0.0, 1.0)]))[:3]
    head = sheet.head
    told = {
        "schema": SCHEMA, "name": head.name, "title": head.title, "source": head.source,
        "licence": head.licence, "made_by": made_by,
        "synthetic": {n: p.synthetic for n, p in sheet.parts.items() if p.synthetic},
        "tissues": [asdict(sheet.tissues[name]) for name in tissues],
        "parts": parts,
        "structures": [[s.name, list(s.centre), s.radius] for s in marks.structures],
        "views": [asdict(view) for view in marks.views],
        "place": place,
        "grid": {"to_index": inverse.tolist(), "mm": affine.tolist()},
        "heart": None,
    }  # fmt: skip
    tensors = {"labels": torch.from_numpy(np.ascontiguousarray(labels))}
    if sheet.heart is not None:
        told["heart"], further = _heart(sheet, painted, names)
        tensors |= further
    return told, tensors


def _heart(
    sheet: Sheet, painted: _Painted, names: list[str]
) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Return what there is to know of how a heart moves, and the tensors of it."""
    if foreign := [name for name in sheet.views if name not in VIEWS]:
        known = ", ".join(VIEWS)
        raise sheet.refuse(
            f"views.{foreign[0]}", f"a heart's views are those of the patients: {known}"
        )
    size = BOX * np.array(VOXEL)
    moving = {name: each for name, each in painted.surfaces.items() if len(each.files) > 1}
    phases = max(len(each.files) for each in painted.surfaces.values())
    found = motion.fit(moving, painted.turn, np.array(LOW), size) if moving else None
    volumes = {
        name: [round(each, 3) for each in _volumes(surface)]
        for name, surface in painted.surfaces.items()
    }
    cavity = next(
        (n for n, p in sheet.parts.items() if (p.structure or n) == "LV" and n in volumes), ""
    )
    if not cavity:
        raise sheet.refuse(
            "parts", "no mesh of a part whose structure is LV: its phases tell the beat"
        )
    told: dict[str, Any] = {
        "phases": phases,
        "end_systole": int(np.argmin(volumes[cavity])),
        "volumes": volumes,
        "warp": None,
    }
    if found is None:
        return told, {}
    told["warp"] = {
        "low": list(found.warp.low), "vertex_mean_mm": round(found.mean, 3),
        "vertex_p95_mm": round(found.p95, 3), "jacobian_least": round(found.jacobian, 3),
    }  # fmt: skip
    return told, {"back": found.warp.back.contiguous()}


def _volumes(surface: Surface) -> list[float]:
    """Return what a closed surface encloses in each phase, mL, by the divergence theorem."""
    a, b, c = np.moveaxis(surface.vertices[:, surface.faces], 2, 0)
    return np.abs(np.einsum("pfi,pfi->p", a, np.cross(b, c)) / 6e3).tolist()


def _outside(space: Workspace, poses: Pose, row: int) -> str:
    """Return in words which limit of the workspace a pose breaks, and what to change."""
    rotation, position = poses.rotation[row], poses.position[row]
    lean = math.acos(max(-1.0, min(1.0, -float(rotation[2, 2]))))
    turn = abs(math.atan2(float(rotation[1, 0]), float(rotation[0, 0])))
    if lean > space.tilt_max:
        told = f"lean by {math.degrees(lean):.0f}° (at most {math.degrees(space.tilt_max):.0f})"
        return f"its probe would {told}: turn the organ with place"
    if turn > space.yaw_max:
        told = f"be turned by {math.degrees(turn):.0f}° (at most {math.degrees(space.yaw_max):.0f})"
        return f"its probe would {told} about its beam: name another right, or turn the organ"
    told = ", ".join(f"{1e3 * x:.0f}" for x in position.tolist())
    return f"its probe would stand at ({told}) mm, outside the workspace: move the organ with place"


def _check_views(sheet: Sheet, folder: Path, told: dict[str, Any]) -> dict[str, float]:
    """Return the grade of each view at its nominal pose in the block.

    Raises:
        RacinesError: a view that is not seen there, or a pose that the probe may not take.
    """
    from racines_data.phantom.anatomy import load_anatomy
    from racines_data.phantom.truth import coupling, make_oracle

    config = PhantomConfig()
    anatomy = load_anatomy(str(folder), 0)
    surface = config.block.maximum[2]
    oracle = make_oracle(anatomy, surface, torch.device("cpu"))
    truth = oracle.judge(
        oracle.targets, config.probe, coupling(oracle.targets, surface, config.probe)
    )
    space = workspace_of(config.workspace, config.block, torch.device("cpu"))
    names = [each[0] for each in told["structures"]]
    for row, (name, view) in enumerate(sheet.views.items()):
        where = f"views.{name}"
        if not bool(space.contains(oracle.targets)[row]):
            raise sheet.refuse(where, _outside(space, oracle.targets, row))
        if float(truth.membership[row, row]) <= 0.5:
            seen = {n: float(truth.visibility[row, names.index(n)]) for n in view.shows}
            worst = ", ".join(
                f"{n} {v:.2f}" for n, v in sorted(seen.items(), key=lambda p: p[1])[:3]
            )
            raise sheet.refuse(where, "its own plane does not show it; least seen, of 1: "
                               f"{worst}: move plane, landmarks or organ")  # fmt: skip
    grades = truth.view_grade.diagonal().tolist()
    return {name: round(grade, 2) for name, grade in zip(sheet.views, grades, strict=True)}
