"""What each pass of an object brings: pictures, masks, cameras and depth."""

import pytest

from helpers.given import given_cameras, small_ring, write_lenses
from helpers.plan_places import place
from zeroshop_steps.runtime.errors import StepError


def test_passes_share_one_scene(make_plan):
    rows = {"cup": {"images": "a", "images_2": "b"}, "can": {"images": "a"}, "box": {"images": "a", "depth_2": "m"}}
    plan = make_plan(rows)
    assert plan.passes(place()) == ["video", "video_2"] and plan.chosen_run(place())["scene"] == "video_joined"
    assert plan.chosen_run(place(object="can"))["scene"] == "video"
    with pytest.raises(StepError, match="has one pass only"):
        plan.passes(place(object="can"))
    with pytest.raises(StepError, match="depth_2 belongs to the pictures in images_2, which is empty"):
        plan.passes(place(object="box"))


def test_each_pass_brings_what_is_its_own(make_plan, tmp_path):
    for name in ("a/images", "a/depth", "b/images", "b/depth", "b/masks"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "1.png").touch()
    for name in "ab":
        write_lenses(tmp_path / name / "cameras.json")
    rows = {"cup": {"images": "a/images", "depth": "a/depth", "cameras": "a/cameras.json"}}
    rows["cup"] |= {f"{part}_2": f"b/{part}" for part in ("images", "depth", "masks")} | {"cameras_2": "b/cameras.json"}
    plan = make_plan(rows)
    first, second, joined = (place(scene=scene) for scene in ("video", "video_2", "video_joined"))
    assert "--masks" not in plan.capture_options(first) and plan.segmentation(first) != "user_masks"
    assert "--masks b/masks --cameras b/cameras.json" in plan.capture_options(second) and plan.segmentation(second) == "user_masks"
    assert plan.image_files(second) == ["b/images/1.png"] and plan.depth_files(second) == ["b/depth/1.png"]
    assert plan.depth_files(joined) == ["a/depth/1.png", "b/depth/1.png"]
    options = plan.stereo_options(joined)
    assert "--depth a/depth --depth-2 b/depth --capture results/photos/cup/video_joined/capture" in options
    assert "--depth b/depth --capture results/photos/cup/video_2/capture" in plan.stereo_options(second)
    assert plan.chosen_run(first)["scene"] == "video_joined" and plan.chosen_run(first)["registration"] == "auto", "lenses alone"
    rows["cup"]["depth"] = ""
    assert "--depth-2 b/depth" in (options := make_plan(rows).stereo_options(joined)) and "--depth " not in options


def test_passes_with_poses_are_registered_by_them_if_all_have_some(make_plan, tmp_path):
    ring = small_ring()
    for name in "cd":
        (tmp_path / name).mkdir()
        given_cameras(ring).write(tmp_path / name / "cameras.json")
    rows = {"cup": {"images": "i", "images_2": "j", "cameras": "c/cameras.json", "cameras_2": "d/cameras.json"}}
    assert make_plan(rows).chosen_run(place()) == {"scene": "video_joined", "registration": "given"}
    assert make_plan(rows).height_method(place(scene="video_joined")) == "given_cameras"
    rows["cup"]["cameras_2"] = ""
    with pytest.raises(StepError, match="not every pass brings the poses of its cameras; give those of all, or none"):
        make_plan(rows).chosen_run(place())


def test_depth_images_measure_the_surface_of_the_photos_that_they_belong_to(make_plan, tmp_path):
    for name in ("depth of it", "images", "masks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.png").touch()
    row = {"images": "images", "depth": "depth of it"}
    plan = make_plan({"cup": row, "can": {"images": "images"}, "jar": {**row, "masks": "masks"}})
    assert plan.depth_files(place()) == ["depth of it/a.png"] and plan.depth_capture(place()) == ["results/photos/cup/video/capture"]
    options = plan.stereo_options(place())
    for part in (
        "--depth 'depth of it'",
        "--capture results/photos/cup/video/capture",
        "--depth-camera structured_light",
        "--depth-step-mm 1.0",
    ):
        assert part in options
    rendered = place(dataset="demo", object="mug", scene="su_h")
    for other in (place(object="can"), rendered, place(scene="video_segmented")):
        assert plan.depth_files(other) == plan.depth_capture(other) == [] and plan.stereo_options(other) == "--device cpu --seed 0"
    assert plan.depth_files(place(object="jar", scene="video_segmented")) == ["depth of it/a.png"], "given masks leave photos as they are"
