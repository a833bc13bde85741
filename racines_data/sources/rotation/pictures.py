"""The images of a rotation: found by the names in the file of poses, or by their order.

`file_path` often names folders of the machine on which the file was made. Where no such file is
there, images belong to frames by the names alone, whatever folder they lie in, if every name is
there once; else by the natural order of the images of the one folder that holds any.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from racines_data.errors import RacinesError
from racines_data.sources.images import Fault, resolution
from racines_data.sources.rotation.transforms import Transforms
from racines_data.sources.table.inputs import Folder, natural
from racines_data.sources.table.pictures.files import ENDINGS, Files


@dataclass(frozen=True)
class Found:
    """The image file of each frame, and how it was found."""

    paths: list[Path]
    said: str
    """What to print: by which rule; empty where the file of poses names the files as they are."""


def find_pictures(folder: Folder, transforms: Transforms, images: str = "") -> Found:
    """Return the image of each frame of a file of poses.

    Args:
        folder: Of the recording; nothing outside is opened.
        transforms: What the file says.
        images: Folder of the images inside it; empty for the only one that holds any.

    Raises:
        RacinesError: images that are missing, or too many, or in several folders.
    """
    named = [_named(folder, transforms, index) for index in range(len(transforms.names))]
    there = [path for path in named if path is not None]
    if len(there) == len(named):
        _refuse_twice(transforms, there)
        return Found(there, "")
    if there:
        index = named.index(None)
        raise RacinesError(
            f"{transforms.path}: frames[{index}].file_path: {transforms.names[index]}: no such "
            f"image, where {len(there)} of {len(named)} frames have theirs: put it there"
        )
    held = _images(folder, images)
    where = folder.name(held[0].parent)
    if len(held) != len(named):
        raise RacinesError(
            f"{transforms.path}: frames: {len(named)} of them, and {len(held)} images in "
            f"{where}: every frame needs its image, and every image its frame"
        )
    said = f"`file_path` names no file here (such as {transforms.names[0] or 'nothing'}): "
    ordered = sorted(held, key=lambda path: natural(folder.name(path)))
    by_name = {path.name: path for path in ordered}
    stems = [PurePosixPath(name.replace("\\", "/")).name for name in transforms.names]
    if len(set(stems)) == len(stems) and set(stems) == set(by_name):
        matched = [by_name[stem] for stem in stems]
        same = "which is their natural order" if matched == ordered else "not in natural order"
        return Found(matched, f"{said}each image is that of its name in {where}/, {same}")
    return Found(ordered, f"{said}the order is the natural one of {where}/")


def _named(folder: Folder, transforms: Transforms, index: int) -> Path | None:
    """Return the file that a frame names, with an ending or without, or None."""
    name = transforms.names[index]
    plain = PurePosixPath(name.replace("\\", "/"))
    if not name or plain.is_absolute() or ".." in plain.parts:
        return None  # of another machine
    where = f"{transforms.path}: frames[{index}].file_path"
    for base in (folder.root, transforms.path.parent):
        start = folder.name(base) if base != folder.root else "."
        for ending in ("", *ENDINGS):
            path = folder.find(f"{start}/{plain}{ending}", where) if _may(plain, ending) else None
            if path is not None:
                return path
    return None


def _may(name: PurePosixPath, ending: str) -> bool:
    """Return whether an ending is to be tried: none of a name that is an image's already."""
    return (name.suffix.lower() in ENDINGS) == (not ending)


def _refuse_twice(transforms: Transforms, paths: Sequence[Path]) -> None:
    name, count = Counter(paths).most_common(1)[0]
    if count > 1:
        index = [i for i, path in enumerate(paths) if path == name][1]
        raise RacinesError(
            f"{transforms.path}: frames[{index}].file_path: {transforms.names[index]}: names the "
            "image of another frame: give each frame its own"
        )


def _images(folder: Folder, images: str) -> list[Path]:
    """Return the images of the only folder that holds any, or of the one that is named."""
    by_folder: dict[Path, list[Path]] = defaultdict(list)
    for path in folder.walk():
        if path.suffix.lower() in ENDINGS:
            by_folder[path.parent].append(path)
    if images:
        chosen = (folder.root / images).resolve()
        if not chosen.is_relative_to(folder.root) or not chosen.is_dir():
            raise RacinesError(f"images: {images}: no such folder in {folder.root}")
        return _inside(folder, chosen)
    if not by_folder:
        raise RacinesError(f"{folder.root}: holds no image ({', '.join(ENDINGS)})")
    if len(by_folder) > 1:
        names = [folder.name(each) for each in sorted(by_folder)]
        raise RacinesError(
            f"{folder.root}: images lie in {len(names)} folders, {', '.join(names[:4])}: name "
            f"theirs: --set images={names[0]}"
        )
    return _inside(folder, next(iter(by_folder)))


def _inside(folder: Folder, chosen: Path) -> list[Path]:
    """Return the images of a folder; links out of it, FIFOs and the like are refused by name."""
    names = [path.name for path in chosen.iterdir() if path.suffix.lower() in ENDINGS]
    place = "" if chosen == folder.root else f"{folder.name(chosen)}/"
    found = [folder.file(f"{place}{name}", "images") for name in names if name[0] != "."]
    if not found:
        raise RacinesError(f"{chosen}: holds no image ({', '.join(ENDINGS)})")
    return found


def check_pictures(
    folder: Folder, transforms: Transforms, paths: Sequence[Path]
) -> tuple[int, int]:
    """Return the width and height that all images have, each of them whole.

    Raises:
        RacinesError: a damaged image, mixed sizes, or a size other than the file of poses says.
    """
    sizes, faults = Files(paths).check()
    for path, fault in zip(paths, faults, strict=True):
        if isinstance(fault, Fault):
            raise RacinesError(f"{path}: {fault}")
    usual = Counter(sizes).most_common(1)[0][0]
    for path, size in zip(paths, sizes, strict=True):
        if size != usual:
            raise RacinesError(
                f"{path}: mixed sizes: {resolution(size)} pixels, others {resolution(usual)}: one "
                "recording has images of one size, since poses are in their pixels"
            )
    for key, told, own in zip("wh", transforms.size, usual, strict=True):
        if told is not None and told != own:
            raise RacinesError(
                f"{transforms.path}: {key}: {told}, where {folder.name(paths[0])} has {own} "
                "pixels: poses are in pixels, so that images must not be scaled"
            )
    return usual
