"""Canonical frames on record, and what a drawing has to look like to pass beside them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from racines_data.errors import RacinesError
from racines_data.validate.canonical import LEVELS, compare
from racines_leaderboard.cli.command import app
from racines_leaderboard.determinism import processors
from racines_leaderboard.determinism.processors import Drawing, Record


def frames(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (8, 128, 128), np.uint8)


def drawing(images: np.ndarray, instructions: str = "AVX2") -> Drawing:
    return Drawing("Some CPU (family 6, model 1)", instructions, "2.0.0", images)


def moved(images: np.ndarray, pixels: int, by: int) -> np.ndarray:
    """Change some pixels of the first frame by so many gray levels."""
    wide = images.astype(int)
    part = wide[0].ravel()[:pixels]
    part += np.where(part < 128, by, -by)
    return wide.astype(np.uint8)


class TestTolerance:
    def test_a_few_pixels_may_differ_as_measured(self) -> None:
        found = compare(frames(), moved(frames(), 5, 20))
        assert found.holds and (found.levels, found.differing, found.beyond) == (20, 5, 5)
        assert compare(frames(), frames()).differing == 0

    def test_black_beside_white_is_255_levels(self) -> None:
        black, white = np.zeros((1, 4, 4), np.uint8), np.full((1, 4, 4), 255, np.uint8)
        assert compare(black, white).levels == compare(white, black).levels == 255

    @pytest.mark.parametrize(
        "other",
        [
            moved(frames(), 1, LEVELS + 1),
            moved(frames(), 2000, 2),
            moved(frames(), 128 * 128, 1),
            np.roll(frames(), 1, axis=2),
            frames(1),
            frames()[::-1],
            frames()[..., ::-1],
        ],
        ids=[
            "one-far",
            "many-by-2",
            "all-of-one-frame-by-1",
            "shifted",
            "other",
            "order",
            "mirror",
        ],
    )
    def test_what_another_code_draws_does_not_pass(self, other: np.ndarray) -> None:
        assert not compare(frames(), other).holds

    def test_other_frames_are_refused(self) -> None:
        with pytest.raises(RacinesError, match="cannot be held against"):
            compare(frames(), frames()[:3])


class TestRecord:
    def test_sets_come_back_as_they_were_drawn(self, tmp_path: Path) -> None:
        sets = (
            drawing(frames()),
            drawing(moved(frames(), 9, 30), "AVX512"),
            drawing(frames(3), "DEFAULT"),
        )
        record = Record(np.zeros((8, 12), np.float32), sets)
        processors.write_record(record, tmp_path / "a.npz")
        again = processors.read_record(tmp_path / "a.npz")
        assert [each.kind for each in again.drawings] == [each.kind for each in sets]
        for one, other in zip(sets, again.drawings, strict=True):
            assert np.array_equal(one.images, other.images)

    def test_a_set_of_the_same_kind_is_replaced(self) -> None:
        record = Record(np.zeros((8, 12), np.float32), (drawing(frames()),))
        assert len(record.with_drawing(drawing(frames(2))).drawings) == 1
        assert len(record.with_drawing(drawing(frames(2), "AVX512")).drawings) == 2

    def test_a_record_that_cannot_be_used_is_refused_by_its_name(self, tmp_path: Path) -> None:
        path = tmp_path / "a.npz"
        with pytest.raises(RacinesError, match=r"a.npz: no canonical frames here"):
            processors.read_record(path)
        whole = processors.RECORD.read_bytes()
        middle = whole[:5000] + bytes(200) + whole[5200:]
        for content in (b"", b"no archive", whole[:1000], whole[:-100], middle):
            path.write_bytes(content)
            with pytest.raises(RacinesError, match=r"a.npz: not canonical frames"):
                processors.read_record(path)

    def test_changed_frames_and_another_phantom_are_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "a.npz"
        processors.write_record(Record(np.zeros((8, 12), np.float32), (drawing(frames()),)), path)
        arrays = dict(np.load(path))
        np.savez(path, **{**arrays, "images": moved(arrays["images"], 1, 1)})
        with pytest.raises(RacinesError, match="frames of Some CPU.*AVX2 are damaged"):
            processors.read_record(path)
        told = np.array(str(arrays["told"]).replace('"phantom": "1.', '"phantom": "9.'))
        np.savez(path, **{**arrays, "told": told})
        with pytest.raises(RacinesError, match=r"of phantom 9\."):
            processors.read_record(path)


class TestPackagedRecord:
    def test_every_set_agrees_with_every_other(self) -> None:
        record = processors.read_record()
        assert len(record.parameters) == 48 and len(record.drawings) >= 3
        assert {"DEFAULT", "AVX2", "AVX512"} <= {each.instructions for each in record.drawings}
        report = processors.compare_all(record)
        assert report["holds"] and len(report["pairs"]) >= 3

    def test_its_frames_show_something_and_differ(self) -> None:
        images = processors.read_record().drawings[0].images
        assert len({frame.tobytes() for frame in images}) == len(images)
        assert (images.reshape(len(images), -1).std(1) > 10).all()


def test_the_command_fails_where_another_code_drew(monkeypatch: pytest.MonkeyPatch) -> None:
    own = processors.read_record().drawings[0]
    run = CliRunner().invoke
    monkeypatch.setattr(processors, "draw", lambda record: own)
    assert run(app, ["study", "processors"]).exit_code == 0
    mirrored = replace(own, images=np.ascontiguousarray(own.images[..., ::-1]))
    monkeypatch.setattr(processors, "draw", lambda record: mirrored)
    done = run(app, ["study", "processors"])
    assert done.exit_code == 1 and isinstance(done.exception, RacinesError)
    assert "differ by more than processors may" in str(done.exception)


def test_the_command_writes_the_set_drawn_here(monkeypatch, tmp_path: Path) -> None:
    own = replace(processors.read_record().drawings[0], cpu="Another CPU")
    monkeypatch.setattr(processors, "draw", lambda record: own)
    done = CliRunner().invoke(app, ["study", "processors", "--out", str(tmp_path / "new.npz")])
    assert done.exit_code == 0
    kinds = [each.cpu for each in processors.read_record(tmp_path / "new.npz").drawings]
    assert kinds[-1] == "Another CPU" and len(kinds) >= 4
