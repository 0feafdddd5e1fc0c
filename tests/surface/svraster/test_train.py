"""Training, surface and files of sparse voxels, on the ball."""

import filecmp
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import trimesh

from helpers.ball import RADIUS, ball_initialization
from helpers.solids import as_trimesh
from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.svraster.initialization import initialize_voxels
from zeroshop_steps.surface.svraster.octree import CELLS, Octree
from zeroshop_steps.surface.svraster.settings import VoxelSettings
from zeroshop_steps.surface.svraster.signed_distances import Lattice, fuse_signed_distances
from zeroshop_steps.surface.svraster.train import BETAS, LEARNING_RATES, VoxelTrainer, prune_and_subdivide
from zeroshop_steps.surface.svraster.voxels import Voxels, read_voxels, write_voxels
from zeroshop_steps.surface.svraster_mesh import UNKNOWN, extract_level_set, extract_surface, keep_seen, render_depth
from zeroshop_steps.surface.training.optimizer import ResizableAdam
from zeroshop_steps.surface.training.trainer import ViewPyramid


def trainer_for(views: list[TrainingView], **settings) -> VoxelTrainer:
    initialization = ball_initialization(views)
    voxels = initialize_voxels(initialization, views, VoxelSettings(level_start=4))
    return VoxelTrainer(voxels, ViewPyramid(views, views), initialization, VoxelSettings(level_start=4, level_max=6, **settings))


def detached(voxels: Voxels) -> Voxels:
    return Voxels(voxels.octree, *(tensor.detach() for tensor in voxels.tensors().values()))


def watertight(mesh: Mesh) -> bool:
    return as_trimesh(mesh).is_watertight


@pytest.mark.slow
def test_training_finds_the_ball_and_its_closed_surface(ball: tuple) -> None:
    views, _ = ball
    trainer = trainer_for(views, iterations=200, count_max=6000)
    before = trainer.psnr_db(0)
    trainer.run(200)
    after = np.mean([trainer.psnr_db(index) for index in range(len(views))])
    assert after > before + 3.0, "the images must be explained much better than by the mist of mean colours at the start"
    voxels = detached(trainer.model)
    assert len(set(voxels.octree.levels)) > 1
    depths = [render_depth(voxels, view) for view in views]
    mesh = extract_surface(Lattice.around(voxels.octree, border=2), views, depths)
    main = max(as_trimesh(mesh).split(only_watertight=False), key=lambda part: part.area)
    assert watertight(mesh) and main.volume > 0
    assert np.mean(np.abs(np.linalg.norm(main.vertices, axis=1) - RADIUS)) < 0.06 * RADIUS


def test_no_view_goes_unasked_before_voxels_are_dropped(ball: tuple) -> None:
    views, _ = ball
    trainer = trainer_for(views, iterations=100)
    trainer.run(3)
    seen = torch.zeros(len(trainer.model), dtype=torch.bool)
    for index in set(range(len(views))) - trainer.rendered_views:
        rendering = trainer.render(index, 0)
        rendering.alpha.sum().backward()
        seen |= rendering.statistics.weight > 0.05
    assert len(trainer.rendered_views) == 3 and (seen & (trainer.meter.weight == 0)).any()
    trainer._count_remaining_views()
    assert (trainer.meter.weight[seen] > 0.05).all()
    assert all(tensor.grad is None for tensor in trainer.model.tensors().values())


@pytest.mark.slow
def test_resumed_training_gives_the_same_bytes(ball: tuple, tmp_path: Path) -> None:
    views, _ = ball
    settings = {"iterations": 48, "adapt_shares": (0.3, 0.5, 0.8), "count_max": 4000}
    whole = trainer_for(views, **settings)
    whole.run(48)
    first = trainer_for(views, **settings)
    first.run(29)
    first.save(tmp_path / "checkpoint.pt", {"run": "ball"})
    initialization = ball_initialization(views)
    assert (
        VoxelTrainer.resume(tmp_path / "checkpoint.pt", ViewPyramid(views, views), initialization, first.settings, {"run": "other"}) is None
    )
    second = VoxelTrainer.resume(tmp_path / "checkpoint.pt", ViewPyramid(views, views), initialization, first.settings, {"run": "ball"})
    assert second is not None and second.iteration == 29
    second.run(48)
    assert np.array_equal(whole.model.octree.keys, second.model.octree.keys) and len(set(whole.model.octree.levels)) > 1
    for name, tensor in whole.model.tensors().items():
        assert torch.equal(tensor, getattr(second.model, name)), name
    assert whole.history == second.history


