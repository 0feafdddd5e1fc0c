"""The command `zeroshop`, and the version that the project's papers name."""

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image

from zeroshop_steps import __version__
from zeroshop_steps.app import reconstruct_object, workflow
from zeroshop_steps.app.captures_table import read_captures
from zeroshop_steps.app.command import main
from zeroshop_steps.geometry.imaging.images import write_image
from zeroshop_steps.methods import REGISTRATIONS
from zeroshop_steps.networks import weights
from zeroshop_steps.networks.weights import WeightsFile
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.runtime.failures import Failure, write_failure

REPOSITORY = Path(__file__).resolve().parents[2]


def test_it_says_its_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"zeroshop {__version__}\n"


def test_alone_it_prints_how_to_make_a_mesh(capsys):
    assert main([]) == 0
    assert "zeroshop mug.mp4 --height 0.096" in capsys.readouterr().out


def test_an_unknown_option_is_refused(capsys):
    assert main(["photos", "--no-such-option"]) == 2
    assert "No such option" in capsys.readouterr().err


def test_the_changelog_and_the_citation_name_this_version():
    assert yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())["version"] == __version__
    newest = re.search(r"^## (\S+)", (REPOSITORY / "CHANGELOG.md").read_text(), flags=re.M)
    assert newest and newest.group(1) == __version__


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "nowhere does not exist; name a folder of photos or a video"),
        (["{photos}", "--height", "19"], "--height is 19; it is in metres, 0.005 to 3: write 0.19 for 19 cm"),
        (["{photos}", "--height", "nan"], "--height is nan; it is in metres"),
        (["{photos}", "--masks", "nowhere"], "--masks names nowhere, which is no folder"),
        (["{photos}", "--board", "nowhere"], "--board names nowhere, which is no folder"),
        (
            ["{photos}", "--network", "nowhere.onnx"],
            "the network nowhere.onnx does not exist; segment.saliency.network (--network) is the ONNX file",
        ),
        (["{photos}", "--cores", "0"], "--cores is 0; at least 1 is needed"),
        (["{photos}", "--name", "..."], "gives no name for the results"),
        (["check", "nowhere"], "nowhere does not exist"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "photos").mkdir()
    assert main([word.format(photos="photos") for word in words]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: ") and message in said and "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["photos"]


def test_the_lines_at_the_end_are_of_the_cell_that_the_config_chooses(tmp_path, monkeypatch):
    (tmp_path / "config").mkdir()
    (tmp_path / "config/config.yaml").write_text("chosen: {photos: {scene: video_segmented, registration: vggt}}\n")
    monkeypatch.setattr(workflow, "find_project", lambda: tmp_path)
    assert workflow.read_chosen_cell({}) == ("video_segmented", "vggt")
    changed = {"chosen": {"photos": {"registration": "auto"}}}
    assert workflow.read_chosen_cell(changed) == ("video_segmented", "auto")


def test_downloaded_weights_reach_the_workflow(tmp_path, monkeypatch):
    monkeypatch.setattr(workflow, "find_weights_home", lambda: tmp_path)
    assert "register" not in workflow.settings_of_inputs(None)
    for name in REGISTRATIONS["aliked"].weights:
        path = tmp_path / "resources/weights" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    assert workflow.settings_of_inputs(None)["register"] == {"auto": {"weights": str(tmp_path / "resources/weights/aliked")}}


def named_network(network):
    return workflow.settings_of_inputs(network)["segment"]["saliency"]["network"]


def test_the_network_reaches_the_workflow_and_only_the_default_one_may_be_missing(tmp_path, monkeypatch, capsys):
    content = b"network" * 100
    row = WeightsFile("saliency/u2netp.onnx", "https://x", len(content), hashlib.sha256(content).hexdigest(), "Apache-2.0", "x", "y")
    segmenter = replace(row, file="mobile_sam.pt")
    monkeypatch.setattr(weights, "read_table", lambda: {row.file: row, segmenter.file: segmenter})
    monkeypatch.setattr(workflow, "find_weights_home", lambda: tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.onnx").touch()
    assert named_network("mine.onnx") == str(tmp_path / "mine.onnx")
    assert "objects are cut out without Segment Anything" in capsys.readouterr().err
    assert named_network("none") == "none" and not capsys.readouterr().err
    path = tmp_path / "resources/weights/saliency/u2netp.onnx"
    path.parent.mkdir(parents=True)
    (tmp_path / "resources/weights/mobile_sam.pt").write_bytes(content)
    for damage, said in ((None, "are not there"), (content[:-1], "cut short"), (content[::-1], "sha256")):
        if damage:
            path.write_bytes(damage)
        assert named_network(None) == "none"
        warning = capsys.readouterr().err
        assert said in warning and warning.startswith("warning: ") and warning.count("\n") == 1
        with pytest.raises(StepError, match=said):
            named_network("u2netp")
    path.write_bytes(content)
    assert named_network(None) == named_network("u2netp") == str(path) and not capsys.readouterr().err
    named = workflow.settings_of_inputs(None)["segment"]["saliency"]["segmenter"]
    assert named == str(tmp_path / "resources/weights/mobile_sam.pt")


def test_a_check_tells_good_photos_from_too_few(tmp_path, capsys):
    rng = np.random.default_rng(0)
    for index in range(9):
        write_image(tmp_path / "photos" / f"{index}.png", cv2.resize(rng.integers(0, 255, (30, 40, 3), np.uint8), (640, 480)))
    assert main(["check", str(tmp_path / "photos")]) == 0
    assert "9 different pictures; 20 to 30" in capsys.readouterr().out
    for index in range(3, 9):
        (tmp_path / "photos" / f"{index}.png").unlink()
    assert main(["check", str(tmp_path / "photos")]) == 1
    assert "problem   only 3 pictures differ from each other, 8 are needed" in capsys.readouterr().out


def test_photos_whose_background_was_removed_are_their_own_masks(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    alpha = np.zeros((48, 64), np.uint8)
    alpha[10:40, 20:50] = 255
    for kind, pixels in (("cut", np.dstack([np.full((48, 64, 3), 90, np.uint8), alpha])), ("whole", np.full((48, 64, 3), 90, np.uint8))):
        (tmp_path / kind).mkdir()
        for index in range(9):
            Image.fromarray(pixels).save(tmp_path / kind / f"{index}.png")
        monkeypatch.setattr(reconstruct_object, "run_workflow", lambda *args: False)
        assert main([kind]) == 1
    rows = read_captures(tmp_path)
    assert rows["cut"].masks == rows["cut"].images == str(tmp_path / "cut") and rows["whole"].masks == ""
    assert capsys.readouterr().err.count("what is left of them is taken as masks") == 1


@pytest.mark.parametrize(
    ("taken", "step", "words", "counts"),
    [
        (31, "register.auto", [], ["", "60"]),
        (31, "register.auto", ["--count", "31"], ["31"]),
        (50, "register.auto", [], [""]),
        (31, "segment.saliency", [], [""]),
    ],
)
def test_a_film_whose_cameras_are_refused_is_tried_with_more_of_its_frames(tmp_path, monkeypatch, taken, step, words, counts):
    """Once; not where there are hardly more, where something else failed, or where the user chose. What helped is kept."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "can.mp4").touch()
    asked = []

    def fail(target, folder, *args):
        asked.append(read_captures(folder)["can"].picture_count)
        capture = folder / "results/photos/can/video/capture"
        capture.mkdir(parents=True, exist_ok=True)
        (capture / "capture.json").write_text(json.dumps({"source_frames": list(range(taken)), "video_frames": 700}))
        write_failure([f"{capture.parent}/auto/scene/"], Failure(step, "the camera would turn by 162 degrees"))
        args[2].parent.mkdir(parents=True, exist_ok=True)
        args[2].write_text("error: refused\n")
        return False

    monkeypatch.setattr(reconstruct_object, "run_workflow", fail)
    assert main(["can.mp4", *words]) == 1
    assert asked == counts and read_captures(tmp_path)["can"].picture_count == counts[-1]


@pytest.mark.parametrize("count", ["7", "2000"])
def test_too_few_or_too_many_pictures_are_refused(tmp_path, capsys, count):
    (tmp_path / "can.mp4").touch()
    assert main([str(tmp_path / "can.mp4"), "--count", count]) == 1
    assert f"--count is {count}; expected 8 to 1000" in capsys.readouterr().err


@pytest.mark.slow
def test_a_run_that_fails_says_why(tmp_path, monkeypatch, capsys):
    """Photos that are all alike end in the first step."""
    monkeypatch.chdir(tmp_path)
    for index in range(9):
        write_image(tmp_path / "my photos" / f"{index}.png", np.full((48, 64, 3), 90, np.uint8))
    assert main(["my photos", "--cores", "1"]) == 1
    said = capsys.readouterr()
    assert "Failed    images in" in said.out and "are alike: only 1 of 9 differ, 8 are needed" in said.out
    assert (tmp_path / "results/photos/my_photos/logs/zeroshop.log").is_file() and "Traceback" not in said.out + said.err


def test_masks_among_the_photos_are_taken(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reconstruct_object, "run_workflow", lambda *args, **options: False)
    for number in range(3):
        write_image(tmp_path / f"cup/{number}.jpg", np.full((48, 64, 3), 90, np.uint8))
        write_image(tmp_path / f"cup/{number}_mask.png", np.zeros((48, 64), np.uint8))
    main([str(tmp_path / "cup"), "--into", str(tmp_path)])
    assert read_captures(tmp_path)["cup"].masks == str(tmp_path / "cup")
    assert "Masks lie among the photos and are taken, such as 0_mask.png" in capsys.readouterr().err
