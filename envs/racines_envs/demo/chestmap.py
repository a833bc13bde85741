"""The probe over the chest, from above: head up, as one sees a patient who lies on the back.

Skin, ribs where they shade the ultrasound, and the heart under them as an examiner imagines it.
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFilter

from racines_data.geometry import Pose
from racines_data.patients.bake import label_box
from racines_data.patients.form import FOOT
from racines_data.patients.heart import Heart
from racines_data.patients.labels import AORTA, LA, LV, MYOCARDIUM, PULMONARY, RA, RV, RV_WALL
from racines_data.patients.volume import LOW, VOXEL
from racines_data.plotting import BLUE, GREEN, INK, PROBE, VIOLET, letters
from racines_envs.demo.watching import Shot

SIZE = 416
_FINE = 2
"""How much finer it is drawn than shown, for smooth lines."""
_ACROSS = 0.235  # m of the chest that is shown
_SKIN, _BONE, _LABEL = (226, 180, 152), (246, 230, 208), (90, 58, 43)
_HEART = (
    (LV, (178, 58, 64)), (MYOCARDIUM, (150, 44, 52)), (LA, (196, 92, 92)), (RV, (88, 92, 158)),
    (RV_WALL, (78, 80, 142)), (RA, (108, 112, 172)), (AORTA, (206, 104, 96)),
    (PULMONARY, (98, 102, 166)),
)  # fmt: skip
"""What is shown of the heart: left parts red, right parts blue, as atlases have them."""
_FAN, _RIM = (190, 230, 255, 52), (230, 246, 255, 190)
_PARTS = (("head", (0.5, 0.02), "ma"), ("feet", (0.5, 0.98), "md"),
          ("right", (0.02, 0.5), "lm"), ("left", (0.98, 0.5), "rm"))  # fmt: skip
"""Words at the edges, where they stand in shares of the side, and by what they hang."""
_HALF, _FACE = 0.011, 0.005
"""Half the probe's length and width on the skin, m."""


