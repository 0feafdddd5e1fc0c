"""Weights of learned methods: downloaded when asked for by name, since their licences are their publishers'.

resources/weights/FILE   one file of src/zeroshop_steps/networks/weights.csv, its size and SHA-256 checked
weights, weights/METHOD  (names of rules) all that the thesis's tables need, or one method; after its licences were agreed to, once:
                         --config licences=agreed
"""

from zeroshop_steps.networks.weights import look_up_weights, read_table as weights_table
from zeroshop_steps.plan.weights import AGREED, list_files, list_sets, weights_of

SETS = list_sets(plan)

for name, chosen in SETS.items():

    rule:
        name:
            name
        input:
            weights=weights_of(plan, chosen),
            agreed=f"{AGREED}/{Path(name).name}.txt",
        localrule: True
        message:
            "All of them are there"


rule agree_licences:
    output:
        agreed=f"{AGREED}/{{set}}.txt",
    log:
        f"{AGREED}/logs/{{set}}.log",
    wildcard_constraints:
        set="|".join(Path(name).name for name in SETS),
    resources:
        **needs(500, 5),
    params:
        files=lambda wildcards: [row.file for row in list_files(SETS.get(f"weights/{wildcards.set}", SETS["weights"]))],
    message:
        "Noting that the licences of these weights were agreed to: {wildcards.set}"
    shell:
        "python -m zeroshop_steps.networks --method agree_licences --files {params.files} --out {output.agreed} > {log} 2>&1"


rule weights_file:
    output:
        weights="resources/weights/{file}",
    log:
        "resources/weights/logs/{file}.log",
    wildcard_constraints:
        file="|".join(map(re.escape, weights_table())),
    resources:
        **needs(1000, 240),
    params:
        licence=lambda wildcards: look_up_weights(wildcards.file).licence,
    message:
        "Downloading the weights {wildcards.file}, whose licence is: {params.licence}"
    shell:
        "python -m zeroshop_steps.networks --method fetch_weights --file {wildcards.file} --out {output.weights} > {log} 2>&1"
