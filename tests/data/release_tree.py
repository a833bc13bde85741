"""A small tree in the published layout for tests, and a reader of it written from its description.

The reader stands for other people's: it uses nothing of this project.
"""

import re
from pathlib import Path

import numpy as np
from PIL import Image

FRAMES = 8


def rotation(rng: np.random.Generator) -> np.ndarray:
    """Return a random proper rotation."""
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.linalg.det(q)


def matrix(rng: np.random.Generator) -> np.ndarray:
    """Return a pose within the robot's reach."""
    pose = np.eye(4)
    pose[:3, :3] = rotation(rng)
    pose[:3, 3] = rng.uniform([0.40, -0.07, 0.04], [0.58, 0.08, 0.13])
    return pose


def log_text(time, wrench, pose, control) -> str:
    """Print a log with NumPy's own printer."""
    wrench, pose, control = np.asarray(wrench), np.asarray(pose), np.asarray(control)
    return (
        f"Time: {time}\nForce and Torque: {wrench.reshape(-1, 1)}\n"
        f"Pose Matrix (ROT):\n{pose}\nControl Effort (CO): {control}\n"
    )


def write_frames(images: Path, logs: Path, seed: int, numbers=range(FRAMES), size=(128, 128)):
    """Write an image folder and its logs."""
    rng = np.random.default_rng(seed)
    images.mkdir(parents=True, exist_ok=True)
    logs.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        pixels = rng.integers(0, 256, size[::-1], np.uint8)
        Image.fromarray(pixels).save(images / f"img{number}.png")
        numbers6 = rng.normal(size=6), matrix(rng), rng.normal(0, 0.01, 6)
        (logs / f"PA_{number}.txt").write_text(log_text(1000.5 + number / 30, *numbers6))


def write_release(root: Path, seed: int = 0) -> Path:
    """Write five image folders of eight frames in three sessions."""
    write_frames(root / "Folder 1/A4C/images", root / "Folder 1/A4C/logs", seed + 1)
    write_frames(root / "Folder 1/SC/images_1", root / "Folder 1/SC/logs_1", 2)
    write_frames(root / "Folder 1/SC/images_2", root / "Folder 1/SC/logs_2", 3)
    write_frames(root / "Folder 2/Full/images", root / "Folder 2/Full/logs", 4)
    write_frames(root / "Folder 3/Full/2/images", root / "Folder 3/Full/2/logs", 5)
    return root


def read_elsewhere(root: Path) -> list[dict]:
    """Read a tree as somebody would who knows the published layout only."""
    frames = []
    for session in ("Folder 1", "Folder 2", "Folder 3"):
        for view in ("A4C", "SC", "PL", "PSAV", "PSMV", "Full"):
            base = root / session / view
            folders = sorted([*base.glob("images*"), *base.glob("[0-9]*/images")])
            for folder in folders:
                logs = folder.parent / folder.name.replace("images", "logs")
                found = sorted(folder.glob("*.png"), key=lambda p: int(p.stem[3:]))
                for path in found:
                    number = int(re.fullmatch(r"img(\d+)\.png", path.name)[1])  # type: ignore
                    frame = _read_log((logs / f"PA_{number}.txt").read_text())
                    frame |= {"session": session, "view": view, "folder": folder.name}
                    frame |= {"number": number, "image": np.asarray(Image.open(path))}
                    frames.append(frame)
    return frames


def _read_log(text: str) -> dict:
    # Each pattern is as narrow as a hurried reader would write it: time without a sign or an
    # exponent, the control effort on one line, arrays between double brackets.
    time = re.search(r"Time:\s*([\d.]+)\s", text)
    force = re.search(r"Force and Torque: \[\[(.*?)\]\]", text, re.DOTALL)
    pose = re.search(r"Pose Matrix \(ROT\):\n\[\[(.*?)\]\]", text, re.DOTALL)
    control = re.search(r"Control Effort \(CO\): \[(.*)\]", text)
    assert time and force and pose and control, text
    numbers = [
        np.array([float(word) for word in re.sub(r"[\[\]]", " ", match[1]).split()])
        for match in (force, pose, control)
    ]
    return {
        "time": float(time[1]),
        "wrench": numbers[0].reshape(6),
        "pose": numbers[1].reshape(4, 4),
        "control": numbers[2].reshape(6),
    }
