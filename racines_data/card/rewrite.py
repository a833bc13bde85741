"""Writing the card of a finished dataset anew: with realism figures, or redrawn.

    dataset ──links──> a folder beside it ──> new README.md, card/, manifest.json ──> swapped

The content digest stays: it is of the rows. A run that is killed leaves the dataset as it was.
"""

import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from PIL import Image, UnidentifiedImageError

from racines_data.card.contact_sheet import write_sheets
from racines_data.card.markdown import write_card
from racines_data.card.pictures import FOLDER, write_pictures
from racines_data.card.realism import read_realism
from racines_data.digest import check_files
from racines_data.errors import RacinesError
from racines_data.files import locked_place, recover_folder, sha256_file, swap_folder, write_atomic
from racines_data.manifest import CARD, MANIFEST, read_manifest, rebuild_hint

LARGEST = 2_000_000
"""Bytes of a picture, at most: a card is read in a browser."""


def rewrite_card(
    root: Path, realism: Sequence[Path] = (), pictures: Sequence[Path] = (), draw: bool = False
) -> dict[str, Any]:
    """Write a dataset's card anew, and seal it in the manifest, which is returned.

    Args:
        root: Folder of the dataset.
        realism: Reports of `racines study realism` on it; they replace earlier ones.
        pictures: PNG files shown with them, copied to `card/`; they replace earlier ones.
        draw: Draw the other pictures again, and count again.

    Raises:
        RacinesError: no dataset or a damaged one, a report that is none or is of another dataset,
            or a picture that is no PNG or too large.
    """
    root = root.resolve()
    recover_folder(root)
    read_manifest(root)
    with locked_place(root):
        return _rewrite(root, realism, pictures, draw)


def _rewrite(
    root: Path, realism: Sequence[Path], pictures: Sequence[Path], draw: bool
) -> dict[str, Any]:
    manifest = read_manifest(root)
    check_files(root, manifest["files"], rebuild_hint(manifest))
    if realism:
        manifest["realism"] = [read_realism(path, manifest) for path in realism]
    shown = {f"{FOLDER}/realism-{path.stem}.png": _read_picture(path) for path in pictures}
    if len(shown) < len(pictures):
        raise RacinesError("pictures: two of one name; rename one")
    beside = Path(tempfile.mkdtemp(dir=root.parent, prefix=f".{root.name}.card-"))
    try:
        beside.chmod(root.stat().st_mode)
        link_files(root, beside, manifest["files"])
        if shown:
            for name in manifest.get("realism_pictures", []):
                (beside / name).unlink(missing_ok=True)
            for name, data in shown.items():
                write_atomic(beside / name, data)
            manifest["realism_pictures"] = list(shown)
        if draw:
            for name in manifest.get("pictures", []):
                (beside / FOLDER / f"{name}.png").unlink()
            write_pictures(beside, manifest)
            write_sheets(beside, manifest)
        write_atomic(beside / CARD, write_card(manifest))
        record_files(beside, manifest)
        write_atomic(beside / MANIFEST, json.dumps(manifest, indent=1) + "\n")
        swap_folder(beside, root)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
    return manifest


def _read_picture(path: Path) -> bytes:
    try:
        data = path.read_bytes()
        with Image.open(io.BytesIO(data)) as image:
            kind = image.format
            image.verify()
    except (OSError, UnidentifiedImageError, SyntaxError) as error:
        raise RacinesError(f"{path}: no readable picture ({error})") from error
    if kind != "PNG" or len(data) > LARGEST:
        raise RacinesError(f"{path}: give a PNG of at most {LARGEST / 1e6:g} MB")
    return data


def link_files(root: Path, beside: Path, names: Iterable[str]) -> None:
    """Bring over files by links; whatever is written later gets a file of its own."""
    for name in names:
        source, target = (root / name).resolve(), beside / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.unlink(missing_ok=True)
        try:
            os.link(source, target)
        except OSError:  # a file system without links
            shutil.copyfile(source, target)


def record_files(beside: Path, manifest: dict[str, Any]) -> None:
    """Enter the files in the manifest anew; of those that were linked, what is known holds."""
    known, files = manifest["files"], {}
    for path in beside.rglob("*"):
        name = path.relative_to(beside).as_posix()
        if path.is_file() and name != MANIFEST:
            record = None if name == CARD or name.startswith(f"{FOLDER}/") else known.get(name)
            files[name] = record or {"sha256": sha256_file(path), "bytes": path.stat().st_size}
    manifest["files"] = dict(sorted(files.items()))
