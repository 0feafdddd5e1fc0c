"""Every format is opened by programs that read it, and they find the mass, the inertia and the size that the body has."""

import xml.etree.ElementTree as xml

import numpy as np
import pytest

from helpers.faults import step
from helpers.small_bodies import BOX_MM, MASS_KG, SHIFT_MM, box_inertia_kg_m2, cylinder_inertia_kg_m2
from zeroshop_steps.assets.body_files import read_body

CENTRE_M = SHIFT_MM / 1000
LOW_M, HIGH_M = CENTRE_M - BOX_MM / 2000, CENTRE_M + BOX_MM / 2000


def moments(inertia: np.ndarray) -> np.ndarray:
    return np.linalg.eigvalsh(inertia)


@pytest.mark.parametrize(("folder", "inertia"), [("box_folder", box_inertia_kg_m2), ("cylinder_folder", cylinder_inertia_kg_m2)])
def test_mass_properties_are_those_of_the_analytic_body(folder, inertia, request):
    body = read_body(request.getfixturevalue(folder) / "2dgs.body")
    assert body.mass_kg == MASS_KG and np.allclose(body.centre_m, CENTRE_M, atol=1e-7)
    assert np.allclose(body.inertia_kg_m2, inertia(MASS_KG), rtol=0.01, atol=1e-9)
    assert 0.97 < body.facts["parts_volume_share"] < 1.03, "one convex part is the body itself"


@pytest.mark.parametrize("end", ["mjcf.xml", "urdf"])
def test_mujoco(box_folder, end):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(box_folder / f"2dgs.{end}"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    if end == "mjcf.xml":
        assert np.isclose(model.body_mass[1], MASS_KG) and np.allclose(data.xipos[1], CENTRE_M, atol=1e-6)
        assert np.allclose(np.sort(model.body_inertia[1]), moments(box_inertia_kg_m2(MASS_KG)), rtol=0.01)
        assert model.ntex == 1 and np.isclose(model.geom_friction[-1, 0], 0.6)
    corners = []
    for geom in range(model.ngeom):
        first, count = model.mesh_vertadr[model.geom_dataid[geom]], model.mesh_vertnum[model.geom_dataid[geom]]
        vertices = model.mesh_vert[first : first + count] @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        corners.append((vertices.min(0), vertices.max(0)))
    assert len(corners) >= 2, "what is seen, and what collides"
    for low, high in corners:
        assert np.allclose(low, LOW_M, atol=5e-4) and np.allclose(high, HIGH_M, atol=5e-4)


def test_pybullet(box_folder):
    pybullet = pytest.importorskip("pybullet", reason="pip install -r requirements-readers.lock")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(box_folder / "2dgs.urdf"), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
        mass, friction, diagonal, centre, *_ = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)
        assert np.isclose(mass, MASS_KG) and np.isclose(friction, 0.6) and np.allclose(centre, CENTRE_M, atol=1e-6)
        assert np.allclose(np.sort(diagonal), moments(box_inertia_kg_m2(MASS_KG)), rtol=0.01)
        low, high = map(np.array, pybullet.getAABB(body, physicsClientId=client))
        assert np.allclose((low + high) / 2, 0, atol=2e-3) or np.allclose((low + high) / 2, CENTRE_M, atol=2e-3)
        assert np.allclose(high - low, BOX_MM / 1000, atol=9e-3), "Bullet adds a margin of 4 mm"
        shapes = pybullet.getVisualShapeData(body, pybullet.VISUAL_SHAPE_DATA_TEXTURE_UNIQUE_IDS, physicsClientId=client)
        assert shapes[0][4].endswith(b"2dgs.body/visual.obj")
    finally:
        pybullet.disconnect(client)


