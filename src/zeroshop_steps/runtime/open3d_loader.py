"""Import Open3D on machines that lack the system's libusb.

Open3D links libusb for its depth-camera drivers, so `import open3d` fails where the library is absent, as it is on
a bare Debian or Ubuntu. The wheel `libusb-package` carries the same library; loading it first satisfies the linker.
Everything here imports Open3D as `from zeroshop_steps.runtime.open3d_loader import o3d`.
"""

import ctypes
import ctypes.util
import sys
from types import ModuleType

import numpy as np

if ctypes.util.find_library("usb-1.0") is None:
    import libusb_package

    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)

# Open3D imports a web server for drawing in notebooks, half of its import's time; nothing here draws in one.
_drawing = ModuleType("open3d.visualization.draw_plotly")
vars(_drawing).update(get_plotly_fig=None, draw_plotly=None, draw_plotly_server=None)
sys.modules.setdefault(_drawing.__name__, _drawing)

import open3d as o3d  # noqa: E402

o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)

__all__ = ["o3d", "ray_caster"]


def ray_caster(*surfaces: tuple[np.ndarray, np.ndarray]) -> o3d.t.geometry.RaycastingScene:
    """A search tree for rays and nearest points over surfaces, each (V, 3) vertices and (F, 3) faces; their geometry ids count from 0."""
    scene = o3d.t.geometry.RaycastingScene()
    for vertices, faces in surfaces:
        scene.add_triangles(
            o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)), o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32))
        )
    return scene
