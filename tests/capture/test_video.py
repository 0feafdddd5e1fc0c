"""Frames from a film: spread over the camera's way, sharp, upright; films that cannot be used are refused with a remedy."""

import filecmp
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from zeroshop_steps.capture import video
from zeroshop_steps.capture.video import choose_frames, extract_frames, read_frames, scan_video
from zeroshop_steps.geometry.imaging.images import list_images, read_image
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.files import read_json

WIDTH, HEIGHT = 320, 240


def picture(seed: int = 0) -> np.ndarray:
    """A wide picture that the camera passes along."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.integers(0, 255, (16, 160, 3), dtype=np.uint8), (2400, HEIGHT), interpolation=cv2.INTER_CUBIC)
    fine = cv2.resize(rng.integers(0, 90, (16, 160, 3), dtype=np.uint8), (2400, HEIGHT), interpolation=cv2.INTER_NEAREST)
    return cv2.add(coarse // 2, fine)


def film(path: Path, offsets, blurred=(), light=1.0, smear_px=(25, 1)) -> Path:
    """Write a film that shows `picture` from these offsets."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v")), 30, (WIDTH, HEIGHT))
    assert writer.isOpened()
    whole = picture()
    for number, offset in enumerate(offsets):
        frame = whole[:, int(offset) : int(offset) + WIDTH]
        if number in blurred:
            frame = cv2.blur(frame, smear_px)
        writer.write(np.clip(frame * light, 0, 255).astype(np.uint8))
    writer.release()
    return path


def test_frames_are_spread_over_the_way_not_over_time(tmp_path):
    """The camera rests for two thirds of the film."""
    way = np.concatenate([np.linspace(0, 900, 60), np.full(160, 900), np.linspace(900, 1800, 60)])
    extract_frames(film(tmp_path / "film.mp4", way), 12, 1920, tmp_path / "capture")
    facts = read_json(tmp_path / "capture/capture.json")
    chosen = facts["source_frames"]
    assert chosen[0] == 0 and facts["images"] == 12 and chosen == sorted(set(chosen))
    steps = np.diff(way[chosen])
    assert steps.max() < 2.2 * np.median(steps), steps
    assert len(list_images(tmp_path / "capture/images")) == 12
    assert read_image(tmp_path / "capture/contact_sheet.png").shape[1] == 5 * 320
    assert facts["warnings"] == []


def test_a_film_that_is_blurred_throughout_is_said(tmp_path):
    path = film(tmp_path / "film.mp4", np.linspace(0, 1800, 120), set(range(120)), smear_px=(9, 9))
    extract_frames(path, 10, 1920, tmp_path / "capture")
    facts = read_json(tmp_path / "capture/capture.json")
    assert any("blurred throughout" in warning for warning in facts["warnings"]) and min(facts["edge_blur_px"]) > 1.5


def test_sharp_frames_are_preferred(tmp_path):
    way = np.linspace(0, 1800, 120)
    blurred = set(range(1, 120)) - set(range(0, 120, 5))
    found = scan_video(film(tmp_path / "film.mp4", way, blurred))
    chosen = choose_frames(found, 10)
    assert len(chosen) == 10 and not set(chosen) & blurred


def test_frames_may_be_evenly_spaced_from_the_first_to_the_last(tmp_path):
    way = np.concatenate([np.zeros(20), np.linspace(0, 1800, 81)])  # the camera waits before it moves
    path = film(tmp_path / "film.mp4", way)
    for spacing in ("view", "time"):
        extract_frames(path, 11, 1920, tmp_path / spacing, spacing=spacing)
    view, time = (read_json(tmp_path / spacing / "capture.json")["source_frames"] for spacing in ("view", "time"))
    assert time == list(range(0, 101, 10)) and view != time


def test_the_same_film_gives_the_same_bytes(tmp_path):
    path = film(tmp_path / "film.mp4", np.linspace(0, 900, 40))
    for name in ("one", "two"):
        extract_frames(path, 8, 1920, tmp_path / name)
    facts = [read_json(tmp_path / name / "capture.json") | {"seconds": 0} for name in ("one", "two")]
    assert facts[0] == facts[1]
    pictures = [one for one in sorted((tmp_path / "one").rglob("*.*")) if one.name != "capture.json"]
    assert len(pictures) >= 8
    for one in pictures:
        assert filecmp.cmp(one, tmp_path / "two" / one.relative_to(tmp_path / "one"), shallow=False), one


def test_large_frames_are_scaled_down(tmp_path):
    extract_frames(film(tmp_path / "film.avi", np.linspace(0, 900, 40)), 8, 160, tmp_path / "capture")
    assert read_image(tmp_path / "capture/images/000000.png").shape == (120, 160, 3)


def test_a_film_of_one_place_is_refused(tmp_path):
    with pytest.raises(StepError, match="only 1 different views, 8 are needed"):
        extract_frames(film(tmp_path / "film.mp4", np.zeros(40)), 20, 1920, tmp_path / "capture")
    assert not (tmp_path / "capture").exists()


def test_one_frame_is_refused(tmp_path):
    with pytest.raises(StepError, match="a single frame"):
        scan_video(film(tmp_path / "film.mp4", [0]))


