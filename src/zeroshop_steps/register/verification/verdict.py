"""One verdict on cameras: how likely they are wrong, by all that was found.

Cameras are wrong if their centres are off by more than 1 % of the object's diameter in the mean, or one by more than 5 %. The
probability is a logistic regression on powers of the findings' strengths. Its weights can be fitted on models whose truth is known
(benchmarks/fit_verdict.py); those that are stored let each measure convince alone at strength 1. No weight is below 0: what more speaks
against cameras never makes them likelier. So checks are asked in the order of their cost, until one convinces.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pycolmap
from scipy.special import expit

from zeroshop_steps.register.scene.record import DuplicateStructure, Evidence, Finding, Inconsistent, Record, RegistrationFailed

WEIGHTS = Path(__file__).with_name("verdict_weights.json")
MOST_STRENGTH = 3.0  # from here on, a finding is no stronger
MAX_WRONG_PROBABILITY = 0.5  # where the config says nothing else: from this probability of being wrong on, cameras are refused

WRONG = "the reconstruction is self-consistent but incorrect"
FOLDED = f"{WRONG}: distinct sides were merged (duplicate structure)"
SURFACE = "add pictures in between, or put the object on a strongly textured surface"
FILM = (
    "put the object on a surface with more print, film more slowly, or take more of the film's frames"
    " (picture_count in the table of objects)"
)


@dataclass(frozen=True)
class Measure:
    """What a finding may be about.

    Attributes:
        title: in the field's words.
        claim: what it says about the cameras.
        remedy: what to do about it.
        kind: what is raised where it weighs most.
    """

    title: str
    claim: str
    remedy: str = SURFACE
    kind: type[RegistrationFailed] = Inconsistent


MEASURES = {
    "silhouettes": Measure("silhouette coherence", f"{WRONG}, or masks are", f"check the masks, {SURFACE}"),
    "contradicted": Measure("epipolar contradictions", WRONG),
    "error": Measure("reprojection error", WRONG),
    "cut": Measure("weakest cut of the view graph", "the photos are held together loosely", kind=RegistrationFailed),
    "deviation": Measure("camera deviation", "the photos hold the cameras loosely"),
    "jump": Measure("path of a film", WRONG, FILM),
    "order": Measure("order of the images", FOLDED, kind=DuplicateStructure),
    "loop_gap": Measure("loop gap", FOLDED, kind=DuplicateStructure),
    "covisibility": Measure("covisibility of neighbours", FOLDED, kind=DuplicateStructure),
    "correspondences": Measure("missing correspondences", FOLDED, kind=DuplicateStructure),
    "photometry": Measure("photometric consistency", FOLDED, kind=DuplicateStructure),
}


@dataclass(frozen=True)
class Verdict:
    """How likely cameras are wrong.

    Attributes:
        wrong: the probability.
        findings: what speaks against them, what weighs most first.
    """

    wrong: float
    findings: tuple[Finding, ...]

    @property
    def kind(self) -> type[RegistrationFailed]:
        """What is raised where the cameras are refused."""
        return MEASURES[self.findings[0].measure].kind if self.findings else RegistrationFailed

    @property
    def reason(self) -> str:
        """Why, for the user: what weighs most, and what else weighs at least half as much."""
        heaviest = _weigh(self.findings[0])
        said = [finding for finding in self.findings if 2 * _weigh(finding) >= heaviest]
        measure = MEASURES[said[0].measure]
        return f"{measure.claim}: {'; '.join(finding.found for finding in said)}; {measure.remedy}"

    def figures(self) -> dict[str, Any]:
        """As written to registration.json."""
        findings = [{"measure": one.measure, "strength": round(one.strength, 3), "found": one.found} for one in self.findings]
        return {"wrong_probability": round(self.wrong, 4), "findings": findings}


@cache
def load_weights() -> tuple[dict[str, float], float, float]:
    """The fitted weights by measure, the offset, and the power that strengths are raised to."""
    stored = json.loads(WEIGHTS.read_text())
    assert stored["weights"].keys() == MEASURES.keys(), "the measures changed; fit their weights again"
    return stored["weights"], stored["offset"], stored["power"]


def _weigh(finding: Finding) -> float:
    """By how much a finding raises the log odds."""
    weights, _, power = load_weights()
    return float(weights[finding.measure] * min(finding.strength, MOST_STRENGTH) ** power)


def judge(findings: Sequence[Finding]) -> Verdict:
    """How likely cameras are wrong; of several findings by one measure, the strongest counts."""
    strongest = {finding.measure: finding for finding in sorted(findings, key=lambda finding: finding.strength)}
    ordered = tuple(sorted(strongest.values(), key=lambda finding: -_weigh(finding)))
    return Verdict(float(expit(load_weights()[1] + sum(map(_weigh, ordered)))), ordered)


def verify(
    record: Record, checks: Iterable[Callable[[], Evidence]], model: pycolmap.Reconstruction, max_wrong_probability: float
) -> Record:
    """Ask checks one after the other; the record with all that was found, and with the verdict.

    Args:
        record: what is known so far; what was found before counts, too.
        checks: in the order of their cost.
        model: is kept as the rejected one where it is refused.
        max_wrong_probability: from this probability of being wrong on, it is refused.

    Raises:
        RegistrationFailed: the cameras are wrong, too likely; the checks after what convinced are not asked.
    """
    findings = tuple(Finding(**finding) for finding in record.entries.get("verdict", {}).get("findings", ()))
    for check in checks:
        evidence = check()
        findings += evidence.findings
        verdict = judge(findings)
        record = record.add(verdict=verdict.figures()).judge(evidence, model)
        if verdict.wrong >= max_wrong_probability:
            raise record.fail(verdict.reason, model, verdict.kind)
    return record
