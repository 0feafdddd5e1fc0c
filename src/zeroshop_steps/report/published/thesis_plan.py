"""What `snakemake thesis` makes with `thesis.make: published`: exactly the rows that the thesis published, and what they will cost.

"ZeroShOP: Zero-shot object pose estimation in unconstrained environments", TU Wien, January 2026: 273 marks (Table 4.1: 126; the two
parts of Table 4.2: 84 and 63), and the models of Table 4.5: those of both optimizers and of Trellis from one registration and scene.
"""

from collections import Counter
from collections.abc import Iterable, Mapping

REGISTRATIONS = {"MASt3R-SfM": "mast3r", "VGGT (quarter precision)": "vggt_1024", "VGGT (full precision)": "vggt_4096"}
"""How this project calls the thesis's registrations."""
OF_MODELS = {"scene": "su_h", "registration": "mast3r"}
"""The cells whose meshes stand in Tables 4.5 and 4.6: the only ones of which every object was reconstructed (4.1.1)."""
VIEWS = {"su_l": 20, "su_h": 20, "se": 30}
"""Images of a scene, which are rings of ten."""
HOURS = {
    "render": (0.043, 0.068),
    "register": (0.5, 4.0),
    "train": (0.4, 0.6),
    "generate": (2.0, 12.0),
    "finish": (0.03, 0.05),
}
"""Processor hours of a job without a GPU, least and most: rendering of an image by BlenderProc (2000 x 1500, two cores), a registration by
a network, 30,000 iterations of training, six meshes by Trellis, and a cell's mesh, texture and grade. Nothing was timed on a GPU."""
MB_OF_IMAGE, MB_OF_CELL, MB_OF_TEST_SET = 6, 60, 2_000
"""On disk: an image with its mask and undistorted copy; a cell; YCB-V's test images, packed and unpacked."""


def list_marks(objects: Iterable[str] | None = None) -> list[dict[str, str]]:
    """The cells of Tables 4.1 and 4.2, in their order, each with object, scene, registration and nvs; of these objects alone, if given."""
    from zeroshop_steps.report.reconstruction import PUBLISHED  # loads pandas, which few plans need
    from zeroshop_steps.runtime.tables import read_table

    wanted = None if objects is None else set(objects)
    rows = read_table(PUBLISHED).to_dict("records")
    return [
        {"object": row["object"], "scene": row["scene"], "registration": REGISTRATIONS[row["registration"]], "nvs": row["nvs"]}
        for row in rows
        if wanted is None or row["object"] in wanted
    ]


def say_costs(cells: Iterable[Mapping[str, str]], download_mb: float, real_images: bool) -> str:
    """One line: hours without a GPU and GB on the disk that cells will take, those of models included.

    Args:
        cells: with object, scene, registration and nvs, each once.
        download_mb: of weights that are not there yet.
        real_images: whether BOP's test images are downloaded.
    """
    cells = list(cells)
    captures = {(cell["object"], cell["scene"]) for cell in cells}
    runs = {(cell["object"], cell["scene"], cell["registration"]) for cell in cells}
    images = sum(VIEWS[scene] for _, scene in captures)
    made = Counter("generate" if cell["nvs"] == "trellis" else "train" for cell in cells)
    jobs = {"render": images, "register": len(runs), **made, "finish": len(cells)}
    least, most = (round(sum(HOURS[name][end] * count for name, count in jobs.items())) for end in (0, 1))
    gb = (MB_OF_IMAGE * images + MB_OF_CELL * len(cells) + MB_OF_TEST_SET * real_images) / 1000
    return (
        f"The thesis: {len(cells)} meshes from {len(captures)} captures ({images} images) and {len(runs)} registrations:"
        f" {least} to {most} processor hours where there is no GPU, and poses in the test images on top; networks and training take far"
        f" less on a GPU, where nothing was timed. {gb:.0f} GB of disk for results, and {download_mb / 1000:.1f} GB of weights still to"
        " download."
    )
