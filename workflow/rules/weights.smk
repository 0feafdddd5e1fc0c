"""Weights of learned methods: downloaded when asked for by name, since their licences are their publishers'.

resources/weights/FILE   one file of src/zeroshop_steps/networks/weights.csv, its size and SHA-256 checked
weights, weights/METHOD  (names of rules) all that the thesis's tables need, or one method; after its licences were agreed to, once:
                         --config licences=agreed
"""

import functools
import re

from snakemake.logging import logger

from zeroshop_steps.networks.saliency import salient_networks
from zeroshop_steps.networks.weights import look_up_weights, read_table as weights_table


def with_own_weights(
    stage,
    name,
    method,
):
    """A method with the networks that the config names. With the user's own, it needs no published weights."""
    return method.with_options(config[stage].get(name) or {})


@functools.cache
def salient_network(
    needed=False,
):
    """The file of the salient-object network of the config, as steps are given it; None where there is none.

    The default network may be missing or damaged where it is not needed: a warning says so, and the rest goes on without it.
    """
    network = config["segment"]["saliency"]["network"]
    if network not in (*salient_networks.NETWORKS, salient_networks.NONE):
        network = os.path.relpath(ROOT / network)
    try:
        return salient_networks.find_network(network, needed)
    except StepError as error:
        raise WorkflowError(str(error)) from None


def network_options(
    network,
):
    """Options of a step that name this salient-object network; none where there is none."""
    if network is None:
        return {}
    described = config["segment"]["saliency"]
    return {"network": shlex.quote(str(network)), "mean": described["mean"], "deviation": described["deviation"]}


def weights_stamp(
    stage,
    name,
    method,
    network=None,
):
    """Size and time of the files that a method reads its networks from: a parameter, so that other weights make its results stale.

    `network` is the file of its salient-object network.

    Not an input: Snakemake would delete and download weights again whenever their rule changes.
    """
    own = (config[stage].get(name) or {}).get("weights")
    needed = [file for one in (method, *map(methods.REGISTRATIONS.get, method.tries)) for file in one.files]
    files = [methods.WEIGHTS_FOLDER / file for file in needed]
    if own:
        path = Path(os.path.relpath(ROOT / own))
        files = sorted(path.iterdir()) if path.is_dir() else [path]
    files += [network] if network else []
    return [f"{path} {path.stat().st_size} {path.stat().st_mtime_ns}" for path in files if path.is_file()]


# The methods of the thesis, with the networks that it took (config/thesis.yaml), and all others by name.
OF_THESIS = [
    methods.HEIGHTS["mast3r"],
    methods.REGISTRATIONS["mast3r"],
    methods.REGISTRATIONS["vggt_1024"],
    methods.SEGMENTATIONS["grounded_sam"],
    methods.SURFACES["trellis"],
    methods.DETECTORS["cnos"].with_options({"proposals": "fastsam"}),
    methods.DETECTORS["sam6d_ism"].with_options({"proposals": "sam"}),
    methods.ESTIMATORS["foundationpose"],
    methods.ESTIMATORS["sam6d_pem"],
]
NAMED = {name: with_own_weights(section, name, method) for section, table in methods.SECTIONS.items() for name, method in table.items()}
AGREED = f"{methods.WEIGHTS_FOLDER}/agreed"


def weights_of(
    chosen,
):
    """An input function: the weights of some methods. It says sizes and licences, and wants these agreed to before the first download."""

    def files(
        wildcards,
    ):
        table = weights_table()
        rows = [table[file] for file in sorted({file for method in chosen for file in method.files}) if file in table]
        lacking = [row for row in rows if not row.path.is_file()]
        for row in lacking:
            size = f"{row.size_bytes / 1e6:.0f} MB" if row.size_bytes else "size not published"
            logger.info(f"{row.file}: {size}, {row.licence}, from {row.source}")
        if lacking:
            logger.info(f"{len(lacking)} files, {sum(row.size_bytes or 0 for row in lacking) / 1e9:.1f} GB and those without a size")
        known = [line for path in Path(AGREED).glob("*.txt") for line in path.read_text().splitlines()]
        asked = sorted({row.licence for row in lacking} - set(known))
        if asked and config["licences"] != "agreed":
            raise WorkflowError(
                f"these files have the licences {'; '.join(asked)}. If you agree to them, add: --config licences=agreed (once)"
            )
        return [str(row.path) for row in rows]

    return files


def files_of_set(
    wildcards,
):
    """The files of the table that the methods of a set need."""
    chosen = SETS.get(f"weights/{wildcards.set}", OF_THESIS)
    return " ".join(sorted({file for method in chosen for file in method.files if file in weights_table()}))


SETS = {"weights": OF_THESIS, **{f"weights/{name}": [method] for name, method in NAMED.items() if method.files}}

for name, chosen in SETS.items():

    rule:
        name:
            name
        input:
            weights=weights_of(chosen),
            agreed=f"{AGREED}/{name.rpartition('/')[2]}.txt",
        localrule: True
        message:
            "All of them are there"


rule agree_licences:
    output:
        agreed=f"{AGREED}/{{set}}.txt",
    log:
        f"{AGREED}/logs/{{set}}.log",
    benchmark:
        f"{AGREED}/benchmarks/{{set}}.tsv"
    wildcard_constraints:
        set="|".join(name.rpartition("/")[2] for name in SETS),
    resources:
        mem_mb=per_attempt(500),
        runtime=per_attempt(5),
    params:
        files=files_of_set,
    message:
        "Noting that the licences of these weights were agreed to: {wildcards.set}"
    shell:
        "python -m zeroshop_steps.networks --method agree_licences --files {params.files} --out {output.agreed} > {log} 2>&1"


rule weights_file:
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
