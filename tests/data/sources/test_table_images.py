"""The source `table`: every kind of images gives the same sweep, cropped and turned as told."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from racines_data.errors import RacinesError
from racines_data.schema import Trajectory
from racines_data.sources.images import square
from tests.data.sources.table_folder import (
    COUNT,
    HEIGHT,
    ROBOT,
    WIDTH,
    changed,
    check,
    source,
    sweep,
    synthetic,
    synthetic_folder,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return synthetic_folder(tmp_path_factory.mktemp("mine"))


@pytest.fixture(scope="module")
def expected(folder: Path) -> Trajectory:
    return sweep(folder, ROBOT)


def write_images(folder: Path, images: np.ndarray, ending: str) -> None:
    path = folder / f"scan{ending}"
    if ending == ".npy":
        np.save(path, images)
    elif ending == ".mha":
        header = f"ObjectType = Image\nNDims = 3\nDimSize = {WIDTH} {HEIGHT} {len(images)}\n"
        header += "ElementType = MET_UCHAR\nElementDataFile = LOCAL\n"
        path.write_bytes(header.encode() + images.tobytes())
    elif ending == ".dcm":
        _write_dicom(path, images)
    else:
        _write_video(path, images)


def _write_video(path: Path, images: np.ndarray) -> None:
    av = pytest.importorskip("av", reason="PyAV ABSENT: pip install 'racines[import]'")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = images.shape[2], images.shape[1], "gray"
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        container.mux(stream.encode())


def _write_dicom(path: Path, images: np.ndarray) -> None:
    pydicom = pytest.importorskip("pydicom", reason="pydicom ABSENT: pip install 'racines[import]'")
    meta = pydicom.dataset.FileMetaDataset()
    meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.3.1"
    meta.MediaStorageSOPInstanceUID = "1.2.3"
    made = pydicom.dataset.FileDataset(str(path), {}, file_meta=meta, preamble=b"\0" * 128)
    made.SOPClassUID, made.SOPInstanceUID = meta.MediaStorageSOPClassUID, "1.2.3"
    made.NumberOfFrames, made.Rows, made.Columns = images.shape
    made.BitsAllocated = made.BitsStored = 8
    made.HighBit, made.PixelRepresentation, made.SamplesPerPixel = 7, 0, 1
    made.PhotometricInterpretation = "MONOCHROME2"
    made.PixelData = images.tobytes()
    made.save_as(path)


@pytest.mark.parametrize("ending", [".npy", ".mha", ".dcm", ".mkv", ".avi"])
def test_every_kind_of_images(folder: Path, expected: Trajectory, ending: str):
    images = synthetic()[2]
    write_images(folder, images, ending)
    check(sweep(folder, changed(ROBOT, images__path=f"scan{ending}")), expected)
    more = np.concatenate([images[:0], np.zeros_like(images[:1]), images])
    write_images(folder, more, ending)
    with pytest.raises(RacinesError, match=f"missing rows: {COUNT + 1} images for {COUNT} rows"):
        source(folder, changed(ROBOT, images__path=f"scan{ending}")).plan()


def test_mp4_and_jpeg_with_loss(folder: Path, expected: Trajectory):
    av = pytest.importorskip("av", reason="PyAV ABSENT: pip install 'racines[import]'")
    smooth = [
        np.asarray(Image.fromarray(image).resize((4, 3)).resize((WIDTH, HEIGHT)))
        for image in synthetic()[2]
    ]
    with av.open(str(folder / "scan.mp4"), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height = WIDTH, HEIGHT
        stream.pix_fmt, stream.bit_rate = "yuv420p", 10**8
        for image in smooth:
            frame = av.VideoFrame.from_ndarray(np.stack([image] * 3, -1), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    made = sweep(folder, changed(ROBOT, images__path="scan.mp4"))
    assert np.abs(made.images.astype(int) - [square(image) for image in smooth]).mean() < 6
    for row, image in enumerate(smooth):
        Image.fromarray(image).save(folder / f"still{row}.jpg", quality=95)
    by_order = sweep(folder, changed(ROBOT, images__path="still*.jpg"))
    by_row = sweep(folder, changed(ROBOT, images__path="still{row}.jpg"))
    assert np.array_equal(by_order.images, by_row.images), "img10 comes after img2"
    assert np.abs(by_order.images.astype(int) - [square(image) for image in smooth]).mean() < 3


def test_frame_numbers_of_a_video(tmp_path: Path, expected: Trajectory):
    poses, times, images = synthetic()
    numbers = np.arange(COUNT) * 2
    synthetic_folder(tmp_path, number=numbers)
    np.save(tmp_path / "scan.npy", np.repeat(images, 2, axis=0))
    mapping = changed(ROBOT, images__path="scan.npy", images__index="number")
    check(sweep(tmp_path, mapping), expected)
    synthetic_folder(tmp_path, number=numbers + 1.5)
    with pytest.raises(RacinesError, match="no row of column 'number' is a number of images"):
        source(tmp_path, mapping).plan()


def test_crop_sector_and_orientation(folder: Path):
    images = synthetic()[2]
    made = sweep(folder, changed(ROBOT, images__crop=[8, 4, 40, 36]))
    assert np.array_equal(made.images, [square(image[4:36, 8:40]) for image in images])
    made = sweep(folder, changed(ROBOT, images__orientation="UN"))
    assert np.array_equal(made.images, [square(image[::-1, ::-1]) for image in images])
    sector = {"apex": [32, -4], "radii": [8, 50], "angles": [-30, 30]}
    made = sweep(folder, changed(ROBOT, images__sector=sector))
    y, x = np.mgrid[:HEIGHT, :WIDTH] - np.array([-4, 32])[:, None, None]
    inside = (x**2 + y**2 >= 64) & (x**2 + y**2 <= 2500) & (np.abs(x) <= y * np.tan(np.pi / 6))
    assert 0.3 < inside.mean() < 0.6
    assert np.array_equal(made.images, [square(image * inside) for image in images])