def test_damaged_checkpoint_is_named(ball: tuple, tmp_path: Path) -> None:
    (tmp_path / "checkpoint.pt").write_bytes(b"not a checkpoint")
    with pytest.raises(StepError, match="checkpoint.pt is damaged"):
        VoxelTrainer.resume(tmp_path / "checkpoint.pt", ViewPyramid(ball[0], ball[0]), ball_initialization(ball[0]), VoxelSettings(), {})


def mixed_octree() -> Octree:
    """Leaves of three levels that fill the root: finer on one side."""
    octree = Octree.uniform(np.ones((16, 16, 16), bool))
    for side in (0.0, 0.3):
        octree, _ = octree.refine(np.ones(len(octree), bool), octree.centres[:, 0] > side)
    return octree


def test_the_lattice_passes_through_the_corners_of_the_finest_leaves() -> None:
    octree = mixed_octree()
    lattice = Lattice.around(octree, border=1)
    points = lattice.points(np.argwhere(np.ones(lattice.shape, bool)))
    assert np.ptp(points, axis=0) == pytest.approx(2.0 + 2 * lattice.step)
    np.testing.assert_array_equal(np.concatenate([lattice.layer(number) for number in range(lattice.shape[0])]), points)
    corners = octree.corner_points[np.unique(octree.corners[octree.cells == octree.cells.min()])] * (2.0 / CELLS) - 1.0
    places = (corners - points[0]) / lattice.step
    np.testing.assert_allclose(places, places.round(), atol=1e-9)


def test_rough_depth_maps_become_one_smooth_surface_without_holes(ball: tuple) -> None:
    views, depths = ball
    noise = np.random.default_rng(0)
    rough = [np.where(depth > 0, depth + noise.normal(0, 0.03, depth.shape), 0).astype(np.float32) for depth in depths]
    for depth in rough:
        depth[(noise.random(depth.shape) < 0.1) & (depth > 0)] = UNKNOWN
    lattice = Lattice(np.full(3, 9), (47, 47, 47), 2.0 / 64)
    mesh = extract_surface(lattice, views, rough)
    assert watertight(mesh) and len(as_trimesh(mesh).split()) == 1
    assert np.mean(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS)) < 0.02


@pytest.mark.slow
def test_distances_are_signed_and_hidden_points_are_inside(ball: tuple) -> None:
    views, depths = ball
    cameras = [view.camera for view in views]
    depths = [depth.astype(np.float32) for depth in depths]
    directions = np.random.default_rng(0).normal(size=(50, 3))
    directions[:, 2] *= 0.3
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for radius in (RADIUS - 0.04, RADIUS + 0.04):
        found = fuse_signed_distances(radius * directions, cameras, depths, 0.1, zero_is_free=True, min_views=1)
        assert (np.sign(found) == np.sign(radius - RADIUS)).all()
    assert np.allclose(fuse_signed_distances(np.zeros((1, 3)), cameras, depths, 0.1, zero_is_free=True, min_views=1), -0.1)
    nothing = [np.zeros_like(depth) for depth in depths]
    assert np.allclose(fuse_signed_distances(directions, cameras, nothing, 0.1, zero_is_free=False, min_views=1), -0.1)
    assert np.allclose(fuse_signed_distances(directions, cameras, nothing, 0.1, zero_is_free=True, min_views=1), 0.1)


