"""Weights of learned methods: downloaded when asked for by name, since their licences are their publishers'.

resources/weights/FILE   one file of src/zeroshop_steps/networks/weights.csv, its size and SHA-256 checked
"""

import re

from zeroshop_steps.networks.weights import look_up_weights, read_table as weights_table


rule weights:
    output:
        weights="resources/weights/{file}",
    log:
        "resources/weights/logs/{file}.log",
    benchmark:
        "resources/weights/benchmarks/{file}.tsv"
    wildcard_constraints:
        file="|".join(map(re.escape, weights_table())),
    resources:
        mem_mb=per_attempt(1000),
        runtime=per_attempt(240),
    params:
        licence=lambda wildcards: look_up_weights(wildcards.file).licence,
    message:
        "Downloading the weights {wildcards.file}, whose licence is: {params.licence}"
    shell:
        "python -m zeroshop_steps.networks --method fetch_weights --file {wildcards.file} --out {output.weights} > {log} 2>&1"
