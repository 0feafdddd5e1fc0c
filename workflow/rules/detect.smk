"""Detect: views of the models from all sides, and what detectors find with them in a dataset's test set.

results/DATASET/bop/templates/MODELS/VIEWS           MODELS: models or models_NVS (bop.smk); VIEWS: 42 or 642
results/DATASET/bop/DETECTOR-MODELS/detections.json  precision.csv beside it scores it (bop.smk); DETECTOR: also with the network that
                                                     proposes regions to it, such as cnos_sam
results/DATASET/bop/DETECTOR-MODELS/masks.json       the sure ones, without overlap: what poses are estimated from after CNOS
"""

# The folder of a dataset's models: true ones or those of a surface method.
MODELS = r"models(_[^/.]+)?"


def detector_weights(
    name,
):
    """An input function: the weights of a detector, or an error that says how to get them; where it is recorded, those that are there."""

    def weights(
        wildcards,
    ):
        usable("detector", name, ALL_DETECTORS, "The folder is named after the detector.")
        files = [str(methods.WEIGHTS_FOLDER / file) for file in ALL_DETECTORS[name].files]
        return [file for file in files if Path(file).is_file()] if RECORDS_REFUSALS else files

    return weights


rule templates:
    input:
        models=f"{BOP}/{{models}}",
    output:
        templates=directory(f"{BOP}/templates/{{models}}/{{views}}"),
    log:
        f"{BOP}/logs/templates_{{models}}_{{views}}.log",
    benchmark:
        f"{BOP}/benchmarks/templates_{{models}}_{{views}}.tsv"
    wildcard_constraints:
        models=MODELS,
        views="42|642",
    threads: 2
    resources:
        mem_mb=per_attempt(4000),
        runtime=per_attempt(30),
    message:
        "Rendering the {wildcards.models} of {wildcards.dataset} from {wildcards.views} sides"
    shell:
        "python -m zeroshop_steps.detect --method templates --models {input.models} --views {wildcards.views}"
        " --out {output.templates}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"


for name, method in ALL_DETECTORS.items():

    rule:
        name:
            name
        input:
            models=f"{BOP}/{{models}}",
            templates=f"{BOP}/templates/{{models}}/42",
            scenes=f"{BOP}/test",
            targets=f"{BOP}/test_targets_bop19.json",
            weights=detector_weights(name),
        output:
            detections=f"{BOP}/{name}-{{models}}/detections.json",
        log:
            f"{BOP}/{name}-{{models}}/logs/detections.log",
        benchmark:
            f"{BOP}/{name}-{{models}}/benchmarks/detections.tsv"
        wildcard_constraints:
            models=MODELS,
        threads: method.threads
        resources:
            mem_mb=per_attempt(method.mem_mb),
            runtime=per_attempt(method.runtime_min),
            gpu=int(method.gpu_mem_mb(detector_options(name)) > 0),
            gpu_mem_mb=method.gpu_mem_mb(detector_options(name)),
        params:
            method=method.name,
            options=step_options(detector_options(name)),
        message:
            f"Looking for the {{wildcards.models}} of {{wildcards.dataset}} by {name}"
        shell:
            "python -m zeroshop_steps.detect --method {params.method} --models {input.models} --templates {input.templates}"
            " --scenes {input.scenes} --targets {input.targets} {params.options} --out {output.detections}"
            f"{RECORDED}"
            " > {log} 2>&1"


rule filter_masks:
    input:
        detections=f"{BOP}/{{detector}}-{{models}}/detections.json",
        models=f"{BOP}/{{models}}",
    output:
        masks=f"{BOP}/{{detector}}-{{models}}/masks.json",
    log:
        f"{BOP}/{{detector}}-{{models}}/logs/masks.log",
    benchmark:
        f"{BOP}/{{detector}}-{{models}}/benchmarks/masks.tsv"
    wildcard_constraints:
        detector="|".join(ALL_DETECTORS),
        models=MODELS,
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(10),
    message:
        "Choosing masks for poses of the {wildcards.models} of {wildcards.dataset}, found by {wildcards.detector}"
    shell:
        "python -m zeroshop_steps.detect --method filter_masks --detections {input.detections} --models {input.models}"
        " --out {output.masks}"
        f"{RECORDED}"
        " > {log} 2>&1"
