"""Stands in for the Python of BlenderProc's environment: writes grey frames as blender/render_frames.py would, or fails as it is told.

Things fall straight down, as blender/settle.py would let them where nothing is in their way.

`prepare` writes an executable that is called like a Python. What it is told lies in a file beside it: {"fault": words} for an
environment that does not start, {"killed_after": n} to be killed after n frames, {"fails": words} to end with an error.
"""

import json
import os
import signal
import sys
from pathlib import Path

import numpy as np


def prepare(folder: Path, **told: object) -> Path:
    """Returns the record of a pretended environment."""
    python = folder / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{__file__}" "{folder}/told.json" "$@"\n')
    python.chmod(0o755)
    (folder / "told.json").write_text(json.dumps(told))
    (folder / "environment.json").write_text(json.dumps({"python": str(python)}))
    return folder / "environment.json"


def fallen(thing: dict) -> list:
    """(4, 4) pose of a thing once it lies on the table, not turned."""
    pose = np.array(thing["world_from_thing"])
    pose[2, 3] -= (np.array(thing["hull_mm"]) @ pose[2, :3] + pose[2, 3]).min()
    return pose.tolist()


def main(told: dict, folder: Path) -> None:
    """What the process does."""
    print("Fra:0 Mem:10M | as Blender talks")
    if "fault" in told:
        print(f"@fault {told['fault']}", flush=True)
        sys.exit(1)
    if "fails" in told:
        print(told["fails"], flush=True)
        sys.exit(3)
    if (folder / "settle.json").is_file():
        things = json.loads((folder / "settle.json").read_text())["things"]
        (folder / "settled.json").write_text(json.dumps({"world_from_things": [fallen(thing) for thing in things], "moved_mm": 0.0}))
        print("@ready")
        return
    scene = json.loads((folder / "scene.json").read_text())
    done = 0
    for frame in range(len(scene["world_from_cameras"])):
        target = folder / f"frame_{frame:06d}.npz"
        if target.exists():
            continue
        if done == told.get("killed_after"):
            target.with_name(f".frame_{frame:06d}.part").write_bytes(b"half")
            os.kill(os.getpid(), signal.SIGKILL)
        shape = scene["height_px"], scene["width_px"]
        thing = np.zeros(shape, np.uint8)
        thing[10:-10, 10:-10] = 1
        linear = np.full((*shape, 3), 0.2, np.float16)
        np.savez(target, linear=linear, depth_mm=np.where(thing, 300.0, 0.0), thing=thing)
        print(f"@frame {frame}", flush=True)
        done += 1
    print("@ready")


if __name__ == "__main__":
    # render.py is given a folder and a number of threads, settle.py a folder alone.
    main(json.loads(Path(sys.argv[1]).read_text()), Path(sys.argv[-1] if sys.argv[-2].endswith("settle") else sys.argv[-2]))
