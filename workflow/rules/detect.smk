"""Detect: views of the models from all sides, and what detectors find with them in a dataset's test set.

results/DATASET/bop/templates/MODELS/VIEWS           MODELS: models or models_NVS (bop.smk); VIEWS: 42 or 642
results/DATASET/bop/DETECTOR-MODELS/detections.json  precision.csv beside it scores it (bop.smk); DETECTOR: also with the network that
                                                     proposes regions to it, such as cnos_sam
results/DATASET/bop/DETECTOR-MODELS/masks.json       the sure ones, without overlap: what poses are estimated from after CNOS
"""

# The folder of a dataset's models: true ones or those of a surface method.
MODELS = r"models(_[^/.]+)?"


rule templates:
    input:
        models=f"{BOP}/{{models}}",
    output:
        templates=directory(f"{BOP}/templates/{{models}}/{{views}}"),
    log:
        f"{BOP}/logs/templates_{{models}}_{{views}}.log",
    wildcard_constraints:
        models=MODELS,
        views="42|642",
    threads: 2
    resources:
        **needs(4000, 30),
    message:
        "Rendering the {wildcards.models} of {wildcards.dataset} from {wildcards.views} sides"
    shell:
        "python -m zeroshop_steps.detect --method templates --models {input.models} --views {wildcards.views} --out {output.templates}"
        f"{RECORDED_FOLDER}"
        " > {log} 2>&1"


for name, method in plan.all_detectors.items():

    rule:
        name:
            name
        input:
            plan.detector_weights(name),
            models=f"{BOP}/{{models}}",
            templates=f"{BOP}/templates/{{models}}/42",
            scenes=f"{BOP}/test",
            targets=f"{BOP}/test_targets_bop19.json",
        output:
            detections=f"{BOP}/{name}-{{models}}/detections.json",
        log:
            f"{BOP}/{name}-{{models}}/logs/detections.log",
        wildcard_constraints:
            models=MODELS,
        threads: method.threads
        resources:
            **needs(method.mem_mb, method.runtime_min, method.gpu_mem_mb(plan.detector_section(name))),
        params:
            method=method.name,
            inputs=given(),
            options=step_options(plan.detector_section(name)),
        message:
            f"Looking for the {{wildcards.models}} of {{wildcards.dataset}} by {name}"
        shell:
            "python -m zeroshop_steps.detect --method {params.method} {params.inputs} {params.options} --out {output.detections}"
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
    wildcard_constraints:
        detector="|".join(plan.all_detectors),
        models=MODELS,
    resources:
        **needs(1000, 10),
    params:
        inputs=given(),
    message:
        "Choosing masks for poses of the {wildcards.models} of {wildcards.dataset}, found by {wildcards.detector}"
    shell:
        "python -m zeroshop_steps.detect --method filter_masks {params.inputs} --out {output.masks}" f"{RECORDED}" " > {log} 2>&1"