def test_no_video_at_all(tmp_path):
    for name, content, message in (
        ("no.mp4", b"", "cannot be read as a video|no frames"),
        ("text.mp4", b"no video at all" * 100, "cannot be read as a video|no frames"),
        (
            "pointer.mp4",
            b"version https://git-lfs.github.com/spec/v1\n",
            "pointer of Git LFS, not a film; fetch the film itself by git lfs",
        ),
        ("film.heic", b"x", "no video that can be read"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(StepError, match=message):
            scan_video(tmp_path / name)
    with pytest.raises(StepError, match="does not exist"):
        scan_video(tmp_path / "nowhere.mp4")
    with pytest.raises(StepError, match="is a folder; name the film in it"):
        scan_video(tmp_path)


@pytest.mark.parametrize("suffix", [".mp4", ".avi"])
def test_a_film_cut_off_in_the_middle_is_refused(tmp_path, suffix):
    path = film(tmp_path / f"film{suffix}", np.linspace(0, 900, 60))
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StepError, match="cut off|cannot be read as a video"):
        scan_video(path)


def test_dark_and_fast_films_are_told(tmp_path):
    extract_frames(film(tmp_path / "dark.mp4", np.linspace(0, 900, 40), light=0.2), 8, 1920, tmp_path / "dark")
    assert any("dark" in line for line in read_json(tmp_path / "dark/capture.json")["warnings"])
    extract_frames(film(tmp_path / "fast.mp4", np.linspace(0, 1900, 13)), 8, 1920, tmp_path / "fast")
    assert any("too fast" in line for line in read_json(tmp_path / "fast/capture.json")["warnings"])


@pytest.mark.parametrize("suffix", [".mov", ".mkv", ".avi"])
def test_other_containers_are_read(tmp_path, suffix):
    found = scan_video(film(tmp_path / f"film{suffix}", np.linspace(0, 900, 20)))
    assert len(found.changes) == 20


def test_a_phone_held_upright_is_turned_as_the_file_says(tmp_path):
    """An mp4 turns by the matrix in its track header (ISO 14496-12, 8.3.2): here a quarter turn clockwise."""
    path = film(tmp_path / "film.mp4", np.linspace(0, 900, 20))
    lying = next(read_frames(path))
    content = bytearray(path.read_bytes())
    header = content.index(b"tkhd") + 4
    matrix = header + (40 if content[header] == 0 else 52)
    content[matrix : matrix + 36] = struct.pack(">9i", 0, 1 << 16, 0, -(1 << 16), 0, 0, HEIGHT << 16, 0, 1 << 30)
    path.write_bytes(content)
    upright = next(read_frames(path))
    assert upright.shape == (WIDTH, HEIGHT, 3)
    np.testing.assert_array_equal(upright, np.rot90(lying, -1))
    extract_frames(path, 8, 1920, tmp_path / "capture")
    facts = read_json(tmp_path / "capture/capture.json")
    assert (facts["width_px"], facts["height_px"]) == (HEIGHT, WIDTH)


def test_a_film_whose_end_is_damaged_is_said(tmp_path, capsys):
    path = film(tmp_path / "film.mkv", np.linspace(0, 900, 60))
    whole = path.read_bytes()
    path.write_bytes(whole[: int(len(whole) * 0.96)])
    found = scan_video(path)
    assert 50 < len(found.changes) < 60 and "of its 60 frames can be read" in capsys.readouterr().err


@pytest.mark.parametrize(("more", "said"), [(1, False), (3, False), (8, True)])
def test_a_container_may_count_a_few_frames_too_many(tmp_path, monkeypatch, capsys, more, said):
    path = film(tmp_path / "film.avi", np.linspace(0, 900, 100))
    monkeypatch.setattr(video, "_count_promised_frames", lambda path: 100 + more)
    monkeypatch.setattr(video, "_measure_readable_share", lambda path: 100 / (100 + more))
    assert len(scan_video(path).changes) == 100 and ("its end is damaged" in capsys.readouterr().err) == said


def test_a_real_film_with_one_frame_less_than_counted_is_taken_in_silence(shared_data, capsys):
    path = shared_data / "captures/teddy_moved/film.mp4"
    if not path.is_file():
        pytest.skip(f"{path} is not there")
    assert len(scan_video(path).changes) == 141 and not capsys.readouterr().err


@pytest.mark.parametrize("suffix", [".3gp", ".MTS", ".m2ts", ".mpg", ".m4v", ".wmv"])
def test_films_of_phones_and_camcorders_are_read(tmp_path, suffix):
    path = film(tmp_path / f"film{suffix}", np.linspace(0, 300, 20))
    assert len(scan_video(path).changes) == 20


@pytest.mark.parametrize("duration_ms", [0, 40])
def test_an_animated_gif_is_a_film(tmp_path, duration_ms):
    frames = [Image.fromarray(frame[::3, ::3]) for frame in read_frames(film(tmp_path / "film.avi", np.linspace(0, 300, 12)))]
    frames[0].save(tmp_path / "film.gif", save_all=True, append_images=frames[1:], duration=duration_ms)
    assert len(scan_video(tmp_path / "film.gif").changes) == 12


def test_cuts_of_a_film_are_found(tmp_path):
    """Two ways that were filmed apart; a camera that goes on has no cut."""
    extract_frames(film(tmp_path / "cut.avi", [*np.linspace(0, 200, 60), *np.linspace(1500, 1700, 60)]), 10, 1920, tmp_path / "cut")
    facts = read_json(tmp_path / "cut/capture.json")
    assert [facts["source_frames"][place] >= 60 > facts["source_frames"][place - 1] for place in facts["cuts"]] == [True]
    extract_frames(film(tmp_path / "whole.avi", np.linspace(0, 900, 120)), 10, 1920, tmp_path / "whole")
    assert read_json(tmp_path / "whole/capture.json")["cuts"] == []
