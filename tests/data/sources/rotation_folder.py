"""Folders of posed rotations about the apex that nobody's scanner made: a sector, a moving ring."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

SIDE, TURNS, PHASES = 48, 24, 3
APEX = np.array([24.0, 25.0, -1.0])


def pose(degrees: float, lean: float = 0.0, side: float = SIDE) -> np.ndarray:
    """Return the (4, 4) pose, pixels, of an image turned about the apex, depth along the z axis.

    Columns are image x, image y (depth) and the plane's normal; `lean` tilts the beam, degrees.
    """
    turn, tilt = np.radians(degrees), np.radians(lean)
    across = np.array([np.cos(turn), np.sin(turn), 0.0])
    beside = np.array([-np.sin(turn), np.cos(turn), 0.0])
    depth = np.cos(tilt) * np.array([0.0, 0.0, 1.0]) + np.sin(tilt) * beside
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([across, depth, np.cross(across, depth)], -1)
    matrix[:3, 3] = APEX - matrix[:3, :3] @ np.array([side / 2, 0.0, side / 2])
    return matrix


def picture(degrees: float, phase: float, width: int = SIDE, height: int = SIDE) -> np.ndarray:
    """Return the (height, width) uint8 image of a ring that turns into an ellipse and beats."""
    rows, columns = np.mgrid[:height, :width].astype(float)
    x, y = (columns - (width - 1) / 2) / width, rows / height
    turn = np.radians(2 * degrees)
    wide = 0.16 + 0.05 * np.cos(turn) + 0.04 * np.cos(2 * np.pi * phase)
    reach = np.hypot((x - 0.05 * np.cos(turn / 2)) / wide, (y - 0.55) / 0.3)
    noise = np.random.default_rng(int(1000 * degrees + 10 * phase)).normal(0, 12, x.shape)
    echo = 40 + 190 * np.exp(-(((reach - 1) / 0.2) ** 2)) + noise
    fan = (np.abs(x) <= y * 0.6 + 0.02) & (np.hypot(x, y) < 0.98)
    return np.where(fan, echo.clip(1, 255), 0).astype(np.uint8)


def degrees_of(turns: int = TURNS, spread: float = 360.0) -> np.ndarray:
    """Return (turns,) angles that cluster: each third one is close to the one before."""
    steps = np.where(np.arange(turns) % 3 == 2, 0.3, 1.35)
    return np.cumsum(steps) / steps.sum() * spread


def frames_of(at: np.ndarray, phases: int = PHASES) -> list[dict]:
    """Return the entries of turns at some angles, as in the file of poses."""
    made = []
    for turn, degrees in enumerate(at):
        matrix = pose(float(degrees), lean=2.0 * np.sin(turn))[:3].tolist()
        for phase in range(phases):
            name = f"./somewhere/else/{turn * phases + phase:04d}.png"
            made.append({"file_path": name, "transform_matrix": matrix})
    return made


def write_rotation(
    folder: Path,
    turns: int = TURNS,
    phases: int = PHASES,
    size: tuple[int, int] = (SIDE, SIDE),
    content: dict | None = None,
    name: str = "transforms_train.json",
) -> Path:
    """Write a recording; `content` replaces keys of the file of poses."""
    at = degrees_of(turns)
    (folder / "images").mkdir(parents=True)
    for turn, degrees in enumerate(at):
        for phase in range(phases):
            image = picture(float(degrees), phase / phases, *size)
            path = folder / "images" / f"{turn * phases + phase:04d}.png"
            Image.fromarray(image).save(path, compress_level=1)
    write_content(folder, {"frames": frames_of(at, phases)} | (content or {}), name)
    return folder


def write_content(folder: Path, content: dict, name: str = "transforms_train.json") -> None:
    """Write the file of poses."""
    (folder / name).write_text(json.dumps(content))


def content_of(folder: Path, name: str = "transforms_train.json") -> dict:
    """Return the file of poses."""
    return json.loads((folder / name).read_text())