class ChestMap:
    """The chest of one patient, as a background on which poses are drawn."""

    def __init__(self, heart: Heart, own: Pose) -> None:
        """Draw what does not move; `own` is the patient's own pose of the view, a batch of one."""
        foot = (torch.tensor(FOOT, dtype=torch.float64) @ heart.placement.axes)[:2].numpy()
        down = foot / np.linalg.norm(foot)
        # Rows: to the right and down in the picture, seen from above.
        self._turn = np.array([[-down[1], down[0]], down])
        self._own = own.position[0].double().numpy(), own.rotation[0].double().numpy()
        settings = heart.settings
        self._half_angle = float(settings.half_angle[0])
        self._depth = 1e-3 * float(settings.step[0]) * settings.along.shape[-1]
        voxels, colours = _heart_points(heart)
        middle = np.median(voxels[:, :2], 0)
        self._middle = self._turn @ ((middle + self._own[0][:2]) / 2.0)
        self._scale = SIZE * _FINE / _ACROSS
        self._ground = self._draw_ground(heart, voxels, colours)

    def _pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn (n, 2 or 3) m of the base frame into (n, 2) fine pixels."""
        flat = np.atleast_2d(points)[:, :2] @ self._turn.T - self._middle
        return flat * self._scale + SIZE * _FINE / 2.0

    def _draw_ground(self, heart: Heart, voxels: np.ndarray, colours: np.ndarray) -> Image.Image:
        side = SIZE * _FINE
        ys, xs = np.mgrid[0:side, 0:side] + 0.5
        flat = np.stack([xs, ys], -1) - side / 2.0
        light = 1.0 - 0.16 * (np.hypot(*np.moveaxis(flat, -1, 0)) / (side / 2.0)) ** 2
        ground = np.array(_SKIN) * light[..., None]
        places = 1e3 * ((flat / self._scale + self._middle) @ self._turn)  # mm, base frame
        ground = _over(ground, np.array(_BONE), 0.85 * _ribs(heart, places))
        image = Image.fromarray(ground.clip(0, 255).astype(np.uint8))
        shape, cover = self._heart(voxels, colours)
        image.paste(shape, (0, 0), cover)
        draw = ImageDraw.Draw(image)
        for words, (x, y), anchor in _PARTS:
            draw.text((x * side, y * side), words, _LABEL, letters(15 * _FINE), anchor=anchor)
        return image

    def _heart(self, voxels: np.ndarray, colours: np.ndarray) -> tuple[Image.Image, Image.Image]:
        """Return the heart as seen from above, and how much of it covers what is under it."""
        side = SIZE * _FINE // 4
        order = np.argsort(voxels[:, 2], kind="stable")  # the uppermost last
        at = np.floor(self._pixels(voxels[order]) / 4.0).astype(int)
        inside = ((at >= 0) & (at < side)).all(1)
        at, order = at[inside], order[inside]
        shape, cover = np.zeros((side, side, 3), np.uint8), np.zeros((side, side), np.uint8)
        shape[...] = _HEART[1][1]
        depth = voxels[order, 2]
        lit = 0.72 + 0.4 * (depth - depth.min()) / max(float(np.ptp(depth)), 1e-9)
        shape[at[:, 1], at[:, 0]] = (colours[order] * lit[:, None]).clip(0, 255)
        cover[at[:, 1], at[:, 0]] = 205
        whole = (SIZE * _FINE, SIZE * _FINE)
        smooth = (
            Image.fromarray(shape)
            .filter(ImageFilter.MedianFilter(5))
            .resize(whole, Image.Resampling.BICUBIC)
        )
        edge = (
            Image.fromarray(cover)
            .filter(ImageFilter.MedianFilter(5))
            .resize(whole, Image.Resampling.BICUBIC)
        )
        return smooth, edge.filter(ImageFilter.GaussianBlur(2))

    def picture(self, shots: Sequence[Shot], shot: Shot, label: str, reveal: bool) -> Image.Image:
        """Return the (SIZE, SIZE) RGB map at a shot; with `reveal` the patient's own pose."""
        image = self._ground.copy()
        fan = [tuple(each) for each in self._pixels(self._fan(shot))]
        ImageDraw.Draw(image, "RGBA").polygon(fan, fill=_FAN, outline=_RIM, width=_FINE)
        draw = ImageDraw.Draw(image)
        way = [self._pixels(np.array(s.position))[0] for s in shots if s.step <= shot.step]
        if len(way) > 1:
            draw.line([tuple(each) for each in way], fill=BLUE, width=2 * _FINE, joint="curve")
        if reveal:
            x, y = self._pixels(self._own[0])[0]
            draw.circle((x, y), 15 * _FINE, outline=GREEN, width=3 * _FINE)
            draw.text((x, y - 18 * _FINE), f"true {label}", GREEN, letters(15 * _FINE), anchor="md",
                      stroke_width=_FINE, stroke_fill="white")  # fmt: skip
        self._draw_probe(draw, shot)
        self._draw_aim(draw, shot)
        return image.resize((SIZE, SIZE), Image.Resampling.LANCZOS)

    def _fan(self, shot: Shot) -> np.ndarray:
        """Return (n, 3) m of the outline of the slice that is looked through."""
        angle = np.linspace(-self._half_angle, self._half_angle, 17)
        rim = np.stack([np.sin(angle), np.zeros(17), np.cos(angle)], 1) * self._depth
        points = np.concatenate([np.zeros((1, 3)), rim])
        return points @ np.array(shot.rotation).reshape(3, 3).T + np.array(shot.position)

    def _draw_aim(self, draw: ImageDraw.ImageDraw, shot: Shot) -> None:
        """Draw where the servo believes the view, dashed as wide as it is unsure."""
        x, y = self._pixels(np.array(shot.aim))[0]
        radius = min(max(shot.spread * 1e-3 * self._scale, 9.0 * _FINE), SIZE * _FINE * 0.45)
        box = (x - radius, y - radius, x + radius, y + radius)
        arm = 6 * _FINE
        for ink, width in (("white", 4 * _FINE), (VIOLET, 2 * _FINE)):
            for start in range(0, 360, 30):
                draw.arc(box, start, start + 19, fill=ink, width=width)
            draw.line((x - arm, y, x + arm, y), fill=ink, width=width)
            draw.line((x, y - arm, x, y + arm), fill=ink, width=width)

    def _draw_probe(self, draw: ImageDraw.ImageDraw, shot: Shot) -> None:
        """Draw the face on the skin and a mark at the image's right side."""
        position = np.array(shot.position)
        rotation = np.array(shot.rotation).reshape(3, 3)
        turns = np.linspace(0.0, 2.0 * math.pi, 33)
        # A rounded box: the probe's face.
        power = 0.55
        x = _HALF * np.sign(np.cos(turns)) * np.abs(np.cos(turns)) ** power
        y = _FACE * np.sign(np.sin(turns)) * np.abs(np.sin(turns)) ** power
        face = np.stack([x, y, np.zeros_like(x)], 1) @ rotation.T + position
        draw.polygon([tuple(p) for p in self._pixels(face)], fill=PROBE, outline=INK, width=_FINE)
        mark = np.array([[0.78 * _HALF, 0.0, 0.0]]) @ rotation.T + position
        draw.circle(tuple(self._pixels(mark)[0]), 2.4 * _FINE, fill=INK)


def _over(ground: np.ndarray, colour: np.ndarray, cover: np.ndarray) -> np.ndarray:
    return ground + cover[..., None] * (colour - ground)


def _ribs(heart: Heart, places: np.ndarray) -> np.ndarray:
    """Return how much of (H, W, 2) mm of the skin lies over a rib, 0-1, rounded like one."""
    chest = heart.chest
    along = places @ chest.across[0].numpy()
    spacing, width = float(chest.spacing[0]), float(chest.width[0])
    away = np.abs(np.remainder(along - float(chest.offset[0]), spacing) - spacing / 2.0)
    round_ = np.sqrt(np.clip(1.0 - (away / (width / 2.0)) ** 2, 0.0, None))
    beyond = places @ chest.margin[0].numpy() - float(chest.last[0])
    return round_ / (1.0 + np.exp(np.clip(beyond / 2.0, -40, 40)))


def _heart_points(heart: Heart) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) m of the heart's voxels, base frame, and their (n, 3) colours."""
    box = label_box(heart.shape)[::2, ::2, ::2]
    points, colours = [], []
    for label, colour in _HEART:
        where = (box == label).nonzero().double()
        inside = (2.0 * where + 0.5) * torch.tensor(VOXEL) + torch.tensor(LOW)
        points.append(heart.placement.to_base(inside.double()).numpy())
        colours.append(np.tile(np.array(colour, dtype=float), (len(where), 1)))
    return np.concatenate(points), np.concatenate(colours)