def test_training_starts_dense_inside_confirmed_depths(ball: tuple) -> None:
    views, depths = ball
    initialization = ball_initialization(views)
    for view, depth in zip(views, depths, strict=True):
        y, x = np.nonzero(depth)
        k = view.camera.intrinsics
        initialization.confirmed_rays[view.camera.name] = np.stack([(x + 0.5 - k[0, 2]) / k[0, 0], (y + 0.5 - k[1, 2]) / k[1, 1]], 1)
        initialization.confirmed_depths[view.camera.name] = depth[y, x]
    voxels = initialize_voxels(initialization, views, VoxelSettings(level_start=5))
    octree = voxels.octree
    radius = np.linalg.norm(octree.corner_points * (2.0 / CELLS) - 1.0, axis=1)
    densities = voxels.densities.numpy()
    behind = (radius > RADIUS - 0.05) & (radius < RADIUS - 0.03)
    assert np.median(densities[behind]) > 0.5 and densities[radius > RADIUS + 0.08].max() < -3.0
    assert np.linalg.norm(octree.centres, axis=1).max() < RADIUS + 0.2


@pytest.mark.slow
def test_without_stereo_training_starts_from_the_solid_hull_and_leaves_no_hole(ball: tuple) -> None:
    views, depths = ball
    settings = VoxelSettings(
        iterations=150, initialization="sparse", level_start=4, level_max=6, count_max=6000, lambda_normal=0.01, lambda_depth=0.25,
        coarse_share=0.0, normal_from_share=0.0,
    )  # fmt: skip
    initialization = ball_initialization(views)
    voxels = initialize_voxels(initialization, views, settings)
    assert set(voxels.octree.levels) == {4} and np.linalg.norm(voxels.octree.centres, axis=1).min() < 0.2
    trainer = VoxelTrainer(voxels, ViewPyramid(views, views), initialization, settings)
    edge = 2.0 / 2**4
    for allowed in (1.5 * edge, 0.4 * edge):  # the hull is as rough as its cells; training finds the ball in it
        for view, depth in zip(views, depths, strict=True):
            # Not at the rim, where rays pass beside the ball's true surface.
            inner = cv2.erode(view.mask.numpy(), np.ones((7, 7), np.uint8)) > 0
            found = render_depth(detached(trainer.model), view)[inner]
            assert found.min() > 0, "a ray passes through"
            assert np.mean(np.abs(found - depth[inner])) < allowed
        trainer.run(settings.iterations)


def test_pruning_and_subdivision_keep_the_field_and_the_cap() -> None:
    octree = Octree.uniform(np.ones((8, 8, 8), bool))
    points = octree.corner_points * (2.0 / CELLS) - 1.0
    voxels = Voxels(octree, torch.from_numpy((points @ [1.0, 2.0, 3.0]).astype(np.float32)), torch.rand(512, 1, 3), torch.zeros(512, 3, 3))
    optimizer = ResizableAdam(voxels, LEARNING_RATES, BETAS)
    for tensor in voxels.tensors().values():
        tensor.grad = torch.ones_like(tensor)
    before = {tuple(centre): colour for centre, colour in zip(octree.centres, voxels.sh_constant.detach().clone() - 0.01, strict=True)}
    optimizer.step()
    keep = octree.centres[:, 0] > -0.5
    priority = np.where(octree.centres[:, 1] > 0, 1.0, 0.0) * (1.0 + octree.centres[:, 2])
    prune_and_subdivide(voxels, optimizer, keep, priority, max_level=4, count_max=700)
    tree = voxels.octree
    assert len(tree) <= 700 and set(tree.levels) == {3, 4} and tree.centres[:, 0].min() > -0.5
    assert (tree.centres[tree.levels == 4][:, 1:] > 0).all(), "the most urgent leaves are split"
    points = tree.corner_points * (2.0 / CELLS) - 1.0
    moved = points @ [1.0, 2.0, 3.0] - LEARNING_RATES["densities"]
    assert np.allclose(voxels.densities.detach().numpy(), moved, atol=1e-5)
    for centre, level, colour in zip(tree.centres, tree.levels, voxels.sh_constant.detach(), strict=True):
        if level == 3:
            assert torch.allclose(colour, before[tuple(centre)], atol=1e-5)
    state = optimizer.adam.state[voxels.densities]
    assert state["exp_avg"].shape == voxels.densities.shape and torch.allclose(state["exp_avg"], torch.full_like(state["exp_avg"], 0.1))


