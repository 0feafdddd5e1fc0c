"""Training and fusion on a small ball with a checkered surface, drawn without the renderer under test."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from helpers.ball import FOCAL_PX, RADIUS, SIZE_PX, ball_initialization
from helpers.ssim_twin import ssim_map
from zeroshop_steps.geometry.cameras.object_crops import ObjectSphere, fit_object_sphere
from zeroshop_steps.geometry.meshes.triangle_meshes import Mesh
from zeroshop_steps.geometry.observation.visual_hull import VisualHull
from zeroshop_steps.runtime.errors import StepError
from zeroshop_steps.surface.fuse import fuse_depth_maps, render_depth
from zeroshop_steps.surface.meshing.silhouette_offset import fit_to_masks
from zeroshop_steps.surface.rendering.training_views import TrainingView
from zeroshop_steps.surface.training.losses import has_normal, normals_from_depth
from zeroshop_steps.surface.training.ssim import DeviceDissimilarity, dssim
from zeroshop_steps.surface.training.trainer import ViewPyramid
from zeroshop_steps.surface.twodgs.settings import SurfelSettings
from zeroshop_steps.surface.twodgs.surfels import initialize_surfels, read_splat_ply, write_splat_ply
from zeroshop_steps.surface.twodgs.train import SurfelTrainer


def trainer_for(views: list[TrainingView], settings: SurfelSettings) -> SurfelTrainer:
    initialization = ball_initialization(views)
    return SurfelTrainer(initialize_surfels(initialization, settings.seed), ViewPyramid(views, views), initialization, settings)


@pytest.mark.slow
def test_training_finds_the_ball_and_fusion_its_surface(ball: tuple) -> None:
    views, _ = ball
    trainer = trainer_for(views, SurfelSettings(iterations=300, densify_every=50))
    before = trainer.psnr_db(0)
    trainer.run(300)
    after = np.mean([trainer.psnr_db(index) for index in range(len(views))])
    assert after > before + 6.0, "the images must be explained much better than by the grey start"
    surfels = trainer.model
    for name, tensor in surfels.tensors().items():
        setattr(surfels, name, tensor.detach())
    mesh = fuse_depth_maps([render_depth(surfels, view) for view in views], views, surfels, voxels=48, min_views=2)
    distance = np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS)
    assert np.mean(distance) < 0.03 * RADIUS
    corners = mesh.vertices[mesh.faces]
    outward = np.einsum("fi,fi->f", np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), corners.mean(1))
    assert (outward > 0).mean() > 0.95


def test_resumed_training_gives_the_same_bytes(ball: tuple, tmp_path: Path) -> None:
    views, _ = ball
    settings = SurfelSettings(iterations=30, densify_every=8, densify_from_share=0.2)
    whole = trainer_for(views, settings)
    whole.run(30)
    first = trainer_for(views, settings)
    first.run(11)
    first.save(tmp_path / "checkpoint.pt", {"run": "ball"})
    run = (tmp_path / "checkpoint.pt", ViewPyramid(views, views), ball_initialization(views), settings)
    assert SurfelTrainer.resume(*run, {"run": "other"}) is None
    second = SurfelTrainer.resume(*run, {"run": "ball"})
    assert second is not None and second.iteration == 11
    second.run(30)
    for name, tensor in whole.model.tensors().items():
        assert torch.equal(tensor, getattr(second.model, name)), name


def test_damaged_checkpoint_is_named(ball: tuple, tmp_path: Path) -> None:
    (tmp_path / "checkpoint.pt").write_bytes(b"not a checkpoint")
    with pytest.raises(StepError, match="checkpoint.pt is damaged"):
        SurfelTrainer.resume(tmp_path / "checkpoint.pt", ViewPyramid(ball[0], ball[0]), ball_initialization(ball[0]), SurfelSettings(), {})


def test_splat_ply_keeps_everything(ball: tuple, tmp_path: Path) -> None:
    initialization = ball_initialization(ball[0])
    surfels = initialize_surfels(initialization, 3)
    surfels.sh_rest += torch.randn(surfels.sh_rest.shape, generator=torch.Generator().manual_seed(0))
    sphere = ObjectSphere(np.array([10.0, -20.0, 5.0]), 80.0)
    write_splat_ply(tmp_path / "splats.ply", surfels, sphere)
    back, sphere_back = read_splat_ply(tmp_path / "splats.ply")
    assert sphere_back.radius == 80.0 and np.array_equal(sphere_back.centre, sphere.centre)
    for name, tensor in surfels.tensors().items():
        assert torch.allclose(tensor, getattr(back, name), atol=2e-5), name


def test_a_truncated_splat_ply_is_refused(ball: tuple, tmp_path: Path) -> None:
    initialization = ball_initialization(ball[0])
    write_splat_ply(
        tmp_path / "s.ply",
        initialize_surfels(initialization, 3),
        ObjectSphere(np.zeros(3), 1.0),
    )
    (tmp_path / "s.ply").write_bytes((tmp_path / "s.ply").read_bytes()[:-100])
    with pytest.raises(StepError, match="s.ply is not a whole splat PLY"):
        read_splat_ply(tmp_path / "s.ply")


def test_hull_holds_the_ball_and_little_more(ball: tuple) -> None:
    views, _ = ball
    hull = VisualHull.carve([view.camera for view in views], [view.mask.numpy() > 0 for view in views], 1.0, 64)
    points, normals = hull.surface()
    radius = np.linalg.norm(points, axis=1)
    assert radius.min() > RADIUS - 0.06 and np.median(radius) < RADIUS * 1.25
    assert ((points / radius[:, None]) * normals).sum(1).mean() > 0.9


def test_object_sphere_is_around_the_ball(ball: tuple) -> None:
    views, _ = ball
    sphere = fit_object_sphere(tuple(view.camera for view in views), tuple(view.mask.numpy() > 0 for view in views))
    assert np.linalg.norm(sphere.centre) < 0.02 and 1.0 < sphere.radius / RADIUS < 1.6


def test_normals_from_depth_are_those_of_the_ball(ball: tuple) -> None:
    views, depths = ball
    camera, depth = views[3].camera, torch.from_numpy(depths[3])
    normals = normals_from_depth(depth, FOCAL_PX, FOCAL_PX, SIZE_PX / 2, SIZE_PX / 2).numpy()
    centre = camera.camera_from_world[:3, 3]
    for y, x in ((32, 32), (25, 40), (40, 28)):
        ray = np.array([(x + 0.5 - 32) / FOCAL_PX, (y + 0.5 - 32) / FOCAL_PX, 1.0])
        truth = (ray * depths[3][y, x] - centre) / RADIUS
        assert normals[:, y, x] @ truth > 0.995
    # Wherever a normal is said to be there, the contour included.
    y, x = np.mgrid[:SIZE_PX, :SIZE_PX]
    rays = np.stack([(x + 0.5 - SIZE_PX / 2) / FOCAL_PX, (y + 0.5 - SIZE_PX / 2) / FOCAL_PX, np.ones((SIZE_PX, SIZE_PX))])
    cosine = (normals * (rays * depths[3] - centre[:, None, None]) / RADIUS).sum(0)
    there = has_normal(depth).numpy()
    assert 0.85 < there.sum() / (depths[3] > 0).sum() < 1.0 and cosine[there].min() > 0.9
    assert cosine[(depths[3] > 0) & ~there].min() < 0.0


def test_ssim_is_one_for_equal_images_and_falls_with_noise() -> None:
    image = torch.rand(3, 40, 50, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(ssim_map(image, image), torch.ones(3, 40, 50), atol=1e-5)
    little, much = (
        ssim_map(image, image + s * torch.randn(3, 40, 50, generator=torch.Generator().manual_seed(1))).mean() for s in (0.05, 0.3)
    )
    assert much < little < 1.0


@pytest.mark.parametrize("fast_dssim", [dssim, DeviceDissimilarity.apply])
@pytest.mark.parametrize("shape", [(3, 40, 50), (1, 7, 9), (3, 33, 16)])
def test_fast_dissimilarity_matches_its_twin(shape: tuple[int, int, int], fast_dssim: Callable) -> None:
    generator = torch.Generator().manual_seed(2)
    image, target = torch.rand(shape, generator=generator), torch.rand(shape, generator=generator)
    target[:, :5] = image[:, :5] * 0.9
    weight = (torch.rand(shape[1:], generator=generator) > 0.3).float()
    fast, slow = image.clone().requires_grad_(), image.double().requires_grad_()
    loss = fast_dssim(fast, target, weight)
    twin = ((1 - ssim_map(slow, target.double())) * weight).sum()
    (3.0 * loss).backward()
    (3.0 * twin).backward()
    assert abs(float(loss) - float(twin)) < 1e-4 * float(twin)
    assert (fast.grad.double() - slow.grad).norm() < 1e-4 * slow.grad.norm()


@pytest.mark.parametrize("wrong_by", [-0.03, 0.02])
def test_silhouettes_are_brought_onto_the_masks(ball: tuple, wrong_by: float) -> None:
    views, _ = ball
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS + wrong_by)
    fitted, offset = fit_to_masks(Mesh(np.asarray(sphere.vertices), np.asarray(sphere.faces)), views, limit=0.1)
    assert offset == pytest.approx(-wrong_by, abs=0.008), "within a quarter of a pixel"
    assert np.linalg.norm(fitted.vertices, axis=1).mean() == pytest.approx(RADIUS, abs=0.008)
