"""The verdict on a reconstruction: do masks and image pairs bear it out?"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zeroshop_steps.register.consistency import SilhouetteCoherence, silhouette_coherence
from zeroshop_steps.register.image_set import ImageSet
from zeroshop_steps.register.pair_evidence import PairEvidence, pair_evidence
from zeroshop_steps.register.undistort import pinhole_views


@dataclass(frozen=True)
class Limits:
    """From where on a model counts as wrong.

    Attributes:
        unexplained_px: mask rays of one view may miss the other masks by this much (95th percentile), per 1000 px of width.
    """

    unexplained_px: float = 6.0


@dataclass(frozen=True)
class Verdict:
    """What the checks found.

    Attributes:
        coherence: of the masks.
        evidence: of the image pairs.
        reason: why the model is wrong, for the user; None when it is borne out.
        silhouettes_agree: whether the masks bear it out.
    """

    coherence: SilhouetteCoherence
    evidence: PairEvidence
    reason: str | None
    silhouettes_agree: bool

    def figures(self) -> dict[str, Any]:
        """The figures as they stand in registration.json."""
        cut, group = self.evidence.weakest_cut()
        return {
            "silhouette_px": dict(zip(self.coherence.names, np.round(self.coherence.unexplained_px, 2).tolist(), strict=True)),
            "silhouette_worst_px": round(float(self.coherence.unexplained_px.max()), 2),
            "contradicted_share": dict(zip(self.evidence.names, np.round(self.evidence.contradicted_share, 3).tolist(), strict=True)),
            "contradicted_worst_share": round(float(self.evidence.contradicted_share.max()), 3),
            "weakest_cut_matches": cut,
            "weakest_cut_images": list(group),
        }


def judge(model: pycolmap.Reconstruction, image_set: ImageSet, database: Path, limits: Limits) -> Verdict:
    """Check a model against the masks and against each image pair's own matches."""
    coherence = silhouette_coherence(*pinhole_views(model, image_set))
    evidence = pair_evidence(model, database)
    worst_px = float(coherence.unexplained_px.max())
    agree = worst_px <= limits.unexplained_px * image_set.size_px[0] / 1000
    reason = None
    if not agree:
        reason = (
            f"the masks contradict the cameras: rays through the mask of {coherence.names[int(coherence.unexplained_px.argmax())]} miss "
            f"the other masks by {worst_px:.1f} px; the reconstruction hangs together but is wrong (sides that look alike, too little "
            "texture), or masks are wrong; add pictures in between or put the object on a strongly textured surface"
        )
    return Verdict(coherence, evidence, reason, agree)