def test_a_voxel_file_keeps_everything(ball: tuple, tmp_path: Path) -> None:
    voxels, sphere = detached(trainer_for(ball[0], iterations=10).model), ObjectSphere(np.array([10.0, -20.0, 5.0]), 80.0)
    write_voxels(tmp_path / "voxels.npz", voxels, sphere)
    back, sphere_back = read_voxels(tmp_path / "voxels.npz")
    assert sphere_back.radius == 80.0 and np.array_equal(sphere_back.centre, sphere.centre)
    assert np.array_equal(back.octree.origins, voxels.octree.origins) and np.array_equal(back.octree.levels, voxels.octree.levels)
    for name, tensor in voxels.tensors().items():
        assert torch.equal(tensor, getattr(back, name)), name
    write_voxels(tmp_path / "again.npz", back, sphere)
    assert filecmp.cmp(tmp_path / "voxels.npz", tmp_path / "again.npz", shallow=False)


@pytest.mark.parametrize("damage", ["cut", "mixed"])
def test_a_damaged_voxel_file_is_refused(ball: tuple, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "voxels.npz"
    voxels = detached(trainer_for(ball[0], iterations=10).model)
    if damage == "mixed":
        voxels.densities = voxels.densities[:-1]
    write_voxels(path, voxels, ObjectSphere(np.zeros(3), 1.0))
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(StepError, match="voxels.npz is not a whole voxel file"):
        read_voxels(path)


def test_sparse_voxel_meshes_name_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(StepError, match="none.npz does not exist; train first"):
        read_voxels(tmp_path / "none.npz")


def test_what_too_few_cameras_see_is_left_out(ball: tuple) -> None:
    above = [(view, depth.astype(np.float32)) for view, depth in zip(*ball, strict=True) if view.camera.centre_in_world[2] > 0]
    views, depths = [view for view, _ in above], [depth for _, depth in above]
    both = trimesh.util.concatenate([trimesh.creation.icosphere(4, radius) for radius in (RADIUS, RADIUS / 2)])
    mesh = Mesh(np.asarray(both.vertices), np.asarray(both.faces))
    kept = keep_seen(mesh, views, depths, step=0.05)
    assert kept.vertices[:, 2].max() == pytest.approx(RADIUS, rel=0.01) and -RADIUS < kept.vertices[:, 2].min() < -0.3 * RADIUS
    assert np.linalg.norm(kept.vertices, axis=1).min() > 0.9 * RADIUS, "what is hidden inside goes"
    assert len(keep_seen(mesh, views[:1], depths[:1], step=0.05).faces) == 0, "one view is not enough"


@pytest.mark.parametrize(("width", "closed"), [(0.04, True), (0.5, False)])
def test_a_small_pit_stays_closed(ball: tuple, width: float, closed: bool) -> None:
    views, depths = ball[0], [depth.astype(np.float32) for depth in ball[1]]
    sphere = trimesh.creation.icosphere(4, RADIUS)
    vertices = np.array(sphere.vertices)
    vertices[np.linalg.norm(vertices - [RADIUS, 0, 0], axis=1) < width] *= 0.9
    kept = keep_seen(Mesh(vertices, np.asarray(sphere.faces)), views, depths, step=0.025)
    assert (len(kept.faces) == len(sphere.faces)) == closed


def test_extract_level_set_faces_outwards() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in (20, 33, 17)], indexing="ij"), -1)
    mesh = extract_level_set((6.0 - np.linalg.norm(grid - [9.0, 16.0, 8.0], axis=-1)).clip(-4, 4).astype(np.float32))
    assert watertight(mesh) and trimesh.Trimesh(mesh.vertices, mesh.faces).volume == pytest.approx(4 / 3 * np.pi * 6**3, rel=0.03)
    assert extract_level_set(np.full((8, 8, 8), -1.0, np.float32)) is None
