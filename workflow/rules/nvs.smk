"""Novel view synthesis: train a scene representation on the registered images, then take a raw mesh from it.

Stereo comes first, once for all optimizers of a registration.
"""


rule stereo:
    input:
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
    output:
        seeds="results/{dataset}/{object}/{scene}/{registration}/stereo/seeds.npz",
        summary="results/{dataset}/{object}/{scene}/{registration}/stereo/stereo.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/stereo/logs/stereo.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/stereo/benchmarks/stereo.tsv"
    conda:
        "../envs/zeroshop.yaml"
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
        " --seed {params.seed} --threads {threads}"
        " --record-failure {output} > {log} 2>&1"


rule train_2dgs:
    input:
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        stereo="results/{dataset}/{object}/{scene}/{registration}/stereo/seeds.npz",
    output:
        splats="results/{dataset}/{object}/{scene}/{registration}/2dgs/splats/splats.ply",
        curve="results/{dataset}/{object}/{scene}/{registration}/2dgs/splats/training.csv",
        summary="results/{dataset}/{object}/{scene}/{registration}/2dgs/splats/training.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/2dgs/logs/train.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/2dgs/benchmarks/train.tsv"
    conda:
        "../envs/zeroshop.yaml"
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
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        splats="results/{dataset}/{object}/{scene}/{registration}/2dgs/splats/splats.ply",
    output:
        mesh="results/{dataset}/{object}/{scene}/{registration}/2dgs/raw_mesh.ply",
        facts="results/{dataset}/{object}/{scene}/{registration}/2dgs/raw_mesh.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/2dgs/logs/fuse.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/2dgs/benchmarks/fuse.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(15),
    params:
        options=step_options(config["nvs"]["2dgs"]["fuse"]),
    message:
        "Fusing the depth maps of {wildcards.object}, scene {wildcards.scene}, into a mesh"
    shell:
        "python -m zeroshop_steps.surface --method fuse --splats {input.splats} --cameras {input.cameras}"
        " {params.options} --out {output.mesh}"
        " --record-failure {output} > {log} 2>&1"


rule train_svraster:
    input:
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        stereo="results/{dataset}/{object}/{scene}/{registration}/stereo/seeds.npz",
    output:
        voxels="results/{dataset}/{object}/{scene}/{registration}/svraster/voxels/voxels.npz",
        curve="results/{dataset}/{object}/{scene}/{registration}/svraster/voxels/training.csv",
        summary="results/{dataset}/{object}/{scene}/{registration}/svraster/voxels/training.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/svraster/logs/train.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/svraster/benchmarks/train.tsv"
    conda:
        "../envs/zeroshop.yaml"
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
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        voxels="results/{dataset}/{object}/{scene}/{registration}/svraster/voxels/voxels.npz",
    output:
        mesh="results/{dataset}/{object}/{scene}/{registration}/svraster/raw_mesh.ply",
        facts="results/{dataset}/{object}/{scene}/{registration}/svraster/raw_mesh.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/svraster/logs/mesh.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/svraster/benchmarks/mesh.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(15),
    params:
        options=step_options(config["nvs"]["svraster"]["mesh"]),
    message:
        "Taking the surface of the voxels of {wildcards.object}, scene {wildcards.scene}"
    shell:
        "python -m zeroshop_steps.surface --method svraster_mesh --voxels-file {input.voxels} --cameras {input.cameras}"
        " {params.options} --out {output.mesh}"
        " --record-failure {output} > {log} 2>&1"
