"""Things that fall: from apart, and with BlenderProc, where it is set up, until they rest on the table."""

import json

import manifold3d
import numpy as np
import pytest
import trimesh

from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.synthetic import blenderproc
from zeroshop_steps.synthetic.scenes.clutter import GAP_MM, drop_bodies, make_body

SOLIDS = [trimesh.creation.box((80, 60, 30)), trimesh.creation.cylinder(30, 90), trimesh.creation.icosphere(3, 35)] * 2


def bodies():
    return [make_body(np.asarray(solid.vertices)) for solid in SOLIDS]


def moved(poses):
    return [solid.vertices @ pose[:3, :3].T + pose[:3, 3] for solid, pose in zip(SOLIDS, poses, strict=True)]


@pytest.mark.slow
def test_things_fall_from_above_the_table_and_apart():
    starts = drop_bodies(bodies(), np.random.default_rng(0))
    vertices = moved(starts)
    assert all(points[:, 2].min() >= 5.0 for points in vertices)
    shapes = [manifold3d.Manifold.hull_points(points) for points in vertices]
    for index, shape in enumerate(shapes):
        assert all(shape.min_gap(other, 10.0) > GAP_MM - 0.5 for other in shapes[:index])
    again = drop_bodies(bodies(), np.random.default_rng(0))
    assert all((one == other).all() for one, other in zip(starts, again, strict=True))


@pytest.mark.slow
def test_what_does_not_come_to_rest_is_tried_again_and_then_refused(tmp_path, monkeypatch):
    falls = []

    def restless(environment, script, arguments):
        things = json.loads((tmp_path / str(len(falls)) / "settle.json").read_text())["things"]
        falls.append(things[0]["world_from_thing"])
        content = {"world_from_things": [np.eye(4).tolist()] * len(things), "moved_mm": 40.0}
        (tmp_path / str(len(falls) - 1) / "settled.json").write_text(json.dumps(content))
        return iter(())

    monkeypatch.setattr(blenderproc, "run_script", restless)
    with pytest.raises(StepError, match="did not come to rest in 5 attempts"):
        blenderproc.settle_bodies(tmp_path, tmp_path, bodies(), np.random.default_rng(0))
    assert len(falls) == 5 and falls[0] != falls[1]


def test_physics_ends_in_rest_on_the_table(blender, tmp_path):
    poses = blenderproc.settle_bodies(tmp_path, blender, bodies(), np.random.default_rng(0))
    vertices = moved(poses)
    heights = np.array([points[:, 2].min() for points in vertices])
    assert (heights > -1.0).all() and (heights < 1.0).sum() >= 3, "most things touch the table"
    assert all(np.hypot(*points[:, :2].mean(0)) < 600 for points in vertices)
    shapes = [manifold3d.Manifold.hull_points(points) for points in vertices]
    for index, shape in enumerate(shapes):
        for other in shapes[:index]:
            assert (shape ^ other).volume() < 200.0, "things do not go through each other"
    for pose in poses:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-5)
    kept = blenderproc.settle_bodies(tmp_path, tmp_path / "gone.json", bodies(), np.random.default_rng(0))
    assert all((one == other).all() for one, other in zip(poses, kept, strict=True)), "an outcome that is there is taken"
