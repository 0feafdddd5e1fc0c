"""Finish: a raw mesh becomes a product: clean, textured, in the object frame, in millimetres."""


rule clean:
    input:
        mesh=raw_mesh_of,
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
    output:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/clean.ply",
        facts="results/{dataset}/{object}/{scene}/{registration}/{nvs}/clean.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/clean.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/clean.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options(config["finish"]["clean"]),
    message:
        "Cleaning the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method clean --mesh {input.mesh} --cameras {input.cameras}"
        " {params.options} --out {output.mesh}"
        " --record-failure {output} > {log} 2>&1"


rule underside:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/clean.ply",
        height="results/{dataset}/{object}/{scene}/{registration}/{nvs}/height.json",
    output:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/underside.ply",
        facts="results/{dataset}/{object}/{scene}/{registration}/{nvs}/underside.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/underside.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/underside.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        options=step_options({"underside": config["finish"]["underside"]}),
    message:
        "Finishing the underside of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method underside --mesh {input.mesh} --height {input.height}"
        " {params.options} --out {output.mesh}"
        " --record-failure {output} > {log} 2>&1"


rule frame:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/underside.ply",
        height="results/{dataset}/{object}/{scene}/{registration}/{nvs}/height.json",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        capture="results/{dataset}/{object}/{scene}/capture",
    output:
        frame="results/{dataset}/{object}/{scene}/{registration}/{nvs}/frame.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/frame.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/frame.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Finding the object frame of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method frame --mesh {input.mesh} --height {input.height} --cameras {input.cameras} --capture {input.capture}"
        " --out {output.frame}"
        " --record-failure {output} > {log} 2>&1"


rule unwrap:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/underside.ply",
    output:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/unwrapped.ply",
        facts="results/{dataset}/{object}/{scene}/{registration}/{nvs}/unwrapped.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/unwrap.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/unwrap.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        texture_size_px=config["finish"]["texture_size_px"],
    message:
        "Unwrapping the mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method unwrap --mesh {input.mesh}"
        " --texture-size {params.texture_size_px} --out {output.mesh}"
        " --record-failure {output} > {log} 2>&1"


rule texture:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/unwrapped.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
    output:
        texture="results/{dataset}/{object}/{scene}/{registration}/{nvs}/texture.png",
        facts="results/{dataset}/{object}/{scene}/{registration}/{nvs}/texture.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/texture.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/texture.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    params:
        texture_size_px=config["finish"]["texture_size_px"],
    message:
        "Baking the texture of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method texture --mesh {input.mesh} --cameras {input.cameras}"
        " --texture-size {params.texture_size_px} --out {output.texture}"
        " --record-failure {output} > {log} 2>&1"


rule export:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/unwrapped.ply",
        texture="results/{dataset}/{object}/{scene}/{registration}/{nvs}/texture.png",
        frame="results/{dataset}/{object}/{scene}/{registration}/{nvs}/frame.json",
        capture="results/{dataset}/{object}/{scene}/capture",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
        facts=stage_facts,
    output:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.ply",
        texture="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.png",
        glb="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.glb",
        facts="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.json",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/export.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/export.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Writing the finished mesh of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method export --mesh {input.mesh} --texture {input.texture} --frame {input.frame}"
        " --stages {input.capture}/capture.json {input.cameras}/registration.json {input.facts}"
        " --out {output.mesh} > {log} 2>&1"


rule preview:
    input:
        mesh="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh.ply",
        cameras="results/{dataset}/{object}/{scene}/{registration}/cameras",
    output:
        preview="results/{dataset}/{object}/{scene}/{registration}/{nvs}/mesh_preview.png",
    log:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/logs/preview.log",
    benchmark:
        "results/{dataset}/{object}/{scene}/{registration}/{nvs}/benchmarks/preview.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(3000),
        runtime=per_attempt(10),
    message:
        "Rendering a preview of {wildcards.object}, scene {wildcards.scene}, {wildcards.registration}, {wildcards.nvs}"
    shell:
        "python -m zeroshop_steps.finish --method preview --mesh {input.mesh} --cameras {input.cameras}"
        " --out {output.preview} > {log} 2>&1"


rule publish:
    input:
        mesh=chosen_mesh,
        companions=chosen_companions,
        preview=chosen_preview,
        quality=chosen_quality,
        grade=chosen_grade,
        evidence=chosen_evidence,
    output:
        mesh="results/{dataset}/{object}/{nvs}.ply",
        texture="results/{dataset}/{object}/{nvs}.png",
        glb="results/{dataset}/{object}/{nvs}.glb",
        facts="results/{dataset}/{object}/{nvs}.json",
        preview=report(
            "results/{dataset}/{object}/{nvs}.preview.png",
            caption="../report/preview.rst",
            category="Meshes",
            subcategory="{dataset}",
            labels={"object": "{object}", "surface": "{nvs}"},
        ),
    log:
        "results/{dataset}/{object}/logs/publish.{nvs}.log",
    benchmark:
        "results/{dataset}/{object}/benchmarks/publish.{nvs}.tsv"
    conda:
        "../envs/zeroshop.yaml"
    threads: 1
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(5),
    params:
        quality=quality_option,
    message:
        "Putting the chosen mesh of {wildcards.object} at {output.mesh}"
    shell:
        "python -m zeroshop_steps.finish --method publish --mesh {input.mesh} --preview {input.preview}"
        " {params.quality} --grade {input.grade} --evidence {input.evidence} --out {output.mesh} > {log} 2>&1"
