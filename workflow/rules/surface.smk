"""Surface: train a scene representation on the registered images, then take a raw mesh from it.

Stereo comes first, once for all optimizers of a registration.
"""

# The record of the training of each surface method, in its cell.
TRAINING_RECORDS = {"2dgs": "splats/training", "svraster": "voxels/training"}


rule stereo:
    input:
        cameras=f"{RUN}/cameras",
    output:
        seeds=f"{RUN}/stereo/seeds.npz",
        summary=f"{RUN}/stereo/stereo.json",
    log:
        f"{RUN}/stereo/logs/stereo.log",
    benchmark:
        f"{RUN}/stereo/benchmarks/stereo.tsv"
    threads: 8
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(30),
    params:
        seed=config["seed"],
        folder=subpath(output.seeds, parent=True),
    message:
        "Looking for confirmed depths of {wildcards.object}, scene {wildcards.scene}; follow it in {log}"
    shell:
        "python -m zeroshop_steps.surface --method stereo --cameras {input.cameras} --out {params.folder}"
        " --seed {params.seed} --threads {threads} --record-failure {output} > {log} 2>&1"


rule train_2dgs:
    input:
        cameras=f"{RUN}/cameras",
        stereo=f"{RUN}/stereo/seeds.npz",
    output:
        splats=f"{RUN}/2dgs/splats/splats.ply",
        curve=f"{RUN}/2dgs/splats/training.csv",
        summary=f"{RUN}/2dgs/splats/training.json",
    log:
        f"{RUN}/2dgs/logs/train.log",
    benchmark:
        f"{RUN}/2dgs/benchmarks/train.tsv"
    threads: 8
    resources:
        mem_mb=per_attempt(6000),
        runtime=per_attempt(60),
    params:
        options=step_options(config["nvs"]["2dgs"]["train"]),
        seed=config["seed"],
        folder=subpath(output.splats, parent=True),
    message:
        "Training 2DGS on {wildcards.object}, scene {wildcards.scene}; follow it in {log}"
    shell:
        "python -m zeroshop_steps.surface --method twodgs --cameras {input.cameras} --stereo {input.stereo}"
        " --out {params.folder} {params.options} --seed {params.seed} --threads {threads} --resume"
        " --record-failure {output} > {log} 2>&1"


rule fuse_2dgs:
    input:
        cameras=f"{RUN}/cameras",
        splats=f"{RUN}/2dgs/splats/splats.ply",
    output:
        mesh=f"{RUN}/2dgs/raw_mesh.ply",
        facts=f"{RUN}/2dgs/raw_mesh.json",
    log:
        f"{RUN}/2dgs/logs/fuse.log",
    benchmark:
        f"{RUN}/2dgs/benchmarks/fuse.tsv"
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(15),
    params:
        options=step_options(config["nvs"]["2dgs"]["fuse"]),
    message:
        "Fusing the depth maps of {wildcards.object}, scene {wildcards.scene}, into a mesh"
    shell:
        "python -m zeroshop_steps.surface --method fuse --splats {input.splats} --cameras {input.cameras}"
        " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"


rule train_svraster:
    input:
        cameras=f"{RUN}/cameras",
        stereo=f"{RUN}/stereo/seeds.npz",
    output:
        voxels=f"{RUN}/svraster/voxels/voxels.npz",
        curve=f"{RUN}/svraster/voxels/training.csv",
        summary=f"{RUN}/svraster/voxels/training.json",
    log:
        f"{RUN}/svraster/logs/train.log",
    benchmark:
        f"{RUN}/svraster/benchmarks/train.tsv"
    threads: 8
    resources:
        mem_mb=per_attempt(6000),
        runtime=per_attempt(60),
    params:
        options=step_options(config["nvs"]["svraster"]["train"]),
        seed=config["seed"],
        folder=subpath(output.voxels, parent=True),
    message:
        "Training SVRaster on {wildcards.object}, scene {wildcards.scene}; follow it in {log}"
    shell:
        "python -m zeroshop_steps.surface --method svraster --cameras {input.cameras} --stereo {input.stereo}"
        " --out {params.folder} {params.options} --seed {params.seed} --threads {threads} --resume"
        " --record-failure {output} > {log} 2>&1"


rule mesh_svraster:
    input:
        cameras=f"{RUN}/cameras",
        voxels=f"{RUN}/svraster/voxels/voxels.npz",
    output:
        mesh=f"{RUN}/svraster/raw_mesh.ply",
        facts=f"{RUN}/svraster/raw_mesh.json",
    log:
        f"{RUN}/svraster/logs/mesh.log",
    benchmark:
        f"{RUN}/svraster/benchmarks/mesh.tsv"
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(15),
    params:
        options=step_options(config["nvs"]["svraster"]["mesh"]),
    message:
        "Taking the surface of the voxels of {wildcards.object}, scene {wildcards.scene}"
    shell:
        "python -m zeroshop_steps.surface --method svraster_mesh --voxels-file {input.voxels} --cameras {input.cameras}"
        " {params.options} --out {output.mesh} --record-failure {output} > {log} 2>&1"
