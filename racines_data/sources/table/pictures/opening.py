"""Which reader a sweep's images have, by their ending."""

from collections.abc import Sequence
from pathlib import Path

from racines_data.errors import RacinesError
from racines_data.sources.table.pictures import array, dicom, files, sequence, video
from racines_data.sources.table.pictures.base import Stack

ONE_A_SWEEP = (*array.ENDINGS, *sequence.ENDINGS, *video.ENDINGS)
"""Endings of files that hold all images of a sweep."""
ENDINGS = (*files.ENDINGS, *ONE_A_SWEEP, *dicom.ENDINGS)


def open_stack(paths: Sequence[Path | None], missing: dict[int, str], field: str) -> Stack:
    """Return the reader of a sweep's images.

    Args:
        paths: One an image, or the one that holds them all; None for one that is not there.
        missing: Why those are not there.
        field: Field of the mapping, for the message.

    Raises:
        RacinesError: an ending that is not read here, several, or a file that cannot be used.
    """
    known = [path for path in paths if path is not None]
    if not known:
        raise RacinesError(f"{field}: none of the images is there: {next(iter(missing.values()))}")
    endings = sorted({path.suffix.lower() for path in known})
    if endings[0] not in ENDINGS:
        raise RacinesError(
            f"{field}: {known[0].name}: images are read from {', '.join(ENDINGS)}; convert them"
        )
    if all(ending in files.ENDINGS for ending in endings):
        return files.Files(paths, missing)
    if len(endings) > 1:
        raise RacinesError(f"{field}: {', '.join(endings)} in one sweep: give one kind")
    if endings[0] in dicom.ENDINGS:
        if missing:
            raise RacinesError(f"{field}: {next(iter(missing.values()))}")
        return dicom.Dicom(list(dict.fromkeys(known)))
    if len(set(known)) > 1:
        raise RacinesError(
            f"{field}: {known[0].name} and {known[1].name}: one file of {endings[0]} holds all "
            "images of a sweep; name the sweep in the path: {sweep}" + endings[0]
        )
    kinds = ((array.ENDINGS, array.Array), (sequence.ENDINGS, sequence.ImageSequence))
    for own, kind in kinds:
        if endings[0] in own:
            return kind(known[0])
    return video.Video(known[0])
