"""Whether BlenderProc starts here: tells `@ready`, or `@fault` and the reason."""

from zeroshop_steps.synthetic.blender.start import run

if __name__ == "__main__":
    run(lambda bproc: None)
