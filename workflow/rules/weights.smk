"""Weights of learned methods: downloaded when asked for by name, since their licences are their publishers'.

resources/weights/FILE   one file of src/zeroshop_steps/networks/weights.csv, its size and SHA-256 checked
"""

import functools
import re

from zeroshop_steps.networks import salient_networks
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