def test_yourdfpy(box_folder):
    yourdfpy = pytest.importorskip("yourdfpy", reason="pip install -r requirements-readers.lock")
    robot = yourdfpy.URDF.load(str(box_folder / "2dgs.urdf"), load_collision_meshes=True, build_collision_scene_graph=True)
    assert robot.validate(), robot.errors
    assert np.allclose(robot.scene.bounds, [LOW_M, HIGH_M], atol=1e-6)
    assert np.allclose(robot.collision_scene.bounds, [LOW_M, HIGH_M], atol=5e-4)
    [visual] = robot.scene.geometry.values()
    assert visual.visual.material.image.size == (32, 32), "the texture is found"
    [link] = robot.link_map.values()
    assert np.allclose(link.inertial.inertia, box_inertia_kg_m2(MASS_KG), rtol=0.01, atol=1e-9)
    assert np.allclose(link.inertial.origin[:3, 3], CENTRE_M)


def test_pinocchio(box_folder):
    pinocchio = pytest.importorskip("pinocchio", reason="pip install -r requirements-readers.lock")
    path = str(box_folder / "2dgs.urdf")
    model = pinocchio.buildModelFromUrdf(path, pinocchio.JointModelFreeFlyer())
    inertia = model.inertias[1]
    assert np.isclose(inertia.mass, MASS_KG) and np.allclose(inertia.lever, CENTRE_M)
    assert np.allclose(inertia.inertia, box_inertia_kg_m2(MASS_KG), rtol=0.01, atol=1e-9)
    shapes = pinocchio.buildGeomFromUrdf(model, path, pinocchio.GeometryType.COLLISION, str(box_folder))
    assert len(shapes.geometryObjects) == len(read_body(box_folder / "2dgs.body").parts)


@pytest.mark.parametrize("end", ["usda", "usdz"])
def test_usd(box_folder, end):
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade, UsdUtils

    path = str(box_folder / f"2dgs.{end}")
    stage = Usd.Stage.Open(path)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1 and UsdPhysics.GetStageKilogramsPerUnit(stage) == 1
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    root = stage.GetDefaultPrim()
    mass = UsdPhysics.MassAPI(root)
    assert root.HasAPI(UsdPhysics.RigidBodyAPI) and np.isclose(mass.GetMassAttr().Get(), MASS_KG)
    assert np.allclose(mass.GetCenterOfMassAttr().Get(), CENTRE_M, atol=1e-6)
    turn = np.array(Gf.Matrix3d(Gf.Rotation(Gf.Quatd(mass.GetPrincipalAxesAttr().Get())))).T
    inertia = turn @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ turn.T
    assert np.allclose(inertia, box_inertia_kg_m2(MASS_KG), rtol=0.01, atol=1e-9)
    collisions = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert collisions and all(UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull" for prim in collisions)
    bound = UsdGeom.BBoxCache(0, ["default", "render"]).ComputeWorldBound(root).ComputeAlignedRange()
    assert np.allclose([bound.GetMin(), bound.GetMax()], [LOW_M, HIGH_M], atol=1e-6)
    image = stage.GetPrimAtPath("/thing/Looks/surface/texture")
    assert UsdShade.Shader(image).GetInput("file").Get().resolvedPath, "the texture is found"
    layers, assets, missing = UsdUtils.ComputeAllDependencies(path)
    assert layers and assets and not missing


def test_nothing_refers_to_a_place_of_this_machine(box_folder):
    for name in ("2dgs.urdf", "2dgs.mjcf.xml", "2dgs.usda", "2dgs.body/visual.obj", "2dgs.body/visual.mtl", "2dgs.body/body.json"):
        assert str(box_folder.parent) not in (box_folder / name).read_text(), name


def test_a_ros_package_is_named_where_it_is_asked_for(box_folder):
    out = box_folder / "package.urdf"
    assert step("assets", "urdf", body=box_folder / "2dgs.body", package="my_objects", out=out) == 0
    names = [mesh.attrib["filename"] for mesh in xml.parse(out).iter("mesh")]
    assert names[0] == "package://my_objects/2dgs.body/visual.obj"
